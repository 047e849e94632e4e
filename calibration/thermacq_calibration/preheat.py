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
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

_BESIDE = 6
# Samples before and after a step whose means tell it.
_FEWEST = 4 * _BESIDE
# Samples in a window; and the part of it that they must span.
_COVERED = 0.9
_FEWEST_CLOSURES = 3
_STEP_SIGMAS = 6.0
_MAD_TO_SIGMA = 1.4826


class Grade(StrEnum):
    """How a criterion is met."""

    EXCELLENT = "excellent"
    PASS = "pass"
    FAIL = "fail"
    UNKNOWN = "not judged"


@dataclass(frozen=True)
class PreheatLimits:
    """Bars of the three criteria; a rate passes when its magnitude and two standard errors are below."""

    minimum_s: float = 1800.0
    window_s: float = 300.0
    fpa_k_per_min: float = 0.050
    fpa_excellent_k_per_min: float = 0.020
    drift_k_per_min: float = 0.010
    drift_excellent_k_per_min: float = 0.005

    def __post_init__(self) -> None:
        if not (self.window_s > 0 and self.minimum_s >= 0):
            raise CalibrationError(
                "the window of the preheat monitor must be above 0, its minimum time not below"
            )


@dataclass(frozen=True, eq=False)
class WarmUp:
    """What was seen of a camera while it warmed up; all arrays are (samples,), in order of time.

    Parameters
    ----------
    time_s
        Since the recording began.
    fpa_temperature_k
        Temperature of focal plane or housing; NaN where unknown.
    level_counts
        Mean level of the picture.
    closed
        Whether the shutter was closed.
    frozen
        Whether pictures of a closed shutter are the last one before it, repeated, as of cameras that correct
        their offsets by themselves; else they show the shutter.
    has_shutter
        Whether the camera has a shutter at all.
    """

    time_s: Floats
    fpa_temperature_k: Floats
    level_counts: Floats
    closed: Flags
    frozen: bool = True
    has_shutter: bool = True

    def until(self, time_s: float) -> WarmUp:
        """What was seen up to a time."""
        count = int(np.searchsorted(self.time_s, time_s, side="right"))
        return WarmUp(
            self.time_s[:count],
            self.fpa_temperature_k[:count],
            self.level_counts[:count],
            self.closed[:count],
            self.frozen,
            self.has_shutter,
        )


@dataclass(frozen=True)
class Rate:
    """A slope with its standard error, per second."""

    slope: float
    standard_error: float

    @property
    def bound(self) -> float:
        """Magnitude and two standard errors."""
        return abs(self.slope) + 2 * self.standard_error


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
    times = [*np.arange(first + every_s, last, every_s).tolist(), last]
    return [judge_preheat(seen.until(time_s), counts_per_kelvin, limits) for time_s in times]


def _fpa(seen: WarmUp, limits: PreheatLimits) -> Criterion:
    limit, excellent = limits.fpa_k_per_min, limits.fpa_excellent_k_per_min
    if np.isnan(seen.fpa_temperature_k).all():
        return _unknown("fpa", limit, excellent, "the camera does not tell its temperature")
    return _judge_rate("fpa", lambda part: _fpa_rate(part, limits.window_s), seen, limits, limit, excellent)


def _drift(seen: WarmUp, counts_per_kelvin: float | None, limits: PreheatLimits) -> Criterion:
    limit, excellent = limits.drift_k_per_min, limits.drift_excellent_k_per_min
    if not seen.has_shutter and not seen.closed.any():
        return _unknown("drift", limit, excellent, "the camera has no shutter")
    if counts_per_kelvin is None:
        return _unknown("drift", limit, excellent, "the counts per kelvin are not known")
    shows_shutter = bool(seen.closed.any()) and not seen.frozen
    find = _shutter_rate if shows_shutter else _open_rate

    def rate(part: WarmUp) -> Rate | None:
        found = find(part, limits.window_s)
        scale = counts_per_kelvin
        return found and Rate(found.slope / scale, found.standard_error / scale)

    seen_on = "seen on the shutter" if shows_shutter else "seen on the view between shutter corrections"
    return _judge_rate("drift", rate, seen, limits, limit, excellent, seen_on)


def _judge_rate(
    name: str,
    rate: Callable[[WarmUp], Rate | None],
    seen: WarmUp,
    limits: PreheatLimits,
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
        before = rate(seen.until(float(seen.time_s[-1]) - limits.window_s))
        ready_in_s = _time_to(limit / 60, found, before, limits.window_s)
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


def _fpa_rate(seen: WarmUp, window_s: float) -> Rate | None:
    """Slope of the temperature over the last window."""
    known = np.isfinite(seen.fpa_temperature_k)
    time_s, temperature_k = seen.time_s[known], seen.fpa_temperature_k[known]
    if not time_s.size:
        return None
    # A reading in steps is uncertain by its rounding at both ends of the window, noise or not.
    steps_k = np.abs(np.diff(temperature_k))
    rounding_k = float(steps_k[steps_k > 0].min()) / math.sqrt(6) if steps_k.any() else 0.0
    recent = time_s >= time_s[-1] - window_s
    time_s, temperature_k = time_s[recent], temperature_k[recent]
    if not _covers(time_s, window_s):
        return None
    found = _line([time_s], [temperature_k])
    return found and Rate(found.slope, math.hypot(found.standard_error, rounding_k / window_s))


def _open_rate(seen: WarmUp, window_s: float) -> Rate | None:
    """Common slope of the level between shutter corrections, over the last window.

    A correction shows as pictures of the closed shutter, or as a step where the frame rate was too low to
    catch one.
    """
    cut = np.concatenate([[False], seen.closed[:-1]])
    # The number of a sample's piece grows with each closed picture before it.
    piece = np.cumsum(cut)[~seen.closed]
    time_s, level = seen.time_s[~seen.closed], seen.level_counts[~seen.closed]
    if not time_s.size:
        return None
    recent = time_s >= seen.time_s[-1] - window_s
    time_s, level, piece = time_s[recent], level[recent], piece[recent]
    if not _covers(time_s, window_s):
        return None
    piece = piece + np.cumsum(_steps(level))
    # Nearer to the ends a step would not have been found.
    time_s, level, piece = (values[_BESIDE:-_BESIDE] for values in (time_s, level, piece))
    pieces = [piece == number for number in np.unique(piece)]
    return _line([time_s[part] for part in pieces], [level[part] for part in pieces])


def _steps(level: Floats) -> Flags:
    """Where a level jumps, by the means of the samples before and after: (samples,) bool, True at the first after."""
    from scipy.ndimage import maximum_filter1d

    sums = np.concatenate([[0.0], np.cumsum(level - level[0])])
    means = (sums[_BESIDE:] - sums[:-_BESIDE]) / _BESIDE
    jump = means[_BESIDE:] - means[:-_BESIDE]
    from_usual = np.abs(jump - np.median(jump))
    highest = from_usual == maximum_filter1d(from_usual, 2 * _BESIDE - 1)
    found = np.zeros(len(level), np.bool_)
    found[_BESIDE : len(level) - _BESIDE + 1] = highest & (
        from_usual > _STEP_SIGMAS * _MAD_TO_SIGMA * float(np.median(from_usual))
    )
    return found


def _shutter_rate(seen: WarmUp, window_s: float) -> Rate | None:
    """Slope of the level of the shutter through its closures of the last window, at least three."""
    begins = seen.closed & ~np.concatenate([[False], seen.closed[:-1]])
    number = np.cumsum(begins)[seen.closed]
    if not number.size or number[-1] < _FEWEST_CLOSURES:
        return None
    count = np.bincount(number)[1:]
    time_s, level = (
        np.bincount(number, weights=values[seen.closed])[1:] / count
        for values in (seen.time_s, seen.level_counts)
    )
    used = max(_FEWEST_CLOSURES, int(np.sum(time_s >= seen.time_s[-1] - window_s)))
    return _line([time_s[-used:]], [level[-used:]])


def _covers(time_s: Floats, window_s: float) -> bool:
    return len(time_s) >= _FEWEST and bool(time_s[-1] - time_s[0] >= _COVERED * window_s)


def _line(times_s: list[Floats], values: list[Floats]) -> Rate | None:
    """Least-squares slope common to pieces that have an own offset each; None when there is too little."""
    freedom = sum(len(time_s) for time_s in times_s) - len(times_s) - 1
    if freedom < 1:
        return None
    t = np.concatenate([time_s - time_s.mean() for time_s in times_s])
    y = np.concatenate([value - value.mean() for value in values])
    spread = float(t @ t)
    if spread <= 0:
        return None
    slope = float(t @ y) / spread
    left = y - slope * t
    return Rate(slope, math.sqrt(float(left @ left) / freedom / spread))


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
