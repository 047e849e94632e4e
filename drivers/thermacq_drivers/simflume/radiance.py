"""Thermal radiance at 8-14 µm: Planck's law, and what water emits and reflects at any angle.

Radiance is stated in kelvin: the difference from a black body at the water's temperature T0, divided by
the slope dL/dT there. This apparent temperature is exactly linear in radiance, as a bolometer is, and equals
the temperature near T0 (a black body 2 K warmer reads 2.02 K).

The band is taken as flat from 8 to 14 µm. Reflectance is Fresnel's for unpolarised light at a smooth
surface of complex index n + ik, averaged over the band with Planck's radiance at 295 K as weight. Water's
index is that of Hale and Querry, Appl. Opt. 12, 555 (1973), at 25 °C.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermacq_drivers.simflume.surfaces import Floats

BAND_UM = (8.0, 14.0)
WATER_INDEX = np.array(
    [
        (8.0, 1.291, 0.0343),
        (8.4, 1.281, 0.0361),
        (8.8, 1.269, 0.0385),
        (9.2, 1.255, 0.0415),
        (9.6, 1.239, 0.0454),
        (10.0, 1.218, 0.0508),
        (10.5, 1.185, 0.0662),
        (11.0, 1.153, 0.0968),
        (11.5, 1.126, 0.142),
        (12.0, 1.111, 0.199),
        (12.5, 1.123, 0.259),
        (13.0, 1.146, 0.305),
        (13.5, 1.177, 0.343),
        (14.0, 1.210, 0.370),
    ]
)
"""(14, 3) wavelength in µm, n, k (Hale and Querry 1973)."""

_C1_W_UM4_M2_SR = 1.191042972e8
_C2_UM_K = 1.438776877e4
_WEIGHT_K = 295.0
_WAVELENGTHS = 241
_COSINES = 2049


def band_radiance(temperature_k: ArrayLike) -> Floats:
    """Radiance of a black body between 8 and 14 µm, W/(m² sr), of the shape of the temperatures."""
    wavelength = np.linspace(*BAND_UM, _WAVELENGTHS)
    spectral = _spectral_radiance(wavelength, np.asarray(temperature_k, np.float64)[..., None])
    return np.asarray(np.trapezoid(spectral, wavelength, axis=-1))


def _spectral_radiance(wavelength_um: Floats, temperature_k: Floats) -> Floats:
    """Planck's law, W/(m² sr µm)."""
    return _C1_W_UM4_M2_SR / wavelength_um**5 / np.expm1(_C2_UM_K / (wavelength_um * temperature_k))


def apparent_rise(temperature_k: ArrayLike, reference_k: float) -> Floats:
    """Radiance of a black body in kelvin above that of one at the reference; see this module's text."""
    step = 0.01
    low, here, high = band_radiance(reference_k + np.array([-step, 0.0, step]))
    rise: Floats = (band_radiance(temperature_k) - here) * (2 * step / (high - low))
    return rise


def apparent_curvature(reference_k: float) -> float:
    """Curvature c, 1/K, in `apparent_rise` of a black body d kelvin warmer, d + c d².

    Good to 3 mK within 10 K, to 0.1 mK within 3 K: the skin of the water stays within it.
    """
    rise = apparent_rise(reference_k + np.array([-3.0, 3.0]), reference_k)
    return float(rise.sum()) / 18.0


def fresnel(cosine: ArrayLike, n: ArrayLike, k: ArrayLike) -> tuple[Floats, Floats]:
    """Reflectances (s, p) of a smooth surface of complex index n + ik, seen from air.

    Parameters
    ----------
    cosine
        Cosine of the angle between ray and normal, 0 to 1.
    n, k
        Refractive index and extinction coefficient; broadcast against the cosine.
    """
    cosine = np.asarray(cosine, np.float64)
    index = np.asarray(n) + 1j * np.asarray(k)
    inside = np.sqrt(index**2 - (1 - cosine**2))
    s = np.abs((cosine - inside) / (cosine + inside)) ** 2
    p = np.abs((index**2 * cosine - inside) / (index**2 * cosine + inside)) ** 2
    return s, p


def water_reflectance(cosine: ArrayLike) -> Floats:
    """Reflectance of smooth pure water for unpolarised light, averaged over the band."""
    wavelength, n, k = WATER_INDEX.T
    s, p = fresnel(np.asarray(cosine, np.float64)[..., None], n, k)
    weight = _spectral_radiance(wavelength, np.array(_WEIGHT_K))
    averaged = np.trapezoid(0.5 * (s + p) * weight, wavelength, axis=-1)
    return np.asarray(averaged / np.trapezoid(weight, wavelength))


class WaterSkin:
    """Emissivity of water whose emissivity at normal incidence is given.

    Pure water has 0.985 by Fresnel's equations; handbooks and the paper state about 0.95, which holds for
    water with a film or ripples too small to see. The angular dependence is Fresnel's in either case:
    ε(θ) = ε(0) · ε_F(θ) / ε_F(0). Reflectance is 1 - ε, all of it specular: the worst case.

    Parameters
    ----------
    emissivity
        Emissivity at normal incidence.
    """

    def __init__(self, emissivity: float) -> None:
        self._cosine, fresnel_emissivity = _emissivity_table()
        self._emissivity = fresnel_emissivity * (emissivity / fresnel_emissivity[-1])

    def emissivity(self, cosine: Floats) -> Floats:
        """Emissivity for the cosine of the angle of incidence."""
        found: Floats = np.interp(cosine, self._cosine, self._emissivity)
        return found


@cache
def _emissivity_table() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    cosine = np.linspace(0.0, 1.0, _COSINES)
    return cosine, 1 - water_reflectance(cosine)
