"""Waves around a vertical cylinder in the middle of the flume.

How a nonlinear wave meets linear diffraction: each harmonic j of the incident Fenton wave, with its bound
wavenumber jk and frequency jω, is diffracted like a linear wave of wavenumber jk,

    eta = Σ a_j Re[F(jk; x, y) exp(-ijωt)],

with F from `diffraction`. Without the cylinder this is the Fenton wave; for low waves it is MacCamy and Fuchs;
at the wall and at the flume's sides no water passes, at each harmonic. What it leaves out is the interaction of
incident and scattered waves at second order, of relative size kA: run-up of steep waves is too low by about that.

Velocity and orbital displacement of the water follow the same way from the gradient of F,

    u = U_0 + Σ U_j Re[∇F / (ijk) exp(-ijωt)],   label = x - U t - Σ (b_j / jk) Re[∇F exp(-ijωt)],

with U_j and b_j the wave's series of surface velocity and label. Far away these are the wave's own. Near the
cylinder the label is right to first order: along a particle's path it wanders by about ka times the orbit's
displacement, and the mean drift is that of the undisturbed wave, which does not part at the cylinder.

F and ∇F are tabulated once; see `cylinder_table`.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from thermacq_drivers.simflume.cases import FLUME_WIDTH_M
from thermacq_drivers.simflume.cylinder_table import tabulate
from thermacq_drivers.simflume.diffraction import Complexes
from thermacq_drivers.simflume.moments import interpolate_in_time, nodes_in_time
from thermacq_drivers.simflume.regular_wave import RegularWave
from thermacq_drivers.simflume.surfaces import Floats, Surface

_ROUNDING = 1e-12
# Points put on the wall are in the water.
_KEPT_MOMENTS = 48
_BLOCK = 16
# The part of the table that is combined for a moment is rounded to so many nodes.


@dataclass(frozen=True)
class Cylinder:
    """A vertical cylinder that stands in the water; metres."""

    x_m: float
    y_m: float
    radius_m: float

    def covers(self, x_m: Floats, y_m: Floats) -> np.ndarray:
        """Whether points lie inside, (...) bool."""
        return np.hypot(x_m - self.x_m, y_m - self.y_m) < self.radius_m * (1 - _ROUNDING)


@dataclass(frozen=True, eq=False)
class Pierced:
    """Water around a cylinder: `surface`, with no water (NaN) inside the cylinder.

    Parameters
    ----------
    surface
        The water, continued into the cylinder in some smooth way.
    cylinder
        The cylinder.
    drift_m_s
        Mean drift of the water at the surface along x and y.
    """

    surface: Surface
    cylinder: Cylinder
    drift_m_s: tuple[float, float]

    @property
    def highest_m(self) -> float:
        """Upper bound of the elevation."""
        return self.surface.highest_m

    @property
    def steepest(self) -> float:
        """Upper bound of the slope's magnitude."""
        return self.surface.steepest

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation above still water, metres."""
        return self._hole(x_m, y_m) + self.surface.elevation(x_m, y_m, time_s)

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope along x and along y."""
        along, across = self.surface.slope(x_m, y_m, time_s)
        hole = self._hole(x_m, y_m)
        return hole + along, hole + across

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Horizontal velocity (x, y) of the water at the surface, m/s."""
        along, across = self.surface.velocity(x_m, y_m, time_s)
        hole = self._hole(x_m, y_m)
        return hole + along, hole + across

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Material coordinates (along x, along y) of the particle now at (x, y), metres."""
        along, across = self.surface.label(x_m, y_m, time_s)
        hole = self._hole(x_m, y_m)
        return hole + along, hole + across

    def _hole(self, x_m: Floats, y_m: Floats) -> Floats:
        return np.where(self.cylinder.covers(x_m, y_m), np.nan, 0.0)


class CylinderWave:
    """A regular wave diffracted by a cylinder; see the module's docstring.

    Inside the cylinder all quantities are the wall's, times (r/a)², so that rays find a smooth surface there.

    Parameters
    ----------
    wave
        The incident wave.
    cylinder
        The cylinder; the walls of the flume are at its y ± half the width.
    width_m
        Width of the flume; None for open water.

    Raises
    ------
    ValueError
        The cylinder does not fit, or the wave is in resonance with the flume's width.
    """

    def __init__(self, wave: RegularWave, cylinder: Cylinder, width_m: float | None = FLUME_WIDTH_M) -> None:
        self.wave = wave
        self.cylinder = cylinder
        self.drift_m_s = (wave.drift_m_s, 0.0)
        """Lagrangian mean drift at the surface along x and y."""
        self._table = tabulate(wave, cylinder.radius_m, width_m)
        count = len(self._table.solutions)
        self._order = np.arange(1, count + 1)
        self._omega_rad_s = 2 * math.pi / wave.period_s
        elevation, velocity, label = (
            np.array(series[1 : count + 1])
            for series in (wave.elevation_series, wave.velocity_series, wave.label_series)
        )
        start = np.exp(1j * self._order * (wave.wavenumber_rad_m * cylinder.x_m + wave.phase_rad))
        k = self._order * wave.wavenumber_rad_m
        # Each quantity is Re Σ weight_j field_j exp(-ijωt), of the fields F, dF/dx, dF/dy.
        self._weights: dict[str, Complexes] = {
            "elevation": elevation * start,
            "slope": elevation * start,
            "velocity": velocity / (1j * k) * start,
            "displacement": label / k * start,
        }
        self._combined: OrderedDict[tuple[object, ...], Floats] = OrderedDict()

    @property
    def highest_m(self) -> float:
        """Highest elevation at any place and time."""
        return self._table.highest_m

    @property
    def steepest(self) -> float:
        """Steepest slope at any place and time."""
        return self._table.steepest

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation above still water, metres."""
        return self._evaluate("elevation", 0, x_m, y_m, time_s)

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope along x and along y."""
        return self._evaluate("slope", 1, x_m, y_m, time_s), self._evaluate("slope", 2, x_m, y_m, time_s)

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Horizontal velocity (x, y) of the water at the surface, m/s."""
        along, across = (self._evaluate("velocity", axis, x_m, y_m, time_s) for axis in (1, 2))
        return along + self.wave.velocity_series[0], across

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Material coordinates (along x, along y) of the particle now at (x, y), metres."""
        shift_x, shift_y = (self._evaluate("displacement", axis, x_m, y_m, time_s) for axis in (1, 2))
        return x_m - self.drift_m_s[0] * np.asarray(time_s, np.float64) - shift_x, y_m - shift_y

    def _evaluate(self, name: str, axis: int, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """One quantity at points and times that broadcast against each other."""
        x, y = np.broadcast_arrays(np.asarray(x_m) - self.cylinder.x_m, np.asarray(y_m) - self.cylinder.y_m)
        if np.ndim(time_s) == 0 and x.size:
            return self._at_moment(name, axis, x, y, float(time_s))
        time = np.asarray(time_s, np.float64)
        shape = np.broadcast_shapes(x.shape, time.shape)
        if x.shape == shape and x.size:
            amplitude = np.array(self.wave.elevation_series)[self._order]
            times = np.broadcast_to(time, shape)
            omega = np.asarray(self._order * self._omega_rad_s, np.float64)
            nodes = nodes_in_time(times, amplitude, omega)
            if nodes is not None:
                return interpolate_in_time(
                    lambda moment: self._at_moment(name, axis, x, y, moment), nodes, times
                )
        # Each harmonic's field at the points, once, serves for all times.
        place, damping, beyond = self._place(axis, x, y)
        fields = self._table.fields(axis, place)
        for field, direct in zip(fields, self._beyond(axis, x[beyond], y[beyond]), strict=True):
            field[beyond] = direct
        return damping * _real_sum(self._factors(name, time), fields)

    def _at_moment(self, name: str, axis: int, x_m: Floats, y_m: Floats, time_s: float) -> Floats:
        """One quantity at points (...) relative to the axis."""
        place, damping, beyond = self._place(axis, x_m, y_m)
        total = self._combined_at(name, axis, place, time_s)
        total[beyond] = _real_sum(self._factors(name, time_s), self._beyond(axis, x_m[beyond], y_m[beyond]))
        return damping * total

    def _place(self, axis: int, x_m: Floats, y_m: Floats) -> tuple[list[Floats], Floats, np.ndarray]:
        """Place of points on the table, factor of what is found there, and whether they lie beyond it."""
        radius, angle = np.hypot(x_m, y_m), np.abs(np.arctan2(y_m, x_m))
        radius_m, reach_m = self.cylinder.radius_m, self._table.reach_m
        factor = np.minimum(radius / radius_m, 1.0) ** 2
        if axis == 2:
            factor = np.where(y_m < 0, -factor, factor)
        return self._table.place(np.clip(radius, radius_m, reach_m), angle), factor, radius > reach_m

    def _beyond(self, axis: int, x_m: Floats, y_m: Floats) -> list[Complexes]:
        """One field of each harmonic at points (points,) outside the table, for y >= 0."""
        if x_m.size == 0:
            return [np.empty(0, np.complex128)] * len(self._order)
        return [solution.field(x_m, np.abs(y_m))[axis] for solution in self._table.solutions]

    def _factors(self, name: str, time_s: Floats | float) -> list[Complexes]:
        # Elapsed periods are taken out first, as in `regular_wave`.
        cycles = np.asarray(time_s, np.float64) / self.wave.period_s
        turn = -2j * math.pi * (cycles - np.floor(cycles))
        return [
            weight * np.exp(order * turn)
            for order, weight in zip(self._order, self._weights[name], strict=True)
        ]

    def _combined_at(self, name: str, axis: int, place: list[Floats], time_s: float) -> Floats:
        """One quantity at places of the table at one moment: all harmonics summed first, then interpolated."""
        # A cubic spline at a place needs one node before it and two behind.
        box = tuple(
            (max(int(along.min()) // _BLOCK * _BLOCK - 1, 0), (int(along.max()) // _BLOCK + 1) * _BLOCK + 2)
            for along in place
        )
        key = (name, axis, time_s, box)
        if key not in self._combined:
            factors = np.array(self._factors(name, time_s))
            (top, bottom), (left, right) = box
            window = slice(top, bottom), slice(left, right)
            total = _weighted_sum(factors.real, self._table.real[axis], window)
            total -= _weighted_sum(factors.imag, self._table.imaginary[axis], window)
            self._combined[key] = total
            if len(self._combined) > _KEPT_MOMENTS:
                self._combined.popitem(last=False)
        within = [along - first for along, (first, _) in zip(place, box, strict=True)]
        found: Floats = ndimage.map_coordinates(
            self._combined[key], within, order=3, prefilter=False, mode="nearest"
        )
        return found


def _real_sum(factors: list[Complexes], fields: list[Complexes]) -> Floats:
    """Σ Re(factor field) over the harmonics."""
    total: Floats = sum(
        ((factor * field).real for factor, field in zip(factors, fields, strict=True)), np.zeros(())
    )
    return total


def _weighted_sum(weights: Floats, tables: Floats, window: tuple[slice, slice]) -> Floats:
    total: Floats = weights[0] * tables[0][window]
    for weight, table in zip(weights[1:], tables[1:], strict=True):
        total += weight * table[window]
    return total
