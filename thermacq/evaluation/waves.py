"""Wave statistics of an elevation series: single waves between zero crossings, spectral moments, harmonics.

Conventions, stated in every result:

- The mean (or a straight line) is removed first, with samples weighted by the time that they stand for.
- A wave lies between two crossings of the same direction; crossings are interpolated linearly.
- Crest and trough are vertices of parabolas through the extreme sample and its neighbours (or, when asked
  for, the extreme samples themselves, which lie lower by up to 0.6 % at 28 samples a period).
- A wave that touches a gap (see `thermacq.evaluation.series`) is not counted.

Samples need not be evenly spaced. Times in seconds, elevations in metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from thermacq.evaluation.series import (
    Detrend,
    PreparedSeries,
    Series,
    WaveError,
    crossing_times,
    prepare,
    up_crossings,
)

Crossing: TypeAlias = Literal["up", "down"]
Crest: TypeAlias = Literal["parabola", "sample"]

# Spectral moments stop at this multiple of the mean frequency, or white noise would rule the second one.
_BAND = 10.0
_PERIODS_PER_SEGMENT = 32
_ZERO_PADDING = 8


@dataclass(frozen=True)
class Waves:
    """Single waves, arrays (waves,) float64, in order of time.

    `start_s` is the crossing that begins the wave; crest and trough are measured from the removed trend.
    `lost_to_gaps` counts the waves that were left out because they touch a gap.
    """

    start_s: Series
    period_s: Series
    crest_m: Series
    trough_m: Series
    crossing: Crossing
    lost_to_gaps: int

    @property
    def height_m(self) -> Series:
        """Crest-to-trough heights, (waves,) metres."""
        return self.crest_m - self.trough_m


@dataclass(frozen=True)
class Harmonic:
    """Least-squares fit of ``mean + amplitude cos(2 pi t / period - phase)``."""

    period_s: float
    amplitude_m: float
    phase_rad: float
    mean_m: float
    residual_m: float


@dataclass(frozen=True)
class WaveStatistics:
    """Statistics of one series; every definition is named in `docs/reference/statistics.md`.

    Heights in metres, periods in seconds. `sem` values are standard errors of the mean: the spread between
    waves divided by the root of their number; NaN for a single wave.
    """

    crossing: Crossing
    detrend: Detrend
    crest: Crest
    dead_band_m: float
    samples: int
    missing: int
    gaps: int
    duration_s: float
    mean_m: float
    waves: int
    waves_lost_to_gaps: int
    mean_height_m: float
    mean_height_sem_m: float
    significant_height_m: float
    rms_height_m: float
    max_height_m: float
    spectral_height_m: float
    mean_period_s: float
    mean_period_sem_s: float
    shortest_period_s: float
    spectral_period_s: float
    peak_period_s: float
    first_harmonic_amplitude_m: float


def single_waves(
    series: PreparedSeries,
    crossing: Crossing = "up",
    crest: Crest = "parabola",
    dead_band_m: float = 0.0,
) -> Waves:
    """Waves between zero up-crossings (or down-crossings).

    Parameters
    ----------
    series
        A prepared series.
    crossing
        Direction of the crossings.
    crest
        Whether crest and trough are interpolated by parabolas or the extreme samples are taken.
    dead_band_m
        Crossings by less than this either way are not counted, so that noise at the zero level makes no
        waves; 0 counts every crossing.

    Raises
    ------
    WaveError
        There is no complete wave.
    """
    value = series.elevation_m if crossing == "up" else -series.elevation_m
    before = up_crossings(value, dead_band_m)
    cross_s = crossing_times(series.time_s, value, before)
    gaps_until = np.concatenate(([0], np.cumsum(series.gap)))
    # A wave needs the steps from its first crossing to its last one, both included, free of gaps.
    whole = gaps_until[before[1:] + 1] == gaps_until[before[:-1]]
    if not whole.any():
        raise WaveError(
            "the series holds no complete wave",
            remedy="A wave needs two zero crossings of the same direction and no gap between them.",
        )
    first, last = before[:-1][whole] + 1, before[1:][whole] + 1
    extreme = _vertex if crest == "parabola" else _sample
    value = series.elevation_m
    spans = list(zip(first.tolist(), last.tolist(), strict=True))
    return Waves(
        start_s=cross_s[:-1][whole],
        period_s=np.diff(cross_s)[whole],
        crest_m=np.array([extreme(series, a + int(np.argmax(value[a:b])), 1) for a, b in spans]),
        trough_m=np.array([extreme(series, a + int(np.argmin(value[a:b])), -1) for a, b in spans]),
        crossing=crossing,
        lost_to_gaps=int(np.count_nonzero(~whole)),
    )


def fit_harmonic(series: PreparedSeries, period_s: float) -> Harmonic:
    """Amplitude and phase at one period, by weighted least squares.

    Parameters
    ----------
    series
        A prepared series.
    period_s
        Period of the harmonic, seconds.
    """
    angle = 2 * np.pi * series.time_s / period_s
    root = np.sqrt(series.weight_s)
    design = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    mean, cosine, sine = np.linalg.lstsq(design * root[:, None], series.elevation_m * root, rcond=None)[0]
    residual = series.elevation_m - design @ np.array([mean, cosine, sine])
    return Harmonic(
        period_s=period_s,
        amplitude_m=float(np.hypot(cosine, sine)),
        phase_rad=float(np.arctan2(sine, cosine)),
        mean_m=float(mean),
        residual_m=float(np.sqrt(np.average(residual**2, weights=series.weight_s))),
    )


def spectrum(series: PreparedSeries, period_s: float) -> tuple[Series, Series]:
    """One-sided spectral density of the longest stretch without a gap.

    The stretch is brought to even steps of the median length by linear interpolation; Welch's method with
    Hann segments of 32 periods (or the whole stretch if shorter), half overlapping, zero-padded eightfold.

    Parameters
    ----------
    series
        A prepared series.
    period_s
        Typical period; only sets the length of the segments.

    Returns
    -------
    frequency_hz, density
        (bins,) hertz and square metres per hertz.
    """
    from scipy.signal import welch

    edges = np.concatenate(([0], np.flatnonzero(series.gap) + 1, [series.time_s.size]))
    longest = int(np.argmax(np.diff(edges)))
    time = series.time_s[edges[longest] : edges[longest + 1]]
    value = series.elevation_m[edges[longest] : edges[longest + 1]]
    step = float(np.median(np.diff(time)))
    even = time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1e-6) + 1)
    segment = min(even.size, max(8, round(_PERIODS_PER_SEGMENT * period_s / step)))
    frequency, density = welch(
        np.interp(even, time, value),
        1 / step,
        nperseg=segment,
        nfft=_ZERO_PADDING * segment,
        detrend="constant",
    )
    return np.asarray(frequency), np.asarray(density)


def wave_statistics(
    time_s: ArrayLike,
    elevation_m: ArrayLike,
    *,
    crossing: Crossing = "up",
    detrend: Detrend = "mean",
    crest: Crest = "parabola",
    dead_band_m: float = 0.0,
) -> WaveStatistics:
    """All statistics of one elevation series.

    Parameters
    ----------
    time_s
        (samples,) seconds, increasing; steps may differ.
    elevation_m
        (samples,) metres, NaN where missing.
    crossing
        Direction of the zero crossings that bound a wave.
    detrend
        What is removed before crossings are sought.
    crest
        Whether crests and troughs are interpolated.
    dead_band_m
        As in `single_waves`.

    Raises
    ------
    WaveError
        The series cannot be analysed; the message says why.
    """
    series = prepare(time_s, elevation_m, detrend)
    waves = single_waves(series, crossing, crest, dead_band_m)
    height, period = waves.height_m, waves.period_s
    mean_period = float(period.mean())
    peak_period, spectral_period = _spectral_periods(*spectrum(series, mean_period), _BAND / mean_period)
    third = np.sort(height)[-max(1, round(height.size / 3)) :]
    variance = float(np.average(series.elevation_m**2, weights=series.weight_s))
    return WaveStatistics(
        crossing=crossing,
        detrend=detrend,
        crest=crest,
        dead_band_m=dead_band_m,
        samples=series.time_s.size,
        missing=series.missing,
        gaps=int(np.count_nonzero(series.gap)),
        duration_s=float(series.time_s[-1] - series.time_s[0]),
        mean_m=series.removed_m,
        waves=height.size,
        waves_lost_to_gaps=waves.lost_to_gaps,
        mean_height_m=float(height.mean()),
        mean_height_sem_m=_standard_error(height),
        significant_height_m=float(third.mean()),
        rms_height_m=float(np.sqrt(np.mean(height**2))),
        max_height_m=float(height.max()),
        spectral_height_m=4 * float(np.sqrt(variance)),
        mean_period_s=mean_period,
        mean_period_sem_s=_standard_error(period),
        shortest_period_s=float(period.min()),
        spectral_period_s=spectral_period,
        peak_period_s=peak_period,
        first_harmonic_amplitude_m=fit_harmonic(series, mean_period).amplitude_m,
    )


def _vertex(series: PreparedSeries, index: int, sign: int) -> float:
    """Extreme value near a sample: vertex of the parabola through it and its neighbours."""
    sample = float(series.elevation_m[index])
    if index in (0, series.time_s.size - 1) or series.gap[index - 1] or series.gap[index]:
        return sample
    t0, t1 = series.time_s[index - 1 : index + 2 : 2] - series.time_s[index]
    y0, y1 = series.elevation_m[index - 1 : index + 2 : 2] - sample
    curvature = (y1 / t1 - y0 / t0) / (t1 - t0)
    if sign * curvature >= 0:
        return sample
    slope = y0 / t0 - curvature * t0
    vertex = -slope / (2 * curvature)
    if not t0 <= vertex <= t1:
        return sample
    return sample + float(slope * vertex / 2)


def _sample(series: PreparedSeries, index: int, _sign: int) -> float:
    return float(series.elevation_m[index])


def _spectral_periods(frequency: Series, density: Series, limit_hz: float) -> tuple[float, float]:
    """Peak period (parabola through the logarithm of the peak) and Tm02 of the band up to a limit."""
    peak = 1 + int(np.argmax(density[1:-1]))
    low, top, high = np.log(np.maximum(density[peak - 1 : peak + 2], 1e-300))
    curvature = low - 2 * top + high
    shift = 0.5 * (low - high) / curvature if curvature < 0 else 0.0
    peak_hz = float(frequency[peak] + shift * (frequency[1] - frequency[0]))
    band = frequency <= limit_hz
    zeroth = np.sum(density[band])
    second = np.sum(density[band] * frequency[band] ** 2)
    return 1 / peak_hz, float(np.sqrt(zeroth / second))


def _standard_error(values: Series) -> float:
    return float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")
