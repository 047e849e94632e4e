"""Wave spectra, and the components that stand for them in a sea of linear waves.

A spectrum is cut into bands of equal width. Each band gets one component, at a frequency drawn within the
band (so that the sea does not repeat itself) and with a random phase. Amplitudes are deterministic, so that each
band has exactly its energy, or random (Rayleigh; Tucker et al. 1984), so that realisations differ as
finite records of a real sea do. What the cut at both ends takes away is given back by scaling: the sea's
Hm0 is the asked one.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.special import betaincinv

from thermacq_drivers.simflume.component_sea import Components
from thermacq_drivers.simflume.dispersion import wavenumber
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.surfaces import Floats

_POINTS_PER_BAND = 32
STEEPEST_SEA = 1 / 15
"""Hm0 over the wavelength of the peak at which a sea breaks all over (DNV-RP-C205, 3.5.4)."""


def pierson_moskowitz(frequency_hz: Floats, peak_frequency_hz: float) -> Floats:
    """Shape of the Pierson-Moskowitz spectrum, without unit; multiply so that it has the energy wanted."""
    ratio = peak_frequency_hz / frequency_hz
    shape: Floats = ratio**5 * np.exp(-1.25 * ratio**4)
    return shape


def jonswap(frequency_hz: Floats, peak_frequency_hz: float, peak_enhancement: float = 3.3) -> Floats:
    """Shape of the JONSWAP spectrum (Hasselmann et al. 1973), without unit."""
    width = np.where(frequency_hz <= peak_frequency_hz, 0.07, 0.09)
    offset = (frequency_hz / peak_frequency_hz - 1) / width
    enhancement: Floats = peak_enhancement ** np.exp(-0.5 * offset**2)
    return pierson_moskowitz(frequency_hz, peak_frequency_hz) * enhancement


def white(frequency_hz: Floats) -> Floats:
    """Shape of a white spectrum, without unit."""
    return np.ones(frequency_hz.shape)


def spread_directions(quantiles: Floats, exponent: float) -> Floats:
    """Directions in rad about +x, so that uniform quantiles in (0, 1) follow cos^2s(θ/2), s the exponent.

    With u = (1 + sin(θ/2)) / 2 the density becomes that of the beta distribution, (u (1 - u))^(s - 1/2).
    """
    place = betaincinv(exponent + 0.5, exponent + 0.5, quantiles)
    return np.asarray(2 * np.arcsin(2 * place - 1), np.float64)


def draw_components(
    shape: Callable[[Floats], Floats],
    band_hz: tuple[float, float],
    significant_wave_height_m: float,
    count: int,
    depth_m: float,
    seed: int,
    random_amplitudes: bool = False,
    spreading: float | None = None,
) -> Components:
    """Components that stand for a spectrum.

    Parameters
    ----------
    shape
        Spectrum as a function of frequency in Hz, of any scale.
    band_hz
        Lowest and highest frequency.
    significant_wave_height_m
        Hm0 of the spectrum within the band.
    count
        Number of components.
    depth_m
        Depth of the still water.
    seed
        Seed of the scene.
    random_amplitudes
        Rayleigh amplitudes, whose Hm0 scatters about the asked one, instead of deterministic ones.
    spreading
        Exponent s of cos^2s(θ/2); None for long-crested waves along +x.
    """
    random = generator(seed, "sea")
    edges = np.linspace(*band_hz, count + 1)
    within = (np.arange(_POINTS_PER_BAND) + 0.5) / _POINTS_PER_BAND
    energy = shape(edges[:-1, None] + within * (edges[1] - edges[0])).sum(axis=1)
    energy *= (significant_wave_height_m / 4) ** 2 / energy.sum()
    frequency_hz = edges[:-1] + random.uniform(0, 1, count) * (edges[1] - edges[0])
    phase = random.uniform(0, 2 * math.pi, count)
    amplitude = np.sqrt(2 * energy)
    if random_amplitudes:
        # The mean square of a Rayleigh variable of scale 1 is 2.
        amplitude = np.sqrt(energy) * random.rayleigh(1.0, count)
    direction = np.zeros(count)
    if spreading is not None:
        # Stratified and shuffled: the sea as a whole has the spreading, and so has each part of the band.
        direction = spread_directions((random.permutation(count) + 0.5) / count, spreading)
    omega = 2 * math.pi * frequency_hz
    k = wavenumber(omega, depth_m)
    return Components(amplitude, omega, k * np.cos(direction), k * np.sin(direction), phase, depth_m)


def check_sea(significant_wave_height_m: float, peak_period_s: float, depth_m: float) -> None:
    """Refuse a sea that would break all over; raises `ValueError`."""
    length_m = 2 * math.pi / float(wavenumber(2 * math.pi / peak_period_s, depth_m))
    highest_m = STEEPEST_SEA * length_m * math.tanh(2 * math.pi * depth_m / length_m)
    if significant_wave_height_m > highest_m:
        raise ValueError(
            f"a sea of Hm0 = {significant_wave_height_m:g} m is too high: seas with a peak period of "
            f"{peak_period_s:g} s in {depth_m:g} m of water break above {highest_m:.3f} m"
        )
