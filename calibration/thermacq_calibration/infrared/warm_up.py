"""A warm-up as it was seen, and its rates: of the focal plane's temperature, and of the picture's level."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
    is_sparse
        Whether frames came so seldom that closings of the shutter may have passed between them.
    """

    time_s: Floats
    fpa_temperature_k: Floats
    level_counts: Floats
    closed: Flags
    frozen: bool = True
    has_shutter: bool = True
    is_sparse: bool = False

    def until(self, time_s: float) -> WarmUp:
        """What was seen up to a time."""
        count = int(np.searchsorted(self.time_s, time_s, side="right"))
        arrays = ("time_s", "fpa_temperature_k", "level_counts", "closed")
        return replace(self, **{name: getattr(self, name)[:count] for name in arrays})


@dataclass(frozen=True)
class Rate:
    """A slope with its standard error, per second."""

    slope: float
    standard_error: float

    @property
    def bound(self) -> float:
        """Magnitude and two standard errors."""
        return abs(self.slope) + 2 * self.standard_error


def fpa_rate(seen: WarmUp, window_s: float) -> Rate | None:
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


def open_rate(seen: WarmUp, window_s: float) -> Rate | None:
    """Common slope of the level between shutter corrections, over the last window.

    A correction shows as pictures of the closed shutter, or as a step where frames came too seldom to catch
    it. Smaller steps than can be told from noise may then hide in the window: two of them are allowed for.
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
    hidden = 0.0
    if seen.is_sparse:
        is_step, least_step = _steps(level)
        piece, hidden = piece + np.cumsum(is_step), 2 * least_step / window_s
    # Nearer to the ends a step would not have been found.
    time_s, level, piece = (values[_BESIDE:-_BESIDE] for values in (time_s, level, piece))
    pieces = [piece == number for number in np.unique(piece)]
    found = _line([time_s[part] for part in pieces], [level[part] for part in pieces])
    return found and Rate(found.slope, found.standard_error + hidden / 2)


def _steps(level: Floats) -> tuple[Flags, float]:
    """Where a level jumps, (samples,) bool, True at the first after; and the smallest jump that is found.

    A jump is sought between the means of the samples before and after.
    """
    from scipy.ndimage import maximum_filter1d

    sums = np.concatenate([[0.0], np.cumsum(level - level[0])])
    means = (sums[_BESIDE:] - sums[:-_BESIDE]) / _BESIDE
    jump = means[_BESIDE:] - means[:-_BESIDE]
    from_usual = np.abs(jump - np.median(jump))
    highest = from_usual == maximum_filter1d(from_usual, 2 * _BESIDE - 1)
    least = _STEP_SIGMAS * _MAD_TO_SIGMA * float(np.median(from_usual))
    found = np.zeros(len(level), np.bool_)
    found[_BESIDE : len(level) - _BESIDE + 1] = highest & (from_usual > least)
    return found, least


def shutter_rate(seen: WarmUp, window_s: float) -> Rate | None:
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
    """Least-squares slope common to pieces that have an own offset each; None when there is too little.

    Its error is that of the noise about a parabola: a bend of the curve is no noise. Samples that resemble
    each other count less, by the effective number of a series of first order.
    """
    freedom = sum(len(time_s) for time_s in times_s) - len(times_s) - 1
    t = np.concatenate([time_s - time_s.mean() for time_s in times_s])
    y = np.concatenate([value - value.mean() for value in values])
    spread = float(t @ t)
    if freedom < 1 or spread <= 0:
        return None
    slope = float(t @ y) / spread
    if freedom < _FEWEST:
        left = y - slope * t
        return Rate(slope, math.sqrt(float(left @ left) / freedom / spread))
    middle_s = float(np.mean(times_s[0]))
    bend = np.concatenate(
        [(time_s - middle_s) ** 2 - np.mean((time_s - middle_s) ** 2) for time_s in times_s]
    )
    both = np.stack([t, bend], axis=1)
    left = y - both @ np.linalg.lstsq(both, y)[0]
    square = float(left @ left)
    alike = float(left[1:] @ left[:-1]) / square if square > 0 else 0.0
    alike = min(max(alike, 0.0), 0.98)
    return Rate(slope, math.sqrt(square / (freedom - 1) / spread * (1 + alike) / (1 - alike)))
