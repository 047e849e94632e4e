"""Does a recording still fit its calibration? Rows of rectified pictures, and the cameras' temperatures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq.imaging import corrections_of
from thermacq.reconstruction.matching import PairReader
from thermacq.reconstruction.pairs import camera_sides, find_calibration, run_pairs
from thermacq.store import RunFile, open_run
from thermacq_calibration import StereoCalibration, apply, rectify
from thermacq_calibration.geometry.rows import RowAgreement, match_rows, row_agreement

PAIRS = 8
"""So many pairs of a recording are looked at, spread over its length."""


@dataclass(frozen=True)
class CalibrationCheck:
    """What was found.

    Parameters
    ----------
    pairs
        How many pairs were matched.
    agreement
        How well their rows agree.
    warmer_k
        How much warmer the left and the right camera are than they were at the calibration; None where either is
        not known.
    """

    pairs: int
    agreement: RowAgreement
    warmer_k: tuple[float, float] | None


def check_run(path: Path, given: Path | None, pair: str | None = None) -> CalibrationCheck:
    """Check a calibration against a recording.

    Parameters
    ----------
    path
        The run file.
    given
        The calibration; None: the one stored with the run.
    pair
        Which cameras, see `pairs.camera_sides`.

    Raises
    ------
    StoreError, ReconstructionError, thermacq_calibration.CalibrationError
        The run cannot be read, the calibration is of other cameras, or there is no texture to match.
    """
    with open_run(path) as run:
        calibration = find_calibration(run, given, pair)
        pairs = run_pairs(run, pair)
        warmer = _warmer_k(calibration.temperatures_k, temperatures_k(run, pair))
        corrections = corrections_of(run)
    chosen = np.unique(np.linspace(0, len(pairs) - 1, PAIRS).astype(int))
    with PairReader(path, calibration, pairs, corrections) as reader:
        found = [match_rows(*reader.read(int(index))) for index in chosen]
    return CalibrationCheck(len(chosen), row_agreement(found, calibration.image_size), warmer)


def check_pictures(
    left: NDArray[Any], right: NDArray[Any], calibration: StereoCalibration | None
) -> CalibrationCheck:
    """Check one pair of pictures; without a calibration they are taken to be rectified already.

    Raises
    ------
    ReconstructionError, thermacq_calibration.CalibrationError
        The pictures have different sizes or another one than the calibration, or there is no texture to match.
    """
    if left.shape != right.shape:
        sizes = [" x ".join(map(str, picture.shape[::-1])) for picture in (left, right)]
        raise ReconstructionError(f"the pictures have different sizes: {sizes[0]} and {sizes[1]}")
    if calibration is not None:
        left, right = apply(rectify(calibration), left, right)
    agreement = row_agreement([match_rows(left, right)], (left.shape[1], left.shape[0]))
    return CalibrationCheck(1, agreement, None)


def temperatures_k(run: RunFile, pair: str | None = None) -> tuple[float, float] | None:
    """Mean temperature of the focal planes, left and right, over a recording; None unless both are known."""
    known = [run.frames(name).fpa_temperature_k for name in camera_sides(run, pair)]
    known = [values[np.isfinite(values)] for values in known]
    if not all(values.size for values in known):
        return None
    return float(known[0].mean()), float(known[1].mean())


def counts_per_kelvin(run: RunFile, pair: str | None = None) -> float | None:
    """Response of the cameras by their correction files, the lower of the two; None where it is not known."""
    known = corrections_of(run).cameras
    responses = [known[name].counts_per_kelvin for name in camera_sides(run, pair) if name in known]
    found = [abs(value) for value in responses if value]
    return min(found) if len(found) == 2 else None


def _warmer_k(
    before: tuple[float, float] | None, now: tuple[float, float] | None
) -> tuple[float, float] | None:
    if before is None or now is None:
        return None
    return now[0] - before[0], now[1] - before[1]
