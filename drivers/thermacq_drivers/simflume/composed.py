"""Waters put together: several waves on one surface, and waves that are just starting.

Waves are superposed linearly: elevations, velocities and displacements of the labels add up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from thermacq_drivers.simflume.surfaces import Floats, Surface


@dataclass(frozen=True, eq=False)
class Superposed:
    """Several waters on one surface, e.g. a wave and its reflection.

    The label of a sum is right to first order; the waves carry each other along only in the next.

    Parameters
    ----------
    parts
        The waters.
    drift_m_s
        Mean drift of them together at the surface along x and y.
    """

    parts: tuple[Surface, ...]
    drift_m_s: tuple[float, float]

    @property
    def highest_m(self) -> float:
        """Upper bound of the elevation."""
        return sum(part.highest_m for part in self.parts)

    @property
    def steepest(self) -> float:
        """Upper bound of the slope's magnitude."""
        return sum(part.steepest for part in self.parts)

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation above still water, metres."""
        total: Floats = np.asarray(sum(part.elevation(x_m, y_m, time_s) for part in self.parts))
        return total

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope along x and along y."""
        return _added([part.slope(x_m, y_m, time_s) for part in self.parts])

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Horizontal velocity (x, y) of the water at the surface, m/s."""
        return _added([part.velocity(x_m, y_m, time_s) for part in self.parts])

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Material coordinates (along x, along y) of the particle now at (x, y), metres."""
        along, across = _added([part.label(x_m, y_m, time_s) for part in self.parts])
        surplus = len(self.parts) - 1
        return along - surplus * x_m, across - surplus * y_m


@dataclass(frozen=True, eq=False)
class Ramped:
    """Waves whose front travels along the flume at the group speed.

    Elevation and orbits are the full waves' times R = sin²(πq/2), with q going from 0 to 1 in the rise time from
    the moment when the front passes; harmonics grow like the first one. The drift goes with R². While the waves
    rise, the label is right to first order.

    Parameters
    ----------
    waves
        The waves in full.
    drift_m_s
        Their mean drift at the surface along x and y.
    start_s, rise_s
        When the front passes x = 0, and how long it takes to pass.
    group_speed_m_s
        Speed of the front along +x.
    """

    waves: Surface
    drift_m_s: tuple[float, float]
    start_s: float
    rise_s: float
    group_speed_m_s: float

    @property
    def highest_m(self) -> float:
        """Upper bound of the elevation."""
        return self.waves.highest_m

    @property
    def steepest(self) -> float:
        """Upper bound of the slope's magnitude; the front adds its own."""
        return self.waves.steepest + self.waves.highest_m * math.pi / (2 * self.rise_s * self.group_speed_m_s)

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation above still water, metres."""
        return np.sin(self._angle(x_m, time_s)) ** 2 * self.waves.elevation(x_m, y_m, time_s)

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope along x and along y."""
        angle = self._angle(x_m, time_s)
        along, across = self.waves.slope(x_m, y_m, time_s)
        growth = -np.sin(2 * angle) * math.pi / (2 * self.rise_s * self.group_speed_m_s)
        part = np.sin(angle) ** 2
        return part * along + growth * self.waves.elevation(x_m, y_m, time_s), part * across

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Horizontal velocity (x, y) of the water at the surface, m/s."""
        angle = self._angle(x_m, time_s)
        growth = np.sin(2 * angle) * math.pi / (2 * self.rise_s)
        along, across = self.waves.velocity(x_m, y_m, time_s)
        shift_x, shift_y = self._displacement(x_m, y_m, time_s)
        part = np.sin(angle) ** 2
        return part * along + growth * shift_x, part * across + growth * shift_y

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Material coordinates (along x, along y) of the particle now at (x, y), metres."""
        angle = self._angle(x_m, time_s)
        part = np.sin(angle) ** 2
        time = np.asarray(time_s, np.float64)
        # ∫ sin⁴ over the rise, and the whole time after it.
        after_s = time - self.start_s - x_m / self.group_speed_m_s - self.rise_s
        drifting_s = np.maximum(after_s, 0.0) + 2 * self.rise_s / math.pi * (
            3 * angle / 8 - np.sin(2 * angle) / 4 + np.sin(4 * angle) / 32
        )
        shift_x, shift_y = self._displacement(x_m, y_m, time_s)
        drift_x, drift_y = self.drift_m_s
        return x_m - part * shift_x - drift_x * drifting_s, y_m - part * shift_y - drift_y * drifting_s

    def _displacement(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Where particles are on the full waves' orbits."""
        along, across = self.waves.label(x_m, y_m, time_s)
        time = np.asarray(time_s, np.float64)
        return x_m - along - self.drift_m_s[0] * time, y_m - across - self.drift_m_s[1] * time

    def _angle(self, x_m: Floats, time_s: Floats | float) -> Floats:
        """πq/2 at points and times."""
        passed = np.asarray(time_s, np.float64) - self.start_s - x_m / self.group_speed_m_s
        angle: Floats = math.pi / 2 * np.clip(passed / self.rise_s, 0.0, 1.0)
        return angle


def _added(vectors: list[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    return np.asarray(sum(along for along, _ in vectors)), np.asarray(sum(across for _, across in vectors))
