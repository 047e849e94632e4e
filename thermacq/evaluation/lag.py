"""Bringing two series to common times, and the lag of one behind the other: estimated, never applied here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermacq.evaluation.series import Series, prepare
from thermacq.evaluation.waves import fit_harmonic

# A step of the reference longer than this many median steps is a gap that is not interpolated across.
_GAP_STEPS = 3.0


@dataclass(frozen=True)
class Lag:
    """Time lag of the measured series behind the reference; positive when it comes later.

    Parameters
    ----------
    lag_s
        Lag of the highest cross-correlation within half a mean period either way.
    correlation
        The correlation at that lag.
    phase_deg
        Phase lag of the first harmonic at the reference's mean period, degrees in (-180, 180].
    applied
        Whether the measured series was shifted by `lag_s` before it was compared.
    """

    lag_s: float
    correlation: float
    phase_deg: float
    applied: bool


def estimate_lag(
    time_s: Series, measured_m: Series, reference_time_s: Series, reference_m: Series, period_s: float
) -> Lag:
    """Lag of the measured series behind the reference, by cross-correlation and by first harmonics.

    Parameters
    ----------
    time_s, measured_m
        (times,) seconds, metres, NaN where missing.
    reference_time_s, reference_m
        (samples,) seconds, metres, NaN where missing.
    period_s
        Mean period; lags up to half of it are searched, in quarters of a step, refined by a parabola.
    """
    step = float(np.median(np.diff(time_s))) / 4
    reach = max(1, round(period_s / 2 / step))
    lags = step * np.arange(-reach, reach + 1)
    scores = np.array([_correlation(measured_m, reference_time_s, reference_m, time_s - lag) for lag in lags])
    best = int(np.nanargmax(scores)) if np.isfinite(scores).any() else reach
    shift = 0.0
    if 0 < best < lags.size - 1:
        low, top, high = scores[best - 1 : best + 2]
        curvature = low - 2 * top + high
        shift = 0.5 * (low - high) / curvature if curvature < 0 else 0.0
    _, phase = harmonic_at(time_s, measured_m, period_s)
    _, reference_phase = harmonic_at(
        time_s, interpolate_reference(reference_time_s, reference_m, time_s), period_s
    )
    turned = np.angle(np.exp(1j * (phase - reference_phase)), deg=True)
    return Lag(float(lags[best] + shift * step), float(scores[best]), float(turned), applied=False)


def interpolate_reference(reference_time_s: Series, reference_m: Series, time_s: Series) -> Series:
    """Linear interpolation of the finite samples; NaN outside and across gaps of over three median steps."""
    known = np.isfinite(reference_m)
    time, value = reference_time_s[known], reference_m[known]
    result = np.interp(time_s, time, value, left=np.nan, right=np.nan)
    step = np.diff(time)
    after = np.clip(np.searchsorted(time, time_s, side="right"), 1, time.size - 1)
    across = step[after - 1] > _GAP_STEPS * np.median(step)
    on_sample = (time_s == time[after]) | (time_s == time[after - 1])
    return np.asarray(np.where(across & ~on_sample, np.nan, result))


def _correlation(measured: Series, reference_time: Series, reference: Series, at: Series) -> float:
    shifted = interpolate_reference(reference_time, reference, at)
    both = np.isfinite(measured) & np.isfinite(shifted)
    if np.count_nonzero(both) < 3 or np.ptp(measured[both]) == 0 or np.ptp(shifted[both]) == 0:
        return float("nan")
    return float(np.corrcoef(measured[both], shifted[both])[0, 1])


def harmonic_at(time: Series, value: Series, period_s: float) -> tuple[float, float]:
    """Amplitude (metres) and phase (radians) of a series with missing samples at one period."""
    fit = fit_harmonic(prepare(time, value), period_s)
    return fit.amplitude_m, fit.phase_rad
