"""Agreement of two simultaneous elevation series: stereo against probe, or either against a known truth.

The reference (probe) is taken as the target, as in the paper (eq. 4, Fig. 14e, Tables IV and V); because both
series carry errors, an orthogonal fit, Bland-Altman limits and block-bootstrap intervals stand beside it.
A time lag is estimated and reported; it is taken out only when asked for, and then the result says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermacq.evaluation.lag import Lag, estimate_lag, harmonic_at, interpolate_reference
from thermacq.evaluation.series import Detrend, Series, WaveError
from thermacq.evaluation.waves import Crossing, WaveStatistics, wave_statistics

Interval: TypeAlias = tuple[float, float]

CONFIDENCE = 0.95
_NORMAL_95 = 1.959964
_MEASURES = ("slope", "orthogonal_slope", "r_squared", "bias_m", "rmse_m")


@dataclass(frozen=True)
class Agreement:
    """How well paired samples agree; metres, measured minus reference.

    Parameters
    ----------
    samples
        Number of pairs.
    slope, intercept_m
        Least-squares line measured = slope * reference + intercept (Fig. 14e).
    orthogonal_slope, orthogonal_intercept_m
        Line of least squared distances, both series carrying equal errors.
    r_squared
        The paper's eq. 4: 1 - sum (p - s)² / sum (p - mean p)².
    correlation
        Pearson's coefficient.
    bias_m, rmse_m, difference_sd_m
        Mean, root mean square and standard deviation of the difference.
    limits_m
        Bland-Altman limits of agreement, bias ± 1.96 standard deviations.
    intervals
        95 % percentile intervals of the moving-block bootstrap, by the name of the measure; NaN when the
        record is shorter than two blocks.
    block_s, resamples, seed
        How the bootstrap was done.
    """

    samples: int
    slope: float
    intercept_m: float
    orthogonal_slope: float
    orthogonal_intercept_m: float
    r_squared: float
    correlation: float
    bias_m: float
    rmse_m: float
    difference_sd_m: float
    limits_m: Interval
    intervals: dict[str, Interval]
    block_s: float
    resamples: int
    seed: int


@dataclass(frozen=True)
class Comparison:
    """One measured series against one reference, over the time that both cover.

    Parameters
    ----------
    measured_name, reference_name
        What is compared with what, for tables.
    time_s, measured_m, reference_m
        (times,) the series at the times of the measured one; NaN where either is missing.
    missing_fraction
        Part of the measured samples in the common time that is NaN.
    agreement, lag
        See there.
    measured_waves, reference_waves
        Statistics of each series over the common time at its own sampling.
    amplitude_ratio
        First-harmonic amplitude of the measured series divided by that of the reference, both at the
        reference's mean period.
    """

    measured_name: str
    reference_name: str
    time_s: Series
    measured_m: Series
    reference_m: Series
    missing_fraction: float
    agreement: Agreement
    lag: Lag
    measured_waves: WaveStatistics
    reference_waves: WaveStatistics
    amplitude_ratio: float

    @property
    def height_error(self) -> float:
        """Relative error of the mean height, signed (Tables IV and V print its absolute value)."""
        return self.measured_waves.mean_height_m / self.reference_waves.mean_height_m - 1

    @property
    def period_error(self) -> float:
        """Relative error of the mean period, signed."""
        return self.measured_waves.mean_period_s / self.reference_waves.mean_period_s - 1


def compare_series(
    time_s: ArrayLike,
    measured_m: ArrayLike,
    reference_time_s: ArrayLike,
    reference_m: ArrayLike,
    *,
    measured_name: str = "stereo",
    reference_name: str = "probe",
    crossing: Crossing = "up",
    detrend: Detrend = "mean",
    dead_band_m: float = 0.0,
    apply_lag: bool = False,
    resamples: int = 1000,
    seed: int = 0,
) -> Comparison:
    """Compare a measured series with a reference that is sampled at other, usually denser, times.

    The reference is interpolated linearly to the times of the measured series, never across a gap.

    Parameters
    ----------
    time_s, measured_m
        (times,) seconds, metres; NaN where missing.
    reference_time_s, reference_m
        (samples,) seconds on the same clock, metres; NaN where missing.
    measured_name, reference_name
        Names for tables.
    crossing, detrend, dead_band_m
        As in `wave_statistics`; the agreement itself uses the series as they are.
    apply_lag
        Shift the measured series by the estimated lag first. The result says so.
    resamples, seed
        Of the bootstrap.

    Raises
    ------
    WaveError
        The series do not overlap, or hold no complete wave.
    """
    time, measured = _columns(time_s, measured_m, measured_name)
    reference_time, reference = _columns(reference_time_s, reference_m, reference_name)
    known = np.isfinite(reference)
    if np.count_nonzero(known) < 3:
        raise WaveError(
            f"{reference_name} holds {np.count_nonzero(known)} finite samples: too few to compare"
        )
    common = _common(time, reference_time[known])
    if np.count_nonzero(common & np.isfinite(measured)) < 3:
        raise WaveError(
            f"{measured_name} and {reference_name} hardly overlap in time: {_span(time, measured_name)}, "
            f"{_span(reference_time[known], reference_name)}",
            remedy="Check that both belong to the same recording and the same clock.",
        )
    analyse = partial(wave_statistics, crossing=crossing, detrend=detrend, dead_band_m=dead_band_m)
    shared = _common(reference_time, time[common])
    reference_waves = _named(reference_name, analyse, reference_time[shared], reference[shared])
    lag = estimate_lag(
        time[common], measured[common], reference_time, reference, reference_waves.mean_period_s
    )
    if apply_lag:
        lag = Lag(lag.lag_s, lag.correlation, lag.phase_deg, applied=True)
        time = time - lag.lag_s
        common = _common(time, reference_time[known])
    time, measured = time[common], measured[common]
    at_frames = interpolate_reference(reference_time, reference, time)
    block = max(2, round(reference_waves.mean_period_s / float(np.median(np.diff(time)))))
    paired = np.isfinite(measured) & np.isfinite(at_frames)
    period = reference_waves.mean_period_s
    return Comparison(
        measured_name=measured_name,
        reference_name=reference_name,
        time_s=time,
        measured_m=np.where(paired, measured, np.nan),
        reference_m=np.where(paired, at_frames, np.nan),
        missing_fraction=float(np.mean(~np.isfinite(measured))),
        agreement=agreement(
            measured[paired],
            at_frames[paired],
            block=block,
            block_s=block * float(np.median(np.diff(time))),
            resamples=resamples,
            seed=seed,
        ),
        lag=lag,
        measured_waves=_named(measured_name, analyse, time, measured),
        reference_waves=reference_waves,
        amplitude_ratio=harmonic_at(time, measured, period)[0] / harmonic_at(time, at_frames, period)[0],
    )


def agreement(
    measured_m: Series,
    reference_m: Series,
    *,
    block: int,
    block_s: float = float("nan"),
    resamples: int = 1000,
    seed: int = 0,
) -> Agreement:
    """Slope, R², bias, limits and bootstrap intervals of paired finite samples.

    Parameters
    ----------
    measured_m, reference_m
        (pairs,) float64, metres, finite, in order of time.
    block
        Length of a bootstrap block in samples; about one wave, because errors repeat with the wave.
    block_s
        The same in seconds, only reported.
    resamples, seed
        Of the bootstrap.

    Raises
    ------
    WaveError
        Fewer than three pairs, or a reference that does not vary.
    """
    if measured_m.size < 3 or float(np.ptp(reference_m)) == 0.0:
        raise WaveError("three pairs of a varying reference are the least that can be compared")
    # Sums about a common centre: differences of large numbers would cost digits.
    centre = float(reference_m.mean())
    terms = _terms(measured_m - centre, reference_m - centre)
    value = {name: float(values[0]) for name, values in _measures(terms.sum(axis=0)[None]).items()}
    difference = measured_m - reference_m
    spread = float(difference.std(ddof=1))
    mean_measured = float(measured_m.mean())
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = float(np.corrcoef(measured_m, reference_m)[0, 1])
    return Agreement(
        samples=measured_m.size,
        slope=value["slope"],
        intercept_m=mean_measured - value["slope"] * centre,
        orthogonal_slope=value["orthogonal_slope"],
        orthogonal_intercept_m=mean_measured - value["orthogonal_slope"] * centre,
        r_squared=value["r_squared"],
        correlation=correlation,
        bias_m=value["bias_m"],
        rmse_m=value["rmse_m"],
        difference_sd_m=spread,
        limits_m=(value["bias_m"] - _NORMAL_95 * spread, value["bias_m"] + _NORMAL_95 * spread),
        intervals=_bootstrap(terms, block, resamples, seed),
        block_s=block_s,
        resamples=resamples,
        seed=seed,
    )


def _terms(measured: Series, reference: Series) -> Series:
    """Per pair: 1, s, p, s², p², s p; every measure follows from the sums of these."""
    return np.stack(
        [np.ones_like(measured), measured, reference, measured**2, reference**2, measured * reference], axis=1
    )


def _measures(sums: Series) -> dict[str, Series]:
    """Measures from (sets, 6) sums of `_terms`."""
    n, s, p, ss, pp, sp = sums.T
    var_s, var_p, cov = ss - s * s / n, pp - p * p / n, sp - s * p / n
    squared = np.maximum(ss - 2 * sp + pp, 0.0)
    tilt = var_s - var_p
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            "slope": cov / var_p,
            "orthogonal_slope": (tilt + np.sqrt(tilt**2 + 4 * cov**2)) / (2 * cov),
            "r_squared": 1 - squared / var_p,
            "bias_m": (s - p) / n,
            "rmse_m": np.sqrt(squared / n),
        }


def _bootstrap(terms: Series, block: int, resamples: int, seed: int) -> dict[str, Interval]:
    """Percentile intervals of the moving-block bootstrap; blocks are drawn with replacement."""
    pairs = terms.shape[0]
    if pairs < 2 * block or resamples < 2:
        return dict.fromkeys(_MEASURES, (float("nan"), float("nan")))
    until = np.concatenate((np.zeros((1, terms.shape[1])), np.cumsum(terms, axis=0)))
    blocks = until[block:] - until[:-block]
    chosen = np.random.default_rng(seed).integers(blocks.shape[0], size=(resamples, round(pairs / block)))
    tail = (1 - CONFIDENCE) / 2
    drawn = _measures(blocks[chosen].sum(axis=1))
    return {
        name: (float(np.quantile(values, tail)), float(np.quantile(values, 1 - tail)))
        for name, values in drawn.items()
    }


def _named(
    name: str, analyse: Callable[[Series, Series], WaveStatistics], time: Series, value: Series
) -> WaveStatistics:
    """Wave statistics of a series whose name stands in the message when there are none."""
    try:
        return analyse(time, value)
    except WaveError as error:
        raise WaveError(f"{name}: {error.what}", remedy=error.remedy) from None


def _columns(time: ArrayLike, value: ArrayLike, name: str) -> tuple[Series, Series]:
    times, values = np.asarray(time, np.float64), np.asarray(value, np.float64)
    if times.ndim != 1 or times.shape != values.shape or times.size < 3:
        raise WaveError(f"{name}: times {times.shape} and values {values.shape} are not two equal columns")
    return times, values


def _common(time: Series, other: Series) -> NDArray[np.bool_]:
    return (
        np.asarray((time >= other.min()) & (time <= other.max()))
        if other.size
        else np.zeros(time.size, np.bool_)
    )


def _span(time: Series, name: str) -> str:
    return f"{name} from {time.min():.3f} to {time.max():.3f} s"
