"""Flat water as ground truth: deviation of a still-water product from a plane (paper, section V-B, Fig. 11)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermacq.errors import ReconstructionError

Grid: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Flatness:
    """How flat still water came out; grids (y, x), metres.

    Parameters
    ----------
    x_m, y_m
        World coordinates of the grid.
    mean_deviation_m
        Mean over time of the height above the world plane z = 0; NaN where a cell was never seen.
    cell_sd_m
        Standard deviation of each cell over time; NaN where it was seen less than twice.
    seen_fraction
        Part of the frames in which each cell was supported.
    mean_m
        Mean of all cells and frames: how far the water lies above the world plane.
    overall_sd_m
        Standard deviation of all cells and frames about that mean: the number below the paper's Fig. 11.
    fixed_sd_m, temporal_sd_m
        Its two parts: the spread of the mean map, and the root mean square of the spread over time.
    median_cell_sd_m
        Median of the cells' standard deviations over time: what the middle of the view achieves, whatever
        the edges do; NaN for a single frame.
    plane_sd_m
        Overall standard deviation left after the mean plane is taken out.
    offset_m, slope_x, slope_y
        (frames,) plane of each frame: height at the middle of the grid, and slopes; NaN for empty frames.
    offset_drift_m, tilt_drift_rad
        Last minus first value of a straight line through the offsets and the tilts over time.
    frames
        Number of frames.
    """

    x_m: Grid
    y_m: Grid
    mean_deviation_m: Grid
    cell_sd_m: Grid
    seen_fraction: Grid
    mean_m: float
    overall_sd_m: float
    fixed_sd_m: float
    temporal_sd_m: float
    median_cell_sd_m: float
    plane_sd_m: float
    offset_m: Grid
    slope_x: Grid
    slope_y: Grid
    offset_drift_m: float
    tilt_drift_rad: float
    frames: int


def flatness(frames: Iterable[NDArray[np.floating]], x_m: ArrayLike, y_m: ArrayLike) -> Flatness:
    """Measure the flatness of still water, one frame in memory at a time.

    Parameters
    ----------
    frames
        Elevation grids (y, x), metres, NaN where unsupported.
    x_m, y_m
        (x,), (y,) world coordinates, metres.

    Raises
    ------
    ReconstructionError
        No frame holds enough supported cells for a plane.
    """
    x, y = np.asarray(x_m, np.float64), np.asarray(y_m, np.float64)
    count = np.zeros((y.size, x.size))
    mean = np.zeros_like(count)
    squares = np.zeros_like(count)
    planes: list[Grid] = []
    for frame in frames:
        eta = np.asarray(frame, np.float64)
        seen = np.isfinite(eta)
        # Welford's update: differences of large sums would lose the micrometres.
        count += seen
        delta = np.where(seen, eta - mean, 0.0)
        mean += np.divide(delta, count, out=np.zeros_like(delta), where=count > 0)
        squares += delta * np.where(seen, eta - mean, 0.0)
        planes.append(fit_plane(eta, x, y))
    plane = np.array(planes).reshape(-1, 3)
    if not np.isfinite(plane).any():
        raise ReconstructionError(
            "the still-water product holds no frame with enough supported cells",
            remedy="Look at its disparity: still water without texture cannot be matched.",
        )
    seen = count > 0
    total = count.sum()
    overall_mean = float((count * mean).sum() / total)
    fixed = float((count * (mean - overall_mean) ** 2).sum() / total)
    temporal = float(squares.sum() / total)
    mean_map = np.where(seen, mean, np.nan)
    residual = mean_map - plane_at(fit_plane(mean_map, x, y), x, y)
    left = float((count * np.nan_to_num(residual) ** 2).sum() / total)
    cell_sd = np.sqrt(np.divide(squares, count - 1, out=np.full_like(mean, np.nan), where=count > 1))
    return Flatness(
        x_m=x,
        y_m=y,
        mean_deviation_m=mean_map,
        cell_sd_m=cell_sd,
        seen_fraction=count / len(planes),
        mean_m=overall_mean,
        overall_sd_m=float(np.sqrt(fixed + temporal)),
        fixed_sd_m=float(np.sqrt(fixed)),
        temporal_sd_m=float(np.sqrt(temporal)),
        median_cell_sd_m=float(np.nanmedian(cell_sd)) if (count > 1).any() else float("nan"),
        plane_sd_m=float(np.sqrt(left + temporal)),
        offset_m=plane[:, 0],
        slope_x=plane[:, 1],
        slope_y=plane[:, 2],
        offset_drift_m=_drift(plane[:, 0]),
        tilt_drift_rad=float(np.hypot(_drift(plane[:, 1]), _drift(plane[:, 2]))),
        frames=len(planes),
    )


def fit_plane(eta: Grid, x_m: Grid, y_m: Grid) -> Grid:
    """Least-squares plane of a grid: (height at the middle of the grid, slope along x, slope along y).

    All NaN when fewer than three cells are supported or when they lie on one line.
    """
    seen = np.isfinite(eta)
    rows, columns = np.nonzero(seen)
    if rows.size < 3:
        return np.full(3, np.nan)
    dx, dy = x_m[columns] - x_m.mean(), y_m[rows] - y_m.mean()
    solution, _, rank, _ = np.linalg.lstsq(
        np.stack([np.ones_like(dx), dx, dy], axis=1), eta[seen], rcond=None
    )
    return np.asarray(solution) if rank == 3 else np.full(3, np.nan)


def plane_at(plane: Grid, x_m: Grid, y_m: Grid) -> Grid:
    """Heights (y, x) of a plane from `fit_plane`."""
    heights = plane[0] + plane[1] * (x_m - x_m.mean())[None, :] + plane[2] * (y_m - y_m.mean())[:, None]
    return np.asarray(heights)


def _drift(values: Grid) -> float:
    """Rise of the straight line through finite values from the first to the last frame."""
    frames = np.flatnonzero(np.isfinite(values))
    if frames.size < 2:
        return float("nan")
    return float(np.polyfit(frames, values[frames], 1)[0] * (frames[-1] - frames[0]))
