"""Tables of the waves that a cylinder diffracts: fields of each harmonic on a grid in log r and θ.

The grid is so fine that cubic splines through it are within 1e-6 m of the sum of all harmonics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import ndimage

from thermacq_drivers.simflume.diffraction import NEAR, Complexes, Diffraction, solve_diffraction
from thermacq_drivers.simflume.regular_wave import RegularWave
from thermacq_drivers.simflume.surfaces import Floats

_SPLINE_ERROR_M = 5e-7
_LARGEST_FIELD = 2.0
# Amplification that the spacing of the table allows for.
_COARSEST = 0.03
_PAD = 12
# Nodes around the table: the spline's error at the border falls by 0.27 per node.
_REACH_M = 1.0
_NEGLIGIBLE_M = 5e-6
# Harmonics below this are left out.
_OUTSIDE = 0.8
# Behind the walls of the flume the table only has to continue smoothly; see `_table_field`.


_PHASES = 72
_BETWEEN_PHASES = 1.005
# The highest and the steepest moment of a period may lie between those looked at.


@dataclass(frozen=True, eq=False)
class DiffractionTable:
    """Spline coefficients (3, harmonics, radii, angles) of F, dF/dx, dF/dy for y >= 0."""

    radius_m: float
    reach_m: float
    step: float
    solutions: tuple[Diffraction, ...]
    real: Floats
    imaginary: Floats
    highest_m: float
    steepest: float

    def place(self, radius_m: Floats, angle_rad: Floats) -> list[Floats]:
        """Place of points on the grid."""
        return [np.log(radius_m / self.radius_m) / self.step + _PAD, angle_rad / self.step + _PAD]

    def fields(self, axis: int, place: list[Floats]) -> list[Complexes]:
        """One field of each harmonic at places."""
        return [
            ndimage.map_coordinates(real, place, order=3, prefilter=False, mode="nearest")
            + 1j * ndimage.map_coordinates(imaginary, place, order=3, prefilter=False, mode="nearest")
            for real, imaginary in zip(self.real[axis], self.imaginary[axis], strict=True)
        ]


@cache
def tabulate(wave: RegularWave, radius_m: float, width_m: float | None) -> DiffractionTable:
    """Diffract each harmonic of a wave and tabulate it; see `diffraction.solve_diffraction` for what it raises."""
    count = max(j for j, a in enumerate(wave.elevation_series) if j < 2 or abs(a) > _NEGLIGIBLE_M)
    order = np.arange(1, count + 1)
    amplitude = np.array(wave.elevation_series[1 : count + 1])
    k = order * wave.wavenumber_rad_m
    # As in `component_sea`: the spline misses cos kx by (kh)^4 / 720.
    spacing_m = (720 * _SPLINE_ERROR_M / (_LARGEST_FIELD * float(np.abs(amplitude) @ k**4))) ** 0.25
    reach_m = max(_REACH_M, 4 * radius_m)
    angles = math.ceil(math.pi / min(_COARSEST, spacing_m / reach_m))
    step = math.pi / angles
    radius = radius_m * np.exp(
        step * np.arange(-_PAD, math.ceil(math.log(reach_m / radius_m) / step) + _PAD + 1)
    )
    angle = step * np.arange(-_PAD, angles + _PAD + 1)
    solutions = tuple(solve_diffraction(float(number), radius_m, width_m) for number in k)
    fields = np.array([_table_field(solution, radius, angle) for solution in solutions]).swapaxes(0, 1)
    water = (radius >= radius_m)[:, None] & np.ones(len(angle), bool)
    if width_m is not None:
        water &= np.abs(np.outer(radius, np.sin(angle))) <= width_m / 2
    # Every third node is fine enough here, and begins at the wall.
    highest_m, steepest = _extremes(fields[..., ::3, ::3][..., water[::3, ::3]], amplitude)
    coefficients = [
        ndimage.spline_filter1d(ndimage.spline_filter1d(part, order=3, axis=2), order=3, axis=3)
        for part in (fields.real, fields.imag)
    ]
    return DiffractionTable(
        radius_m=radius_m,
        reach_m=reach_m,
        step=step,
        solutions=solutions,
        real=coefficients[0],
        imaginary=coefficients[1],
        highest_m=highest_m,
        steepest=steepest,
    )


def _extremes(fields: Complexes, amplitude_m: Floats) -> tuple[float, float]:
    """Highest elevation and steepest slope at any time, of fields (3, harmonics, points) at the water's points."""
    orders = np.arange(1, len(amplitude_m) + 1)
    highest_m = steepest = 0.0
    for phase in 2 * math.pi * np.arange(_PHASES) / _PHASES:
        factors = amplitude_m * np.exp(-1j * orders * phase)
        elevation, along, across = np.tensordot(factors, fields, axes=(0, 1)).real
        highest_m = max(highest_m, float(elevation.max()))
        steepest = max(steepest, float(np.hypot(along, across).max()))
    return _BETWEEN_PHASES * highest_m, _BETWEEN_PHASES * steepest


def _table_field(solution: Diffraction, radius_m: Floats, angle_rad: Floats) -> Complexes:
    """F, dF/dx, dF/dy on a polar grid, (3, radii, angles); merely smooth behind the walls of the flume."""
    width_m = solution.width_m
    if width_m is None:
        return np.array(solution.near_grid(radius_m, angle_rad))
    close = radius_m <= _OUTSIDE * width_m
    found = np.empty((3, len(radius_m), len(angle_rad)), np.complex128)
    found[:, close] = solution.near_grid(radius_m[close], angle_rad)
    # Beside the cylinder, behind the walls, the modes do not converge: the series stays there and, farther
    # out, the nearest value of the modes.
    x, y = np.outer(radius_m, np.cos(angle_rad)), np.outer(radius_m, np.sin(angle_rad))
    nearest_m = math.sqrt(NEAR**2 - 0.25) * width_m
    modes = (radius_m > NEAR * width_m)[:, None] & ((np.abs(x) > nearest_m) | ~close[:, None])
    x = np.where(np.abs(x) < nearest_m, np.copysign(nearest_m, x), x)
    found[:, modes] = solution.far(x[modes], y[modes])
    return found
