"""Points to cells: mean elevation, number of points and their standard deviation; never an invented cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError

_MOST_CELLS = 4_000_000


@dataclass(frozen=True)
class Grid:
    """A regular grid on the still water.

    Parameters
    ----------
    x_m, y_m
        (nx,) and (ny,) float64: centres of the cells, ascending, multiples of the spacing.
    spacing_m
        Side of a cell.
    """

    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    spacing_m: float

    @property
    def shape(self) -> tuple[int, int]:
        """Cells along y and x."""
        return self.y_m.size, self.x_m.size


@dataclass(frozen=True)
class GriddedSurface:
    """One surface on a grid: three arrays (ny, nx).

    Parameters
    ----------
    eta_m
        float32, mean elevation; NaN in cells with too few points.
    points
        int32, points in each cell, also where they were too few.
    sd_m
        float32, standard deviation inside the cell (n - 1); NaN where `eta_m` is or for a single point.
    """

    eta_m: NDArray[np.float32]
    points: NDArray[np.int32]
    sd_m: NDArray[np.float32]


def grid_over(x_m: NDArray[np.float64], y_m: NDArray[np.float64], spacing_m: float) -> Grid:
    """Grid that covers positions on the still water, its cell centres on multiples of the spacing.

    Raises
    ------
    ReconstructionError
        There are no positions, or the grid would have more than four million cells.
    """
    finite = np.isfinite(x_m) & np.isfinite(y_m)
    if not finite.any():
        raise ReconstructionError("the cameras have no common view of the still water")
    axes = [_axis(values[finite], spacing_m) for values in (x_m, y_m)]
    cells = axes[0].size * axes[1].size
    if cells > _MOST_CELLS:
        raise ReconstructionError(
            f"a grid of {spacing_m:g} m over this view would have {cells} cells",
            remedy="Choose a coarser reconstruction.grid_spacing_m.",
        )
    return Grid(axes[0], axes[1], spacing_m)


def _axis(values: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
    first, last = np.rint(values.min() / spacing_m), np.rint(values.max() / spacing_m)
    # Multiples of the spacing, free of the binary dust that would make 0.30000000000000004 of 0.3.
    return np.round(np.arange(first, last + 1) * spacing_m, 9)


def grid_points(points: NDArray[np.float64], grid: Grid, min_points: int) -> GriddedSurface:
    """Sort world points into cells.

    Parameters
    ----------
    points
        (..., 3) float64, world frame, metres; NaN points and points outside the grid are left out.
    grid
        Where the cells are.
    min_points
        Cells with fewer points stay NaN.
    """
    rows, columns = grid.shape
    flat = points.reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    column = np.rint((flat[:, 0] - grid.x_m[0]) / grid.spacing_m).astype(np.int64)
    row = np.rint((flat[:, 1] - grid.y_m[0]) / grid.spacing_m).astype(np.int64)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    cell, height = (row * columns + column)[inside], flat[inside, 2]
    count = np.bincount(cell, minlength=rows * columns)
    safe = np.maximum(count, 1)
    mean = np.bincount(cell, height, rows * columns) / safe
    # Deviations from the mean, not differences of squares: elevations are small beside their offset.
    square = np.bincount(cell, (height - mean[cell]) ** 2, rows * columns)
    supported = count >= min_points
    eta = np.where(supported, mean, np.nan)
    sd = np.where(supported & (count > 1), np.sqrt(square / np.maximum(count - 1, 1)), np.nan)
    return GriddedSurface(
        eta.reshape(grid.shape).astype(np.float32),
        count.reshape(grid.shape).astype(np.int32),
        sd.reshape(grid.shape).astype(np.float32),
    )
