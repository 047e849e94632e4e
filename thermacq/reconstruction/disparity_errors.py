"""How far a disparity map is from a known one: density, bad pixels, end-point error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq_calibration import Rectification


@dataclass(frozen=True)
class DisparityErrors:
    """Figures of stereo benchmarks; shares are fractions of 1.

    Parameters
    ----------
    density
        Share of the pixels with truth that were matched.
    bad1, bad2
        Share of the matched ones that are wrong by more than 1 and 2 px.
    epe_px
        Mean absolute error of the matched ones.
    rmse_px
        Root mean square error of the matched ones.
    bias_px
        Mean error, matched minus truth.
    bad2_all
        Like `bad2` over all pixels with truth, holes counted as wrong.
    """

    density: float
    bad1: float
    bad2: float
    epe_px: float
    rmse_px: float
    bias_px: float
    bad2_all: float


def disparity_errors(disparity: NDArray[np.float32], truth: NDArray[np.floating]) -> DisparityErrors:
    """Compare a disparity map with the truth.

    Parameters
    ----------
    disparity
        (rows, columns) float32, pixels, NaN where there is no match.
    truth
        (rows, columns), pixels; NaN or infinite where unknown.

    Raises
    ------
    ReconstructionError
        The shapes differ, the truth is empty, or nothing was matched where the truth is known.
    """
    if disparity.shape != truth.shape:
        raise ReconstructionError(f"the truth has shape {truth.shape}, the disparity {disparity.shape}")
    known = np.isfinite(truth)
    matched = known & np.isfinite(disparity)
    if not matched.any():
        raise ReconstructionError("no pixel was matched where the truth is known")
    error = disparity[matched].astype(np.float64) - truth[matched]
    size = np.abs(error)
    return DisparityErrors(
        density=float(matched.sum() / known.sum()),
        bad1=float((size > 1).mean()),
        bad2=float((size > 2).mean()),
        epe_px=float(size.mean()),
        rmse_px=float(np.sqrt((size**2).mean())),
        bias_px=float(error.mean()),
        bad2_all=float(1.0 - (size <= 2).sum() / known.sum()),
    )


@dataclass(frozen=True)
class DepthErrors:
    """Agreement of depths that follow from a disparity map with those of the known one.

    Parameters
    ----------
    median_m
        Median absolute error, metres.
    median_relative
        Median absolute error over the true depth.
    within_1_percent
        Share of points whose depth is right to 1 %.
    """

    median_m: float
    median_relative: float
    within_1_percent: float


def depth_errors(
    disparity: NDArray[np.float32], truth: NDArray[np.floating], rectification: Rectification
) -> DepthErrors:
    """Compare the depths z = B f / (d + doffs) of matched pixels with the truth.

    Parameters
    ----------
    disparity, truth
        As in `disparity_errors`.
    rectification
        Geometry of the pair.

    Raises
    ------
    ReconstructionError
        Nothing was matched in front of the camera where the truth is known.
    """
    known, matched = truth + rectification.doffs_px, disparity + rectification.doffs_px
    both = np.isfinite(known) & (known > 0) & np.isfinite(matched) & (matched > 0)
    if not both.any():
        raise ReconstructionError("no pixel has a depth where the truth is known")
    depth = rectification.baseline_m * rectification.focal_px / known[both].astype(np.float64)
    relative = np.abs(known[both] / matched[both].astype(np.float64) - 1.0)
    return DepthErrors(
        median_m=float(np.median(relative * depth)),
        median_relative=float(np.median(relative)),
        within_1_percent=float((relative < 0.01).mean()),
    )
