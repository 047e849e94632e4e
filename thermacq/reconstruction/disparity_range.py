"""Which disparities a run has: a coarse, wide search on a few pairs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError

_LOWEST_SHARE, _HIGHEST_SHARE = -0.125, 0.5
"""Searched range, in widths of the picture."""
_MARGIN_PX, _MARGIN_SHARE = 8.0, 0.2
_LEAST_MATCHES = 500


def estimate_disparity_range(
    pairs: Iterable[tuple[NDArray[np.float32], NDArray[np.float32]]], doffs_px: float = 0.0
) -> tuple[int, int]:
    """Lowest and highest disparity of some rectified pairs, with a margin for waves not among them.

    Parameters
    ----------
    pairs
        Rectified pairs, (rows, columns) float32 counts, NaN outside.
    doffs_px
        Difference of the principal points; disparities at or below its negative lie beyond infinity.

    Returns
    -------
    tuple of int
        Pixels: the 1st and 99th percentile of trustworthy matches at half size, less and plus a fifth of
        their distance and 8 px.

    Raises
    ------
    ReconstructionError
        Nearly nothing could be matched.
    """
    found = np.concatenate([_coarse_disparities(left, right) for left, right in pairs])
    found = found[found > -doffs_px] if doffs_px else found
    if found.size < _LEAST_MATCHES:
        raise ReconstructionError(
            "the pictures of the two cameras have nearly nothing in common: no range of disparity was found",
            remedy="Check that left and right are not exchanged and that the calibration is of this rig; "
            "or give --set min_disparity=... --set max_disparity=...",
        )
    low, high = np.percentile(found, (1.0, 99.0))
    margin = _MARGIN_PX + _MARGIN_SHARE * (high - low)
    lowest = max(low - margin, 1.0 - doffs_px) if doffs_px else low - margin
    return int(np.floor(lowest)), int(np.ceil(high + margin))


def _coarse_disparities(left: NDArray[np.float32], right: NDArray[np.float32]) -> NDArray[Any]:
    """Trustworthy disparities of a pair, matched at half size in blocks of 11 x 11."""
    import cv2

    columns = left.shape[1] // 2
    lowest = int(_LOWEST_SHARE * columns)
    count = 16 * (int((_HIGHEST_SHARE - _LOWEST_SHARE) * columns) // 16 + 1)
    block = 11
    matcher = cv2.StereoSGBM.create(
        minDisparity=lowest,
        numDisparities=count,
        blockSize=block,
        P1=8 * block**2,
        P2=32 * block**2,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=15,
        speckleWindowSize=200,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    pad = (0, 0, lowest + count, -lowest)
    pictures = [
        cv2.copyMakeBorder(picture, *pad, cv2.BORDER_REPLICATE) for picture in _half_size_8bit(left, right)
    ]
    found = matcher.compute(*pictures)[:, lowest + count : lowest + count + columns] / 16.0
    matched = np.arange(columns) - found
    usable = (found >= lowest) & (matched >= 0) & (matched < columns)
    return np.asarray(2.0 * found[usable])


def _half_size_8bit(*pictures: NDArray[np.float32]) -> list[NDArray[np.uint8]]:
    """Without local mean, at half size, stretched to 8 bits by common percentiles."""
    import cv2

    flat = []
    for picture in pictures:
        valid = np.isfinite(picture)
        filled = np.where(valid, picture, np.median(picture[valid]) if valid.any() else 0.0)
        half = cv2.resize(
            filled.astype(np.float32),
            (picture.shape[1] // 2, picture.shape[0] // 2),
            interpolation=cv2.INTER_AREA,
        )
        flat.append(half - cv2.blur(half, (25, 25)))
    low, high = np.percentile(np.stack(flat), (1.0, 99.0))
    scale = 255.0 / max(float(high - low), 1e-6)
    return [np.clip((half - low) * scale, 0, 255).astype(np.uint8) for half in flat]
