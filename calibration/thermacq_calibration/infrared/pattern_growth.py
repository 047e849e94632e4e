"""How fixed-pattern noise grows with the age of a correction.

Its growth is a power law and a linear part of the time since the correction (SPIE 12533-0T); the coefficients
are those of a single camera and have to be measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermacq_calibration.errors import CalibrationError

FEWEST_AGES = 4
_EXPONENTS = np.arange(0.05, 0.96, 0.05)


@dataclass(frozen=True)
class PatternGrowth:
    """sigma_vh(age) = start + power * (age / 60 s)^exponent + linear * (age / 60 s), all in kelvin."""

    start_k: float
    power_k: float
    exponent: float
    linear_k: float

    def sigma_k(self, age_s: float) -> float:
        """Fixed-pattern noise at an age in seconds, kelvin."""
        minutes = max(0.0, age_s) / 60
        return float(self.start_k + self.power_k * minutes**self.exponent + self.linear_k * minutes)

    def growth_k(self, age_s: float, duration_s: float) -> float:
        """By how much it grows within a recording that begins at this age, kelvin."""
        return self.sigma_k(age_s + duration_s) - self.sigma_k(age_s)


def fit_growth(ages_s: Sequence[float], sigma_vh_k: Sequence[float]) -> PatternGrowth:
    """Law of growth from uniform views at several ages, by least squares; no part of it ever shrinks.

    Parameters
    ----------
    ages_s, sigma_vh_k
        Seconds since the correction, and fixed-pattern noise then (see `uniformity`), one value per view.

    Raises
    ------
    CalibrationError
        Fewer than `FEWEST_AGES` ages, or values that are negative or not finite.
    """
    from scipy.optimize import nnls

    minutes, sigma = np.asarray(ages_s, float) / 60, np.asarray(sigma_vh_k, float)
    if minutes.shape != sigma.shape or len(set(minutes.tolist())) < FEWEST_AGES:
        raise CalibrationError(f"the growth of fixed-pattern noise needs views at {FEWEST_AGES} ages or more")
    if not (np.isfinite(minutes).all() and np.isfinite(sigma).all() and min(minutes.min(), sigma.min()) >= 0):
        raise CalibrationError("ages and fixed-pattern noise must be finite and not negative")
    best, least = PatternGrowth(float(sigma.mean()), 0.0, 1.0, 0.0), np.inf
    for exponent in _EXPONENTS:
        parts = np.stack([np.ones_like(minutes), minutes**exponent, minutes], axis=1)
        (start, power, linear), rest = nnls(parts, sigma)
        if rest < least:
            best, least = PatternGrowth(float(start), float(power), float(exponent), float(linear)), rest
    return best
