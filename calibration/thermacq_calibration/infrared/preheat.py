"""Whether a camera has warmed up: three criteria, each with its value, its standard error and its limits.

The focal plane's temperature must have stopped rising, the picture must have stopped drifting, and a minimum
time must have passed. An uncorrected camera drifts by about 0.55 K of apparent temperature per kelvin of its
focal plane (Nugent, Opt. Eng. 52:061304, 2013).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.infrared.warm_up import Rate, WarmUp, fpa_rate, open_rate, shutter_rate


class Grade(StrEnum):
    """How a criterion is met."""

    EXCELLENT = "excellent"
    PASS = "pass"
    FAIL = "fail"
    UNKNOWN = "not judged"


@dataclass(frozen=True)
class PreheatLimits:
    """Bars of the three criteria; a rate passes when its magnitude and two standard errors are below.

    The picture is judged over a longer window than the temperature: what it shows is seldom as steady.
    """

    minimum_s: float = 1800.0
    window_s: float = 300.0
    drift_window_s: float = 600.0
    fpa_k_per_min: float = 0.050
    fpa_excellent_k_per_min: float = 0.020
    drift_k_per_min: float = 0.010
    drift_excellent_k_per_min: float = 0.005

    def __post_init__(self) -> None:
        if not (min(self.window_s, self.drift_window_s) > 0 and self.minimum_s >= 0):
            raise CalibrationError(
                "the windows of the preheat monitor must be above 0, its minimum time not below"
            )


@dataclass(frozen=True)
class Criterion:
    """One criterion: ``fpa`` and ``drift`` in kelvin per minute, ``time`` in seconds.

    Parameters
    ----------
    name
        ``fpa``, ``drift`` or ``time``.
    value, standard_error
        What was found; NaN where nothing was.
    limit, excellent
        Bars.
    grade
        How it is met.
    ready_in_s
        Predicted time until it is met; 0 when it is, NaN when nothing can be said.
    note
        Why it is not judged or not yet, or how it was judged.
    """

    name: str
    value: float
    standard_error: float
    limit: float
    excellent: float
    grade: Grade
    ready_in_s: float
    note: str = ""


@dataclass(frozen=True)
class Preheat:
    """Go or no-go for one camera at one time.

    Go: the time has passed, no criterion fails, and at least one of ``fpa`` and ``drift`` was judged.
    """

    time_s: float
    fpa: Criterion
    drift: Criterion
    time: Criterion

    @property
    def criteria(self) -> tuple[Criterion, Criterion, Criterion]:
        """All criteria."""
        return self.fpa, self.drift, self.time

    @property
    def is_go(self) -> bool:
        """Whether the camera is ready."""
        judged = any(one.grade is not Grade.UNKNOWN for one in (self.fpa, self.drift))
        return judged and all(one.grade is not Grade.FAIL for one in self.criteria)

    @property
    def ready_in_s(self) -> float:
        """Predicted time until go; 0 when it is, NaN when nothing can be said."""
        if self.fpa.grade is self.drift.grade is Grade.UNKNOWN:
            return math.nan
        return max(
            (one.ready_in_s for one in self.criteria if one.grade is Grade.FAIL), default=0.0, key=_nan_last
        )


def judge_preheat(
    seen: WarmUp, counts_per_kelvin: float | None = None, limits: PreheatLimits | None = None
) -> Preheat:
    """Judge a camera at the time of its last sample.

    Parameters
    ----------
    seen
        At least one sample.
    counts_per_kelvin
        Scale of the levels; without it their drift cannot be judged.
    limits
        Bars; None: the usual ones.

    Raises
    ------
    CalibrationError
        There is no sample, times do not rise, arrays do not fit, or the scale is not a number above 0.
    """
    limits = limits or PreheatLimits()
    _check(seen, counts_per_kelvin)
    now_s, elapsed_s = float(seen.time_s[-1]), float(seen.time_s[-1] - seen.time_s[0])
    left_s = max(0.0, limits.minimum_s - elapsed_s)
    time = Criterion(
        "time",
        elapsed_s,
        0.0,
        limits.minimum_s,
        limits.minimum_s,
        Grade.FAIL if left_s > 0 else Grade.PASS,
        left_s,
    )
    return Preheat(now_s, _fpa(seen, limits), _drift(seen, counts_per_kelvin, limits), time)


def preheat_history(
    seen: WarmUp,
    counts_per_kelvin: float | None = None,
    limits: PreheatLimits | None = None,
    every_s: float = 30.0,
) -> list[Preheat]:
    """Judge a camera as it was every `every_s` seconds, and at the end."""
    _check(seen, counts_per_kelvin)
    first, last = float(seen.time_s[0]), float(seen.time_s[-1])
    times_s = [*np.arange(first + every_s, last, every_s).tolist(), last]
    return [judge_preheat(seen.until(time_s), counts_per_kelvin, limits) for time_s in times_s]


def _fpa(seen: WarmUp, limits: PreheatLimits) -> Criterion:
    limit, excellent = limits.fpa_k_per_min, limits.fpa_excellent_k_per_min
    if np.isnan(seen.fpa_temperature_k).all():
        return _unknown("fpa", limit, excellent, "the camera does not tell its temperature")
    return _judge_rate(
        "fpa", lambda part: fpa_rate(part, limits.window_s), seen, limits.window_s, limit, excellent
    )


def _drift(seen: WarmUp, counts_per_kelvin: float | None, limits: PreheatLimits) -> Criterion:
    limit, excellent = limits.drift_k_per_min, limits.drift_excellent_k_per_min
    if not seen.has_shutter and not seen.closed.any():
        return _unknown("drift", limit, excellent, "the camera has no shutter")
    if counts_per_kelvin is None:
        return _unknown("drift", limit, excellent, "the counts per kelvin are not known")
    shows_shutter = bool(seen.closed.any()) and not seen.frozen
    find = shutter_rate if shows_shutter else open_rate

    def rate(part: WarmUp) -> Rate | None:
        found = find(part, limits.drift_window_s)
        scale = counts_per_kelvin
        return found and Rate(found.slope / scale, found.standard_error / scale)

    seen_on = "seen on the shutter" if shows_shutter else "seen on the view between shutter corrections"
    return _judge_rate("drift", rate, seen, limits.drift_window_s, limit, excellent, seen_on)


def _judge_rate(
    name: str,
    rate: Callable[[WarmUp], Rate | None],
    seen: WarmUp,
    window_s: float,
    limit: float,
    excellent: float,
    note: str = "",
) -> Criterion:
    """Compare a rate with its bars; limits are per minute, rates per second."""
    found = rate(seen)
    if found is None:
        what = "not enough samples yet"
        return Criterion(name, math.nan, math.nan, limit, excellent, Grade.FAIL, math.nan, what)
    bound = 60 * found.bound
    grade = Grade.EXCELLENT if bound <= excellent else Grade.PASS if bound <= limit else Grade.FAIL
    ready_in_s = 0.0
    if grade is Grade.FAIL:
        before = rate(seen.until(float(seen.time_s[-1]) - window_s / 2))
        ready_in_s = _time_to(limit / 60, found, before, window_s / 2)
        if 120 * found.standard_error > limit:
            note = "too restless to judge: cover the lenses, or let the cameras look at something steady"
    return Criterion(
        name, 60 * found.slope, 60 * found.standard_error, limit, excellent, grade, ready_in_s, note
    )


def _time_to(limit: float, now: Rate, before: Rate | None, apart_s: float) -> float:
    """Time until a rate that decays exponentially falls to the limit; NaN when it does not decay."""
    wanted = limit - 2 * now.standard_error
    if before is None or wanted <= 0 or now.slope * before.slope <= 0 or abs(before.slope) <= abs(now.slope):
        return math.nan
    time_constant_s = apart_s / math.log(before.slope / now.slope)
    return time_constant_s * max(0.0, math.log(abs(now.slope) / wanted))


def _unknown(name: str, limit: float, excellent: float, why: str) -> Criterion:
    return Criterion(name, math.nan, math.nan, limit, excellent, Grade.UNKNOWN, math.nan, why)


def _nan_last(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _check(seen: WarmUp, counts_per_kelvin: float | None) -> None:
    sizes = {len(seen.time_s), len(seen.fpa_temperature_k), len(seen.level_counts), len(seen.closed)}
    if len(sizes) != 1 or sizes == {0}:
        raise CalibrationError("a warm-up needs at least one sample, and as many of each kind")
    if not (np.isfinite(seen.time_s).all() and np.all(np.diff(seen.time_s) > 0)):
        raise CalibrationError("the times of a warm-up must be finite and rise")
    if not np.isfinite(seen.level_counts).all():
        raise CalibrationError("a warm-up holds mean levels that are not finite")
    if counts_per_kelvin is not None and not (math.isfinite(counts_per_kelvin) and counts_per_kelvin > 0):
        raise CalibrationError(
            f"the counts per kelvin must be a number above 0, not {counts_per_kelvin}",
            remedy="Take them from a correction file, or leave them out.",
        )
