"""What looking for a target in a picture gives: its points, or the reason why there are none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Float


@dataclass(frozen=True, eq=False)
class Detection:
    """A target found in a picture.

    Parameters
    ----------
    corners
        (n, 2) float64 pixels (u, v), row by row of the board.
    sharpness_px
        Mean width of edges, 10 % to 90 %, the worse of two directions.
    contrast
        Mean difference between light and dark parts, counts.
    seen
        (n,) which points of the board the corners are, rising; None: all of them.
    """

    corners: Float
    sharpness_px: float
    contrast: float
    seen: NDArray[np.intp] | None = None

    @property
    def indices(self) -> NDArray[np.intp]:
        """(n,) which points of the board (see `boards.board_points`) the corners are."""
        return np.arange(len(self.corners)) if self.seen is None else self.seen


@dataclass(frozen=True)
class NoBoard:
    """No usable target, and why."""

    reason: str
