"""Wave groups as sums of linear waves: two waves that beat, a Gaussian envelope, a focused group."""

from __future__ import annotations

import math

import numpy as np

from thermacq_drivers.simflume.component_sea import Components
from thermacq_drivers.simflume.dispersion import wavenumber
from thermacq_drivers.simflume.spectra import jonswap
from thermacq_drivers.simflume.surfaces import Floats

_COUNT = 96
_WIDTHS = 4.0
# Standard deviations of the Gaussian spectrum to each side; the waves left out have 3e-4 of the amplitude.
STEEPEST_GROUP = 0.30
"""Σ a k at which focused groups begin to break (Rapp and Melville 1990: 0.25 to 0.39, by bandwidth)."""


def bichromatic(amplitude_m: float, period_s: float, bandwidth: float, depth_m: float) -> Components:
    """Two waves of half the amplitude each, with frequencies f (1 ± bandwidth / 2); crests meet at the focus."""
    frequency_hz = np.array([1 - bandwidth / 2, 1 + bandwidth / 2]) / period_s
    return _at_origin(np.full(2, amplitude_m / 2), frequency_hz, depth_m)


def gaussian_group(amplitude_m: float, period_s: float, bandwidth: float, depth_m: float) -> Components:
    """A group with a Gaussian envelope in time of standard deviation 1 / (2π f bandwidth) at the focus."""
    reach = min(_WIDTHS * bandwidth, 0.95)
    frequency_hz = np.linspace(1 - reach, 1 + reach, _COUNT) / period_s
    shape = np.exp(-0.5 * ((frequency_hz * period_s - 1) / bandwidth) ** 2)
    return _at_origin(amplitude_m * shape / shape.sum(), frequency_hz, depth_m)


def focused_group(amplitude_m: float, period_s: float, depth_m: float) -> Components:
    """The mean shape of the highest crest of a JONSWAP sea (NewWave, Tromans et al. 1991)."""
    frequency_hz = np.linspace(0.5, 3.0, _COUNT) / period_s
    shape = jonswap(frequency_hz, 1 / period_s)
    return _at_origin(amplitude_m * shape / shape.sum(), frequency_hz, depth_m)


def focus(waves: Components, x_m: float, time_s: float) -> Components:
    """The same waves with all crests at one place and time, instead of the origin at t = 0."""
    phase = waves.omega_rad_s * time_s - waves.along_rad_m * x_m
    return Components(
        waves.amplitude_m, waves.omega_rad_s, waves.along_rad_m, waves.across_rad_m, phase, waves.depth_m
    )


def check_group(waves: Components) -> None:
    """Refuse a group that would break where it focuses; raises `ValueError`."""
    steepness = float(waves.amplitude_m @ waves.wavenumber_rad_m)
    if steepness > STEEPEST_GROUP:
        raise ValueError(
            f"the group is too steep: Σ a k = {steepness:.2f} at its focus, such groups break "
            f"above {STEEPEST_GROUP:g}"
        )


def _at_origin(amplitude_m: Floats, frequency_hz: Floats, depth_m: float) -> Components:
    omega = 2 * math.pi * frequency_hz
    zero = np.zeros(len(omega))
    return Components(amplitude_m, omega, wavenumber(omega, depth_m), zero, zero, depth_m)
