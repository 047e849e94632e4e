"""Linear diffraction of plane waves by a vertical cylinder, alone or in the middle of a flume.

All fields are complex amplitudes F for an incident wave exp(i(kx - ωt)) of amplitude 1: eta = Re F exp(-iωt).
Coordinates are relative to the cylinder's axis.

Alone, this is MacCamy and Fuchs (1954). The side walls of a flume of width W mirror the cylinder: it becomes
one of an endless row at y = nW. By symmetry all cylinders of the row scatter alike, and the waves that reach
one from all others are a regular field around it (Graf's addition theorem; Linton and Evans 1990):

    F = Σ_n A_n [Z_n H_n(kr) - J_n(kr)] exp(inθ),   Z_n = J'_n(ka) / H'_n(ka),
    A_m + Σ_n S_{n-m} Z_n A_n = -i^m,               S_q = 2 cos(qπ/2) Σ_{j>0} H_q(kjW),

for r < W, with H the Hankel function of the first kind. All multiple scattering between the images is in it; S = 0
is the cylinder alone. Farther along the flume the scattered waves are modes of the channel, exp(2πipy/W), with
wavenumber γ_p = sqrt(k² - (2πp/W)²) along x. The two forms agree where both hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import h1vp, hankel1, hankel1e, jv, jvp

from thermacq_drivers.simflume.surfaces import Floats

Complexes: TypeAlias = NDArray[np.complex128]
Field: TypeAlias = tuple[Complexes, Complexes, Complexes]

NEAR = 0.6
"""Part of the width up to which the cylinder's own series is used; beyond it the channel's modes."""

_SCATTERED_ORDERS = 16
# Orders beyond ka in which the cylinder scatters; the others are below 1e-12.
_REGULAR_ORDERS = 48
# Orders beyond kr of the waves from the images: they fall as (r/W)^n, 2e-11 at r = 0.6 W.
_MODE_DECAY = 30.0
# Modes are kept until exp(-30).
_QUADRATURE_STEP = 0.04
_RESONANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Diffraction:
    """Solution for one wave; make it with `solve_diffraction`.

    Parameters
    ----------
    wavenumber_rad_m, radius_m
        Wavenumber k of the incident wave and radius a of the cylinder.
    width_m
        Width W of the flume, or None for open water.
    scattered
        (2M + 1,) A_n Z_n for n = -M..M.
    regular
        (2N + 1,) -A_n for n = -N..N; empty in open water, where the incident wave stands for itself.
    """

    wavenumber_rad_m: float
    radius_m: float
    width_m: float | None
    scattered: Complexes
    regular: Complexes

    def field(self, x_m: Floats, y_m: Floats) -> Field:
        """F, dF/dx and dF/dy at points (points,) of the water."""
        radius = np.hypot(x_m, y_m)
        far = np.zeros(radius.shape, bool)
        if self.width_m is not None:
            far = radius > NEAR * self.width_m
        found = tuple(np.empty(radius.shape, np.complex128) for _ in range(3))
        near_field = self.near(radius[~far], np.arctan2(y_m, x_m)[~far])
        far_field = self.far(x_m[far], y_m[far])
        for values, near_values, far_values in zip(found, near_field, far_field, strict=True):
            values[~far], values[far] = near_values, far_values
        return found[0], found[1], found[2]

    def near(self, radius_m: Floats, angle_rad: Floats) -> Field:
        """Like `field` by the cylinder's own series, at polar coordinates (points,); holds for r < W."""
        orders, *radial = self._radial(radius_m)
        turns = np.exp(1j * np.outer(angle_rad, orders))
        parts = [(part * turns).sum(axis=1) for part in radial]
        return self._with_incident(parts, radius_m, angle_rad)

    def near_grid(self, radius_m: Floats, angle_rad: Floats) -> Field:
        """Like `near` for all pairs of (radii,) and (angles,): fields (radii, angles)."""
        orders, *radial = self._radial(radius_m)
        turns = np.exp(1j * np.outer(orders, angle_rad))
        return self._with_incident([part @ turns for part in radial], radius_m[:, None], angle_rad[None, :])

    def _radial(self, radius_m: Floats) -> tuple[Floats, Complexes, Complexes, Complexes]:
        """Orders n (orders,), and F, dF/dr / k and dF/dθ / kr of each as (radii, orders)."""
        kr = self.wavenumber_rad_m * radius_m[:, None]
        scattered, regular = (
            np.arange(len(part)) - len(part) // 2 for part in (self.scattered, self.regular)
        )
        values = [self.scattered * hankel1(scattered, kr), self.regular * jv(regular, kr)]
        growths = [self.scattered * h1vp(scattered, kr), self.regular * jvp(regular, kr)]
        orders = np.concatenate([scattered, regular])
        value = np.concatenate(values, axis=1)
        return orders, value, np.concatenate(growths, axis=1), 1j * orders / kr * value

    def _with_incident(self, parts: list[Complexes], radius_m: Floats, angle_rad: Floats) -> Field:
        """F, dF/dx, dF/dy from F and its polar derivatives; in open water the incident wave is added."""
        k, cosine, sine = self.wavenumber_rad_m, np.cos(angle_rad), np.sin(angle_rad)
        value, radial, tangential = parts
        along, across = k * (radial * cosine - tangential * sine), k * (radial * sine + tangential * cosine)
        if self.width_m is None:
            incident = np.exp(1j * k * radius_m * cosine)
            value, along = value + incident, along + 1j * k * incident
        return value, along, across

    def far(self, x_m: Floats, y_m: Floats) -> Field:
        """Like `field` by the modes of the flume, at points (points,) beyond `NEAR`."""
        k, width_m = self.wavenumber_rad_m, self.width_m or math.inf
        value = np.exp(1j * k * x_m)
        along, across = 1j * k * value, np.zeros(value.shape, np.complex128)
        distance, ahead = np.abs(x_m), x_m > 0
        orders = np.arange(len(self.scattered)) - len(self.scattered) // 2
        reach_m = max(math.sqrt(NEAR**2 - 0.25) * width_m - self.radius_m, 0.1 * width_m)
        last = math.ceil(width_m / (2 * math.pi) * math.hypot(k, _MODE_DECAY / reach_m)) if x_m.size else -1
        for mode in range(last + 1):
            beta = 2 * math.pi * mode / width_m
            gamma = np.sqrt(complex(k**2 - beta**2))
            # H_n(kr) exp(inθ), summed over the row, is this mode times (∓i exp(±iψ))^n, ψ its direction.
            # The modes ±p are equally strong, so they make a cosine together.
            share = (2 if mode == 0 else 4) / (width_m * gamma)
            strength_ahead = share * (self.scattered * (-1j * (gamma + 1j * beta) / k) ** orders).sum()
            strength_behind = share * (self.scattered * (1j * (gamma - 1j * beta) / k) ** orders).sum()
            wave = np.where(ahead, strength_ahead, strength_behind) * np.exp(1j * gamma * distance)
            value += wave * np.cos(beta * y_m)
            along += np.where(ahead, 1j, -1j) * gamma * wave * np.cos(beta * y_m)
            across -= beta * wave * np.sin(beta * y_m)
        return value, along, across


def solve_diffraction(wavenumber_rad_m: float, radius_m: float, width_m: float | None = None) -> Diffraction:
    """Solve the linear diffraction problem.

    Parameters
    ----------
    wavenumber_rad_m
        Wavenumber k of the incident wave along +x.
    radius_m
        Radius a of the cylinder.
    width_m
        Width of the flume with the cylinder in its middle; None for open water.

    Raises
    ------
    ValueError
        The cylinder does not fit into the flume, or the wave is in resonance with the flume's width.
    """
    ka = wavenumber_rad_m * radius_m
    if width_m is not None and 2 * radius_m >= width_m:
        raise ValueError(
            f"a cylinder of {2 * radius_m:g} m does not fit into a flume {width_m:g} m wide: no water could pass"
        )
    last = math.ceil(ka) + _SCATTERED_ORDERS
    orders = np.arange(-last, last + 1)
    ratio = jvp(orders, ka) / h1vp(orders, ka)
    if width_m is None:
        return Diffraction(wavenumber_rad_m, radius_m, None, -(1j**orders) * ratio, np.empty(0, complex))
    most = math.ceil(NEAR * wavenumber_rad_m * width_m) + _REGULAR_ORDERS
    sums = _image_sums(wavenumber_rad_m * width_m, last + most)
    coupling = sums[np.abs(orders[None, :] - orders[:, None])]
    # Unknowns sqrt(Z_n) A_n: the matrix is symmetric and well scaled, whereas A_n and Z_n are not.
    root = np.sqrt(ratio)
    matrix = np.eye(len(orders)) + root[:, None] * coupling * root[None, :]
    scaled = np.linalg.solve(matrix, -root * 1j**orders)
    scattered = root * scaled
    everywhere = np.arange(-most, most + 1)
    regular = 1j**everywhere + sums[np.abs(orders[None, :] - everywhere[:, None])] @ scattered
    return Diffraction(wavenumber_rad_m, radius_m, width_m, scattered, regular)


def _image_sums(phase_rad: float, highest_order: int) -> Complexes:
    """S_q = 2 cos(qπ/2) Σ_{j>0} H_q(j kW) for q = 0..highest_order, with kW the phase.

    The sum converges too slowly to be summed. Beyond the first terms it is, by residues, an integral along
    z = J - 1/2 + iy of H_q(kW z) exp(-2πipz) / (exp(2πiz) - 1), which falls off exponentially on both sides
    when p is the number of the flume's highest mode that still travels.
    """
    mode = math.floor(phase_rad / (2 * math.pi))
    above, below = phase_rad - 2 * math.pi * mode, 2 * math.pi * (mode + 1) - phase_rad
    if min(above, below) < _RESONANCE:
        raise ValueError(
            "the wave is in resonance with the width of the flume: a wave across the flume would grow "
            "without limit; change the period or the width a little"
        )
    # From J on the argument exceeds the order, and the integrand is no larger than the sum.
    first = math.ceil(highest_order / phase_rad) + 2
    reach = math.asinh(40 / min(above, below))
    count = math.ceil(reach / _QUADRATURE_STEP)
    u = np.arange(-count, count + 1) * _QUADRATURE_STEP
    height, weight = np.sinh(u), np.cosh(u) * _QUADRATURE_STEP
    z = first - 0.5 + 1j * height
    upper = height > 0
    turn = np.exp(np.where(upper, 2j, -2j) * math.pi * z)
    kernel = np.exp(1j * np.where(upper, above, -below) * z) / np.where(upper, turn - 1, 1 - turn)
    sums = np.zeros(highest_order + 1, np.complex128)
    terms = phase_rad * np.arange(1, first)
    for order in range(0, highest_order + 1, 2):
        # hankel1e is the function times exp(-iz), which is part of the kernel.
        integral = -1j * (hankel1e(order, phase_rad * z) * kernel * weight).sum()
        sums[order] = 2 * (-1) ** (order // 2) * (hankel1(order, terms).sum() + integral)
    return sums
