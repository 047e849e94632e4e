"""Dispersion of linear water waves, and how steep waves can be."""

from __future__ import annotations

import math

import numpy as np

from thermacq_drivers.simflume.regular_wave import GRAVITY_M_S2
from thermacq_drivers.simflume.surfaces import Floats

_STEPS = 20
MICHE = 0.142
"""Steepness H/λ of the steepest regular wave in deep water (Miche 1944)."""


def wavenumber(omega_rad_s: Floats | float, depth_m: float) -> Floats:
    """Wavenumber from ω² = g k tanh(k d), by Newton's method to rounding error.

    Parameters
    ----------
    omega_rad_s
        Angular frequencies, above 0.
    depth_m
        Depth of the still water.

    Returns
    -------
    numpy.ndarray
        float64 of the same shape, rad/m.
    """
    deep = np.asarray(omega_rad_s, np.float64) ** 2 * depth_m / GRAVITY_M_S2
    # First guess exact for long and for short waves.
    kd = deep / np.sqrt(np.tanh(deep))
    for _ in range(_STEPS):
        tanh = np.tanh(kd)
        step = (kd * tanh - deep) / (tanh + kd * (1 - tanh**2))
        kd = kd - step
        if np.all(np.abs(step) <= 1e-15 * kd):
            break
    return np.asarray(kd / depth_m, np.float64)


def frequency(wavenumber_rad_m: float, depth_m: float) -> float:
    """Angular frequency in rad/s of a wave with this wavenumber."""
    return math.sqrt(GRAVITY_M_S2 * wavenumber_rad_m * math.tanh(wavenumber_rad_m * depth_m))


def group_speed(omega_rad_s: float, depth_m: float) -> float:
    """Speed dω/dk in m/s at which wave energy travels."""
    k = float(wavenumber(omega_rad_s, depth_m))
    kd = k * depth_m
    # 2 kd / sinh 2kd, without overflow in deep water.
    shallow = 4 * kd * math.exp(-2 * kd) / (1 - math.exp(-4 * kd))
    return omega_rad_s / k * (1 + shallow) / 2


def breaking_height(period_s: float, depth_m: float) -> float:
    """Height in metres at which regular waves of this period break (Miche)."""
    k = float(wavenumber(2 * math.pi / period_s, depth_m))
    return MICHE * 2 * math.pi / k * math.tanh(k * depth_m)
