"""Counts per kelvin (signal transfer function, SiTF) from uniform views of known temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermacq_calibration.errors import CalibrationError


@dataclass(frozen=True)
class RadiometricScale:
    """A straight line through views of known temperature.

    Parameters
    ----------
    counts_per_kelvin
        Its slope, the SiTF.
    kelvin_at_zero
        Temperature of zero counts.
    residual_k
        Largest distance of a view from the line; 0 for two views, which say nothing about it.
    slope_error
        Standard error of the slope, counts per kelvin; None for two views.
    """

    counts_per_kelvin: float
    kelvin_at_zero: float
    residual_k: float
    slope_error: float | None


def radiometric_scale(temperatures_k: Sequence[float], counts: Sequence[float]) -> RadiometricScale:
    """Straight line of mean counts over temperature, by least squares.

    The slope of Planck's law in 8 to 14 µm grows by about 0.9 % per kelvin, so a line holds over a narrow span
    only; `residual_k` of at least three views tells how well.

    Parameters
    ----------
    temperatures_k, counts
        One value per view.

    Raises
    ------
    CalibrationError
        Fewer than two temperatures, or counts that do not rise with them.
    """
    if len(set(temperatures_k)) < 2 or len(temperatures_k) != len(counts):
        raise CalibrationError("counts per kelvin need views of at least two known temperatures")
    kelvin, level = np.asarray(temperatures_k, float), np.asarray(counts, float)
    from_middle = kelvin - kelvin.mean()
    slope = float(from_middle @ level / (from_middle @ from_middle))
    if not slope > 0:
        raise CalibrationError("counts do not rise with the temperature of the views")
    rest = level - level.mean() - slope * from_middle
    freedom = len(kelvin) - 2
    return RadiometricScale(
        counts_per_kelvin=slope,
        kelvin_at_zero=float(kelvin.mean() - level.mean() / slope),
        residual_k=float(np.abs(rest).max() / slope) if freedom else 0.0,
        slope_error=float(np.sqrt(rest @ rest / freedom / (from_middle @ from_middle))) if freedom else None,
    )
