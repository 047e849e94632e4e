"""The acceptance table: what was measured, against limits, row by row and as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from thermacq_calibration.geometry.record import StereoCalibration


class Verdict(StrEnum):
    """How a measure, or a calibration, stands."""

    EXCELLENT = "excellent"
    PASS = "pass"
    FAIL = "fail"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Row:
    """One measure of a calibration.

    Parameters
    ----------
    measure
        What was measured.
    value
        In words with its unit; ``-`` while it is not known.
    passes, excels
        The limits, in words.
    verdict
        How it stands.
    needed
        Whether the calibration as a whole cannot be judged without it.
    """

    measure: str
    value: str
    passes: str
    excels: str
    verdict: Verdict
    needed: bool = True


def acceptance(calibration: StereoCalibration, still_water_sigma_m: float | None = None) -> list[Row]:
    """The acceptance table of a calibration.

    Parameters
    ----------
    calibration
        The record.
    still_water_sigma_m
        Standard deviation of a still-water plane made with it, where there is one.

    Returns
    -------
    list of Row
        Empty for a geometry that was given, not measured.
    """
    if calibration.board is None:
        return []
    half = (calibration.half_set or {}).get("rms_px")
    distance = calibration.working_distance_m
    depth = f"depth-bias σ at {distance:g} m" if distance else "depth-bias σ"
    return [
        _at_most("stereo RMS", calibration.rms_px, "px", 0.25, 0.10),
        _at_most("held-out rectified vertical RMS", calibration.held_out_vertical_rms_px, "px", 0.25, 0.10),
        _at_most("baseline σ", _mm(calibration.standard_uncertainty("baseline_m")), "mm", 0.10, 0.03),
        _at_most(depth, _mm(calibration.standard_uncertainty("depth_m")), "mm", 0.5, 0.25),
        _at_most("half-set cross-validation difference", half, "px", 0.3, 0.2),
        _poses(calibration),
        _tilt(calibration),
        _coverage(calibration),
        _outliers(calibration),
        _contrast(calibration),
        _at_most("still-water plane σ", _mm(still_water_sigma_m), "mm", 1.1, 0.3, needed=False),
    ]


def verdict(rows: Sequence[Row]) -> Verdict:
    """The calibration as a whole: as good as its worst row; unknown where a needed row is."""
    found = {row.verdict for row in rows}
    if not rows or Verdict.FAIL in found:
        return Verdict.FAIL if rows else Verdict.UNKNOWN
    if any(row.needed and row.verdict is Verdict.UNKNOWN for row in rows):
        return Verdict.UNKNOWN
    return Verdict.PASS if Verdict.PASS in found else Verdict.EXCELLENT


def table_values(rows: Sequence[Row]) -> dict[str, Any]:
    """Plain values of a table and its verdict, for JSON."""
    plain = [
        {"measure": row.measure, "value": row.value, "pass": row.passes, "excellent": row.excels}
        | {"verdict": row.verdict.value}
        for row in rows
    ]
    return {"verdict": verdict(rows).value, "rows": plain}


def tilted_part(calibration: StereoCalibration, more_than_deg: float) -> float:
    """Part of the used views in which the board is tilted by more than this, 0 to 1."""
    tilts = [view.tilt_deg for view in calibration.views if view.used and view.tilt_deg is not None]
    return float(np.mean(np.array(tilts) > more_than_deg)) if tilts else 0.0


def outlier_part(calibration: StereoCalibration) -> float:
    """Views left out as outliers, as a part of those in which the board was found."""
    used = sum(view.used for view in calibration.views)
    outliers = sum(view.reason.startswith("outlier") for view in calibration.views)
    return outliers / max(1, used + outliers)


def _at_most(
    measure: str, value: float | None, unit: str, limit: float, excellent: float, *, needed: bool = True
) -> Row:
    said = "-" if value is None else f"{value:.3f} {unit}"
    grade = _grade(value, lambda v: v <= limit, lambda v: v <= excellent)
    return Row(measure, said, f"<= {limit:.2f} {unit}", f"<= {excellent:.2f} {unit}", grade, needed)


def _poses(calibration: StereoCalibration) -> Row:
    used = sum(view.used for view in calibration.views)
    poses = used if calibration.poses is None else calibration.poses
    said = f"{poses}" if poses == used else f"{poses} different ones in {used} views"
    return Row("poses", said, ">= 25", ">= 40", _grade(poses, lambda n: n >= 25, lambda n: n >= 40))


def _tilt(calibration: StereoCalibration) -> Row:
    over_20, over_25 = (tilted_part(calibration, limit) for limit in (20.0, 25.0))
    grade = _grade(over_20, lambda part: part >= 1 / 3, lambda _: over_25 >= 1 / 2)
    said = f"{over_20:.0%} over 20°, {over_25:.0%} over 25°"
    return Row("tilt", said, "a third over 20°", "half over 25°", grade)


def _coverage(calibration: StereoCalibration) -> Row:
    least = None if calibration.coverage is None else min(calibration.coverage)
    said = "-" if calibration.coverage is None else "{:.0%} left, {:.0%} right".format(*calibration.coverage)
    grade = _grade(least, lambda part: part >= 0.80, lambda part: part >= 0.95)
    return Row("coverage of 8 x 6 cells", said, ">= 80 %", ">= 95 %", grade)


def _outliers(calibration: StereoCalibration) -> Row:
    part = outlier_part(calibration)
    grade = _grade(part, lambda value: value <= 0.03, lambda value: value <= 0.01)
    return Row("outlier views", f"{100 * part:.1f} %", "<= 3 %", "<= 1 %", grade)


def _contrast(calibration: StereoCalibration) -> Row:
    contrasts = [view.contrast for view in calibration.views if view.used and view.contrast is not None]
    measure, limits = "board contrast", (">= 1 K", ">= 5 K")
    if not contrasts:
        return Row(measure, "-", *limits, Verdict.UNKNOWN, needed=False)
    counts = float(np.median(contrasts))
    if not calibration.counts_per_kelvin:
        said = f"{counts:.4g} counts; counts per kelvin are not known"
        return Row(measure, said, *limits, Verdict.UNKNOWN, needed=False)
    kelvin = counts / calibration.counts_per_kelvin
    grade = _grade(kelvin, lambda value: value >= 1, lambda value: value >= 5)
    return Row(measure, f"{kelvin:.2f} K", *limits, grade, needed=False)


def _grade(value: Any, passes: Any, excels: Any) -> Verdict:
    if value is None:
        return Verdict.UNKNOWN
    if not passes(value):
        return Verdict.FAIL
    return Verdict.EXCELLENT if excels(value) else Verdict.PASS


def _mm(value_m: float | None) -> float | None:
    return None if value_m is None else 1000 * value_m
