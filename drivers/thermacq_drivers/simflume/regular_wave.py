"""Regular nonlinear waves: Fenton stream-function theory, with the drift of the water at the surface.

`raschii` solves for the coefficients; everything is then evaluated from Fourier series in the phase
k (x - c t), written as Chebyshev series in its cosine so that many harmonics cost one cosine.

Convention of the current: raschii (as Rienecker & Fenton 1981 with c = B0) gives a wave without mean
Eulerian current below the troughs. The water at the surface still moves on average: a steady wave seen
from a frame moving with it is a steady flow, so a surface particle needs the time
``G(θ) = ∫ dθ' / (c - u_s(θ'))`` to move back through the phase θ = x - c t. Hence
``s = c̃ (G(θ) + t)``, with ``c̃ = λ / G(λ)``, is constant along its path: a material label. It equals
x - (c - c̃) t plus a periodic part; U_L = c - c̃ is the Lagrangian mean drift (Stokes drift).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev
from scipy.optimize import brentq, newton

from thermacq_drivers.simflume.surfaces import Floats

GRAVITY_M_S2 = 9.81
ORDER = 8
"""Fourier terms of the stream function."""

_HARMONICS = 32
# Terms kept of the derived series (surface velocity, label); they fall below 1e-12 for all of Table II.

_STEEPEST = 0.85
# Part of the breaking steepness (Miche) up to which ORDER terms are enough.


@dataclass(frozen=True)
class RegularWave:
    """A long-crested regular wave running towards +x; make it with `solve_wave`.

    Parameters
    ----------
    period_s, length_m, height_m, celerity_m_s
        The wave: T, λ, H (crest to trough), c.
    drift_m_s
        Lagrangian mean drift at the surface, U_L.
    phase_rad
        Phase at x = 0, t = 0; 0 puts a crest there.
    elevation_series, velocity_series, label_series
        Coefficients a_j: eta = Σ a_j cos jφ in m, u_s = Σ a_j cos jφ in m/s, and
        s = x - U_L t + Σ a_j sin jφ in m, each starting with j = 0.
    """

    period_s: float
    length_m: float
    height_m: float
    celerity_m_s: float
    drift_m_s: float
    phase_rad: float
    elevation_series: tuple[float, ...]
    velocity_series: tuple[float, ...]
    label_series: tuple[float, ...]

    @property
    def wavenumber_rad_m(self) -> float:
        """Wavenumber k, rad/m."""
        return 2 * math.pi / self.length_m

    @property
    def highest_m(self) -> float:
        """Elevation of the crest."""
        return sum(self.elevation_series)

    @property
    def steepest(self) -> float:
        """Largest slope."""
        phase = np.linspace(0, math.pi, 721)
        return float(np.abs(self._slope(phase)).max())

    def _phase(self, x_m: Floats, time_s: Floats | float) -> Floats:
        # Elapsed periods are taken out first: the cosine of a large angle would lose digits.
        cycles = np.asarray(time_s, np.float64) / self.period_s
        return self.wavenumber_rad_m * x_m - 2 * math.pi * (cycles - np.floor(cycles)) + self.phase_rad

    def _slope(self, phase: Floats) -> Floats:
        derivative = chebyshev.chebder(np.array(self.elevation_series))
        slope: Floats = -self.wavenumber_rad_m * np.sin(phase) * chebyshev.chebval(np.cos(phase), derivative)
        return slope

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation above still water, metres."""
        phase = self._phase(x_m, time_s)
        eta: Floats = chebyshev.chebval(np.cos(phase), np.array(self.elevation_series))
        return eta + np.zeros(np.shape(y_m))

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope along x and along y."""
        along = self._slope(self._phase(x_m, time_s)) + np.zeros(np.shape(y_m))
        return along, np.zeros_like(along)

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Horizontal velocity (x, y) of the water at the surface, m/s."""
        phase = self._phase(x_m, time_s)
        along = chebyshev.chebval(np.cos(phase), np.array(self.velocity_series)) + np.zeros(np.shape(y_m))
        return along, np.zeros_like(along)

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Material coordinates (along x, along y) of the particle now at (x, y), metres."""
        phase = self._phase(x_m, time_s)
        # Σ a_j sin jφ = sin φ · d/dc Σ (a_j / j) T_j(c) at c = cos φ.
        series = np.array(self.label_series)
        series[1:] /= np.arange(1, len(series))
        periodic = np.sin(phase) * chebyshev.chebval(np.cos(phase), chebyshev.chebder(series))
        along = x_m - self.drift_m_s * np.asarray(time_s, np.float64) + periodic
        return along + np.zeros(np.shape(y_m)), y_m + np.zeros(np.shape(along))


@cache
def solve_wave(period_s: float, steepness: float, depth_m: float, phase_rad: float = 0.0) -> RegularWave:
    """Find the wave with this period and steepness.

    Parameters
    ----------
    period_s
        Period T, seconds.
    steepness
        H/λ.
    depth_m
        Depth of the still water, metres.
    phase_rad
        Phase at x = 0, t = 0; 0 puts a crest there.

    Raises
    ------
    ValueError
        The wave would break or nearly so (limit of Miche), or the solver does not converge.
    """
    import raschii

    linear_m = _linear_length(period_s, depth_m)
    breaking = 0.142 * math.tanh(2 * math.pi * depth_m / linear_m)
    if steepness > _STEEPEST * breaking:
        raise ValueError(
            f"steepness {steepness:g} is too high: waves of {period_s:g} s in {depth_m:g} m of water break "
            f"at {breaking:.3f}, and {ORDER} Fourier terms describe them up to {_STEEPEST * breaking:.3f}"
        )

    def fenton(length_m: float) -> raschii.FentonWave:
        return raschii.FentonWave(height=steepness * length_m, depth=depth_m, length=length_m, N=ORDER)

    # Stokes' third order is a good first guess: ω² = g k (1 + (ka)²) in deep water.
    guess_m = linear_m * (1 + (math.pi * steepness) ** 2)
    try:
        length_m = newton(
            lambda length_m: fenton(length_m).period - period_s, guess_m, x1=1.003 * guess_m, tol=1e-11
        )
        return _derive(fenton(float(length_m)), phase_rad)
    except (raschii.RaschiiError, RuntimeError) as error:
        raise ValueError(f"no wave with T = {period_s} s and H/λ = {steepness}: {error}") from None


def _linear_length(period_s: float, depth_m: float) -> float:
    """Wavelength of linear theory, from ω² = g k tanh(k d)."""
    omega = 2 * math.pi / period_s
    deep = omega**2 / GRAVITY_M_S2
    wavenumber = brentq(
        lambda k: GRAVITY_M_S2 * k * math.tanh(k * depth_m) - omega**2, deep, deep + 10 * omega / depth_m
    )
    return 2 * math.pi / float(wavenumber)


def _derive(wave: object, phase_rad: float) -> RegularWave:
    """Series of elevation, surface velocity and label from raschii's coefficients."""
    data, depth_m, length_m = wave.data, wave.depth, wave.length  # type: ignore[attr-defined]
    celerity = float(data["c"])
    wavenumber = 2 * math.pi / length_m
    phase = 2 * math.pi * np.arange(4 * _HARMONICS) / (4 * _HARMONICS)

    # raschii holds the elevation at N + 1 points of half a wave; its series is their cosine transform.
    half = np.asarray(data["eta"])
    elevation = np.fft.rfft(np.concatenate([half, half[-2:0:-1]])).real / ORDER
    elevation[[0, -1]] /= 2
    elevation[0] -= depth_m

    order = np.arange(1, ORDER + 1)
    height = depth_m + chebyshev.chebval(np.cos(phase), elevation)
    growth = np.cosh(np.outer(height, order) * wavenumber) / np.cosh(order * wavenumber * depth_m)
    surface_velocity = wavenumber * (np.cos(np.outer(phase, order)) * growth) @ (order * data["B"][1:])

    slowness = np.fft.rfft(1 / (celerity - surface_velocity)).real[:_HARMONICS] / len(phase)
    label_celerity = 1 / slowness[0]
    label = np.zeros(_HARMONICS)
    label[1:] = label_celerity * 2 * slowness[1:] / (wavenumber * np.arange(1, _HARMONICS))
    velocity = 2 * np.fft.rfft(surface_velocity).real[:_HARMONICS] / len(phase)
    velocity[0] /= 2
    return RegularWave(
        period_s=length_m / celerity,
        length_m=length_m,
        height_m=float(half[0] - half[-1]),
        celerity_m_s=celerity,
        drift_m_s=celerity - float(label_celerity),
        phase_rad=phase_rad,
        elevation_series=tuple(elevation.tolist()),
        velocity_series=tuple(velocity.tolist()),
        label_series=tuple(label.tolist()),
    )
