"""An elevation series made ready for analysis: missing samples dropped, gaps found, trend removed.

Missing samples (NaN) are left out. A step between samples that is longer than an eighth of the typical
period (and than 1.5 times the median step) is a gap: below eight samples a period a parabola no longer
follows a crest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermacq.errors import ThermacqError

Detrend: TypeAlias = Literal["mean", "linear", "none"]
Series: TypeAlias = NDArray[np.float64]

_STEPS_PER_PERIOD = 8


class WaveError(ThermacqError):
    """A series holds too little to be analysed as waves."""


@dataclass(frozen=True)
class PreparedSeries:
    """A series ready for analysis.

    Parameters
    ----------
    time_s, elevation_m
        (samples,) float64, finite, times increasing, trend removed.
    weight_s
        (samples,) float64, the time that each sample stands for.
    gap
        (samples - 1,) bool, whether the step after a sample is a gap.
    removed_m
        Mean of what detrending took away.
    detrend
        What was removed.
    missing
        Number of samples that were NaN.
    """

    time_s: Series
    elevation_m: Series
    weight_s: Series
    gap: NDArray[np.bool_]
    removed_m: float
    detrend: Detrend
    missing: int


def prepare(time_s: ArrayLike, elevation_m: ArrayLike, detrend: Detrend = "mean") -> PreparedSeries:
    """Drop missing samples, find gaps, remove the trend.

    Parameters
    ----------
    time_s
        (samples,) seconds, increasing.
    elevation_m
        (samples,) metres, NaN where missing.
    detrend
        ``mean`` (default), ``linear`` or ``none``. Over few waves a straight line leans on the unfinished
        ones and changes heights by nearly a percent, so it has to be asked for.

    Raises
    ------
    WaveError
        Shapes differ, times do not increase, or fewer than three samples are left.
    """
    time = np.asarray(time_s, np.float64)
    elevation = np.asarray(elevation_m, np.float64)
    if time.ndim != 1 or time.shape != elevation.shape:
        raise WaveError(f"times {time.shape} and elevations {elevation.shape} are not two equal columns")
    finite = np.isfinite(time) & np.isfinite(elevation)
    missing = int(np.count_nonzero(~finite))
    time, elevation = time[finite], elevation[finite]
    if time.size < 3:
        raise WaveError(f"{time.size} finite samples are too few for a wave analysis")
    step = np.diff(time)
    if np.any(step <= 0):
        place = int(np.argmax(step <= 0)) + 1
        raise WaveError(
            f"times do not increase at sample {place} ({time[place - 1]:g} s, then {time[place]:g} s)",
            remedy="Sort the series by time and remove repeated samples.",
        )
    weight = _weights(step, np.zeros(step.size, np.bool_))
    level, _ = _trend(time, elevation, weight, "none" if detrend == "none" else "mean")
    limit = max(_typical_period(time, elevation - level) / _STEPS_PER_PERIOD, 1.5 * float(np.median(step)))
    gap = step > limit
    weight = _weights(step, gap)
    trend, mean = _trend(time, elevation, weight, detrend)
    return PreparedSeries(time, elevation - trend, weight, gap, mean, detrend, missing)


def up_crossings(value: Series, dead_band_m: float = 0.0) -> NDArray[np.int64]:
    """Sample before each zero up-crossing.

    Parameters
    ----------
    value
        (samples,) float64, metres.
    dead_band_m
        A crossing counts only when the series was below minus this before and is above it after; of several
        crossings in between the last one is taken.
    """
    clear = np.flatnonzero(np.abs(value) > dead_band_m)
    above = value[clear] > 0
    risen = clear[1:][above[1:] & ~above[:-1]]
    candidates = np.flatnonzero((value[:-1] <= 0) & (value[1:] > 0))
    return candidates[np.searchsorted(candidates, risen) - 1]


def crossing_times(time: Series, value: Series, before: NDArray[np.int64]) -> Series:
    """Times of linearly interpolated crossings between each sample in `before` and the next."""
    low, high = value[before], value[before + 1]
    return np.asarray(time[before] + (time[before + 1] - time[before]) * (-low / (high - low)))


def _weights(step: Series, gap: NDArray[np.bool_]) -> Series:
    """Time that each sample stands for: half of each neighbouring step that is not a gap."""
    half = np.where(gap, 0.0, step) / 2
    weight = np.concatenate((half, [0.0])) + np.concatenate(([0.0], half))
    return np.asarray(np.maximum(weight, 1e-6 * float(np.median(step))))


def _trend(time: Series, value: Series, weight: Series, kind: Detrend) -> tuple[Series, float]:
    """Trend at each sample, and its mean over time."""
    if kind == "none":
        return np.zeros_like(value), 0.0
    mean = float(np.average(value, weights=weight))
    if kind == "mean":
        return np.full_like(value, mean), mean
    centred = time - np.average(time, weights=weight)
    slope = np.average(centred * value, weights=weight) / np.average(centred**2, weights=weight)
    return np.asarray(mean + slope * centred), mean


def _typical_period(time: Series, value: Series) -> float:
    """Median distance of up-crossings, before gaps are known; the whole record when there is no wave."""
    crossings = crossing_times(time, value, up_crossings(value))
    return float(np.median(np.diff(crossings))) if crossings.size > 1 else float(time[-1] - time[0])
