"""What a water surface can be asked: elevation, slope, velocity of the water, and material label.

Every function takes coordinates in metres and time in seconds, broadcast against each other, and returns
float64. A material label is constant along the path of a water particle at the surface: whatever floats
on the water (here: the thermal texture) is a function of the label.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]


class Surface(Protocol):
    """A water surface z = eta(x, y, t)."""

    @property
    def highest_m(self) -> float:
        """Upper bound of the elevation."""
        ...

    @property
    def steepest(self) -> float:
        """Upper bound of the slope's magnitude."""
        ...

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation above still water, metres."""
        ...

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope along x and along y."""
        ...

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Horizontal velocity (x, y) of the water at the surface, m/s."""
        ...

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Material coordinates (along x, along y) of the particle now at (x, y), metres."""
        ...


@dataclass(frozen=True)
class StillWater:
    """Water at rest; a particle's label is its place."""

    highest_m: float = 0.0
    steepest: float = 0.0

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation: zero everywhere."""
        return np.zeros(np.broadcast(x_m, y_m, time_s).shape)

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope: zero everywhere."""
        zero = self.elevation(x_m, y_m, time_s)
        return zero, zero

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Velocity: zero everywhere."""
        return self.slope(x_m, y_m, time_s)

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Label: the place itself."""
        zero = self.elevation(x_m, y_m, time_s)
        return x_m + zero, y_m + zero
