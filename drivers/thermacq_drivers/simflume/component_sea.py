"""A sea as the sum of linear waves: irregular seas, wave groups, standing waves, reflected waves.

Elevation is eta = Σ a cos θ with θ = k·x - ω t + φ. A particle of the surface moves on first-order orbits
about a mean position X that travels with the Stokes drift U = Σ a² ω k coth(kd) of all components:

    x = X + ξ(X, t),   ξ = -Σ a coth(kd) (k/|k|) sin θ,   X = label + U t.

This relation is the definition of `label` and `velocity`, so the label is constant along the path of a
particle to rounding. Against the velocity of linear theory at the moving surface it is right to second order in the
steepness, but for the drift's variation within wave groups, which is replaced by its mean.

Sums over hundreds of components at thousands of points are taken from a table: the sum at the nodes of a regular
grid, which is separable in x and y, and a cubic spline through them. The grid is so fine that the spline is
within 1e-7 m of the sum. The table is a pure function of time and of the rounded bounds of the points.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from thermacq_drivers.simflume.moments import interpolate_in_time, nodes_in_time, one_by_one
from thermacq_drivers.simflume.surfaces import Floats

Complexes = NDArray[np.complex128]

_SPLINE_ERROR_M = 1e-7
_PAD = 12
# Nodes around the points: the spline's error at the border falls by 0.27 per node.
_ROUNDING_M = 0.25
_KEPT_TABLES = 48
_FEW_POINTS = 128
_MOST_NODES = 400_000
_SMALL_PRODUCT = 200_000
# Multiplications up to which OpenBLAS stays in one thread; see `projection`.
_LABEL_TOLERANCE_M = 1e-10
_LABEL_STEPS = 100
_EXTREME = 5.0
# Standard deviations that a random sea is taken not to exceed; a wave does so with probability 4e-6.


@dataclass(frozen=True, eq=False)
class Components:
    """Linear waves to be summed; all arrays (waves,) float64.

    Parameters
    ----------
    amplitude_m
        Amplitudes a.
    omega_rad_s
        Angular frequencies ω.
    along_rad_m, across_rad_m
        Wavenumber vectors (kx, ky).
    phase_rad
        Phases φ; 0 puts a crest at the origin at t = 0.
    depth_m
        Depth of the still water.
    """

    amplitude_m: Floats
    omega_rad_s: Floats
    along_rad_m: Floats
    across_rad_m: Floats
    phase_rad: Floats
    depth_m: float

    @property
    def wavenumber_rad_m(self) -> Floats:
        """Magnitudes |k|."""
        return np.hypot(self.along_rad_m, self.across_rad_m)

    @property
    def significant_wave_height_m(self) -> float:
        """Hm0 = 4 sqrt(m0), with m0 = Σ a² / 2."""
        return 4 * math.sqrt(float((self.amplitude_m**2).sum()) / 2)

    def reflected(self, coefficient: float, wall_x_m: float) -> Components:
        """The waves that a reflecting wall at `wall_x_m` sends back, an antinode at the wall."""
        return Components(
            amplitude_m=coefficient * self.amplitude_m,
            omega_rad_s=self.omega_rad_s,
            along_rad_m=-self.along_rad_m,
            across_rad_m=self.across_rad_m,
            phase_rad=self.phase_rad + 2 * self.along_rad_m * wall_x_m,
            depth_m=self.depth_m,
        )


def join(first: Components, second: Components) -> Components:
    """The waves of both, in water of the first's depth."""
    return Components(
        amplitude_m=np.concatenate([first.amplitude_m, second.amplitude_m]),
        omega_rad_s=np.concatenate([first.omega_rad_s, second.omega_rad_s]),
        along_rad_m=np.concatenate([first.along_rad_m, second.along_rad_m]),
        across_rad_m=np.concatenate([first.across_rad_m, second.across_rad_m]),
        phase_rad=np.concatenate([first.phase_rad, second.phase_rad]),
        depth_m=first.depth_m,
    )


class ComponentSea:
    """The water surface that linear waves make together; see the module's docstring.

    Parameters
    ----------
    components
        The waves.
    random_phases
        Whether the phases are random, so that crests of all waves never meet.
    """

    def __init__(self, components: Components, random_phases: bool = False) -> None:
        self.components = components
        self._random_phases = random_phases
        a, k = components.amplitude_m, components.wavenumber_rad_m
        growth = a / np.tanh(k * components.depth_m)
        unit_x, unit_y = components.along_rad_m / k, components.across_rad_m / k
        speed = a * growth * components.omega_rad_s * k
        self.drift_m_s: tuple[float, float] = (float(speed @ unit_x), float(speed @ unit_y))
        """Stokes drift at the surface along x and y."""
        encounter = components.omega_rad_s
        encounter = encounter - self.drift_m_s[0] * components.along_rad_m
        encounter = encounter - self.drift_m_s[1] * components.across_rad_m
        # Each quantity is Re Σ weight exp(iθ).
        self._weights: dict[str, Complexes] = {
            name: np.asarray(weights, np.complex128)
            for name, weights in (
                ("elevation", a),
                ("slope_x", 1j * components.along_rad_m * a),
                ("slope_y", 1j * components.across_rad_m * a),
                ("displacement_x", 1j * growth * unit_x),
                ("displacement_y", 1j * growth * unit_y),
                ("velocity_x", encounter * growth * unit_x),
                ("velocity_y", encounter * growth * unit_y),
            )
        }
        self._long_crested = not components.across_rad_m.any()
        # A cubic spline with nodes h apart misses cos kx by (kh)^4 / 720 at most, near enough.
        self._spacing_m = min(0.02, (720 * _SPLINE_ERROR_M / max(float(a @ k**4), 1e-12)) ** 0.25)
        self._tables: OrderedDict[tuple[object, ...], Floats] = OrderedDict()

    @property
    def highest_m(self) -> float:
        """Upper bound of the elevation: the sum of amplitudes, in a random sea five standard deviations."""
        return self._extreme(self.components.amplitude_m)

    @property
    def steepest(self) -> float:
        """Upper bound of the slope, like `highest_m`."""
        return self._extreme(self.components.amplitude_m * self.components.wavenumber_rad_m)

    def _extreme(self, amplitudes: Floats) -> float:
        deviation = math.sqrt(float(amplitudes @ amplitudes) / 2)
        return min(float(amplitudes.sum()), _EXTREME * deviation if self._random_phases else math.inf)

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation above still water, metres."""
        return self._evaluate("elevation", x_m, y_m, time_s)

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope along x and along y."""
        return self._vector("slope", x_m, y_m, time_s)

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Horizontal velocity (x, y) of the water at the surface, m/s."""
        along, across = self._vector("velocity", *self._mean_position(x_m, y_m, time_s), time_s)
        return along + self.drift_m_s[0], across + self.drift_m_s[1]

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Material coordinates (along x, along y) of the particle now at (x, y), metres."""
        mean_x, mean_y = self._mean_position(x_m, y_m, time_s)
        time = np.asarray(time_s, np.float64)
        return mean_x - self.drift_m_s[0] * time, mean_y - self.drift_m_s[1] * time

    def _mean_position(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Mean positions of the particles now at (x, y): x = X + ξ(X) by repeated substitution."""
        x, y, time = np.broadcast_arrays(*(np.asarray(value, np.float64) for value in (x_m, y_m, time_s)))
        mean_x, mean_y = x, y
        moment = time_s if np.ndim(time_s) == 0 else time
        for _ in range(_LABEL_STEPS):
            shift_x, shift_y = self._vector("displacement", mean_x, mean_y, moment)
            change = max(_largest(x - shift_x - mean_x), _largest(y - shift_y - mean_y))
            mean_x, mean_y = x - shift_x, y - shift_y
            if change < _LABEL_TOLERANCE_M:
                break
        return mean_x, mean_y

    def _vector(self, name: str, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        along = self._evaluate(f"{name}_x", x_m, y_m, time_s)
        if self._long_crested:
            return along, np.zeros_like(along)
        return along, self._evaluate(f"{name}_y", x_m, y_m, time_s)

    def _evaluate(self, name: str, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """One quantity at points and times that broadcast against each other."""
        if np.ndim(time_s) == 0:
            x, y = np.broadcast_arrays(np.asarray(x_m, np.float64), np.asarray(y_m, np.float64))
            return self._at_time(name, x, y, float(time_s))
        x, y, time = np.broadcast_arrays(*(np.asarray(value, np.float64) for value in (x_m, y_m, time_s)))
        nodes = nodes_in_time(time, self.components.amplitude_m, self.components.omega_rad_s)
        if nodes is None and len(np.unique(time)) * _FEW_POINTS > time.size:
            return self._direct(name, x, y, time)
        if nodes is None:
            return one_by_one(lambda *at: self._at_time(name, *at), x, y, time)
        return interpolate_in_time(lambda moment: self._at_time(name, x, y, moment), nodes, time)

    def _at_time(self, name: str, x_m: Floats, y_m: Floats, time_s: float) -> Floats:
        """One quantity at points of one moment, (...) float64."""
        if x_m.size == 0:
            return np.zeros(x_m.shape)
        box = self._box(x_m, y_m)
        nodes = math.prod(stop - start for start, stop in box)
        if x_m.size < _FEW_POINTS or nodes > min(_MOST_NODES, 16 * x_m.size):
            return self._direct(name, x_m, y_m, np.full(x_m.shape, time_s))
        table = self._table(name, box, time_s)
        axes = (x_m,) if self._long_crested else (x_m, y_m)
        places = [axis / self._spacing_m - start for axis, (start, _) in zip(axes, box, strict=True)]
        found: Floats = ndimage.map_coordinates(table, places, order=3, prefilter=False, mode="nearest")
        return found

    def _box(self, x_m: Floats, y_m: Floats) -> tuple[tuple[int, int], ...]:
        """First and last node along each axis around these points, rounded to whole pieces of the flume."""
        bounds = []
        for axis in (x_m,) if self._long_crested else (x_m, y_m):
            low = math.floor(float(axis.min()) / _ROUNDING_M) * _ROUNDING_M
            high = math.ceil(float(axis.max()) / _ROUNDING_M) * _ROUNDING_M
            start, stop = math.floor(low / self._spacing_m), math.ceil(high / self._spacing_m)
            bounds.append((start - _PAD, stop + _PAD + 1))
        return tuple(bounds)

    def _factors(self, name: str, time_s: float) -> Complexes:
        """Complex amplitudes of the components at one moment."""
        turns = self.components.omega_rad_s * time_s - self.components.phase_rad
        factors: Complexes = self._weights[name] * np.exp(-1j * turns)
        return factors

    def _direct(self, name: str, x_m: Floats, y_m: Floats, time_s: Floats) -> Floats:
        """The sum as it stands, at points and times of one shape."""
        waves, weights = self.components, self._weights[name][:, None]
        x, y, time = x_m.ravel(), y_m.ravel(), time_s.ravel()
        values = np.empty(x.size)
        step = max(1, _MOST_NODES // len(weights))
        for start in range(0, x.size, step):
            part = slice(start, start + step)
            phase = waves.phase_rad - np.outer(time[part], waves.omega_rad_s)
            phase += np.outer(x[part], waves.along_rad_m) + np.outer(y[part], waves.across_rad_m)
            values[part] = _real_product(np.exp(1j * phase), weights)[:, 0]
        return values.reshape(x_m.shape)

    def _table(self, name: str, box: tuple[tuple[int, int], ...], time_s: float) -> Floats:
        """Spline coefficients of one quantity at one moment over a box of nodes."""
        key = (name, box, time_s)
        if key in self._tables:
            self._tables.move_to_end(key)
            return self._tables[key]
        waves = self.components
        vectors = (waves.along_rad_m, waves.across_rad_m)
        bases = [
            np.exp(1j * np.outer(np.arange(*bounds) * self._spacing_m, vector))
            for bounds, vector in zip(box, vectors, strict=False)
        ]
        factors = self._factors(name, time_s)
        if self._long_crested:
            values = _real_product(bases[0], factors[:, None])[:, 0]
        else:
            values = _real_product(bases[0] * factors, bases[1].T)
        coefficients = np.asarray(ndimage.spline_filter(values, order=3), np.float64)
        self._tables[key] = coefficients
        if len(self._tables) > _KEPT_TABLES:
            self._tables.popitem(last=False)
        return coefficients


def _real_product(left: Complexes, right: Complexes) -> Floats:
    """Real part of a matrix product, in blocks of rows too small for BLAS to start threads."""
    left_parts = np.concatenate([left.real, -left.imag], axis=1)
    right_parts = np.concatenate([right.real, right.imag])
    if right.shape[1] == 1:
        return np.asarray(np.einsum("ij,jk->ik", left_parts, right_parts), np.float64)
    block = max(1, _SMALL_PRODUCT // right_parts.size)
    parts = [left_parts[start : start + block] @ right_parts for start in range(0, len(left), block)]
    return np.concatenate(parts)


def _largest(values: Floats) -> float:
    return float(np.abs(values).max(initial=0.0))
