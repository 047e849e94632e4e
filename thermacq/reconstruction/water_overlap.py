"""Place and direction of a second elevation product relative to a first, from the waves that both see.

Shift and yaw are searched on a coarse grid around a place measured by hand, then fitted over all common times with
the gradients of both surfaces: residuals times the slopes of the second one, against the slopes of the first
(instrumental variables). Slopes are noisy, and least squares with those of one surface alone would take its noise
for information; noise of the two surfaces is independent and cancels. Long-crested waves leave the shift along their crests open;
the uncertainty then says so and the result is refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.joining import Placing

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

_REACH_M, _STEP_M = 0.06, 0.015
_REACH_DEG, _STEP_DEG = 6.0, 1.5
_COARSE_FRAMES, _FINE_FRAMES = 12, 48
_THIN = 3
_LEAST_CELLS = 60
_LEAST_CORRELATION = 0.7
_BLOCK_M = 0.08
_WORST_CONDITION = 1000.0
_WORST_M, _WORST_DEG = 0.005, 1.0


class _Pair(NamedTuple):
    """First surface on its grid; cells of the second one relative to its camera, their elevation and slopes."""

    first: Floats
    origin_m: tuple[float, float]
    spacing_m: float
    second: Floats
    slopes: Floats
    cells_m: Floats


def placing_by_water(
    first: xr.Dataset,
    second: xr.Dataset,
    frames: tuple[NDArray[np.intp], NDArray[np.intp]],
    camera_m: Floats,
    near: tuple[float, float, float],
) -> Placing:
    """Place of the second product's camera in the first product's world frame.

    Parameters
    ----------
    first, second
        Products.
    frames
        Indices of common frames in both, see `thermacq.reconstruction.fusion.common_times`.
    camera_m
        (2,) where the left camera of the second pair stands in its own present world frame.
    near
        x, y (m) of that camera in the first frame as measured by hand, within 6 cm, and the direction of the
        second frame's X in the first one (rad, from X towards Y), within 6 degrees.

    Raises
    ------
    ReconstructionError
        The products do not overlap there, do not agree, or the waves leave place or direction open.
    """
    coarse = _pair(first, second, frames, camera_m, _COARSE_FRAMES, _THIN)
    start = _searched(coarse, near)
    fine = _pair(first, second, frames, camera_m, _FINE_FRAMES, 1)
    place, covariance, residual, correlation, cells = _fitted(fine, start)
    x_u, y_u, yaw_u = np.sqrt(np.diag(covariance))
    if max(x_u, y_u) > _WORST_M or np.degrees(yaw_u) > _WORST_DEG:
        raise ReconstructionError(
            f"the waves leave the place of the second pair open by {1000 * x_u:.1f} mm along X, "
            f"{1000 * y_u:.1f} mm along Y and {np.degrees(yaw_u):.2f}° (standard uncertainties): long-crested "
            "waves look the same all along their crests",
            remedy="Use waves from several directions, a longer record, or a shared board.",
        )
    source: dict[str, Any] = {
        "by": "water",
        "frames": len(fine.first),
        "cells": cells,
        "residual_sigma_m": residual,
        "correlation": correlation,
    }
    # The direction of the first frame's X in the second is the opposite turn.
    return Placing(float(place[0]), float(place[1]), float(-place[2]), covariance, source)


def _pair(
    first: xr.Dataset,
    second: xr.Dataset,
    frames: tuple[NDArray[np.intp], NDArray[np.intp]],
    camera_m: Floats,
    most: int,
    thin: int,
) -> _Pair:
    chosen = np.unique(np.linspace(0, frames[0].size - 1, min(most, frames[0].size)).round().astype(np.intp))
    x, y = (first[name].to_numpy().astype(np.float64) for name in ("x", "y"))
    u, v = np.meshgrid(second["x"].to_numpy()[::thin], second["y"].to_numpy()[::thin])
    eta = second["eta"].isel(time=frames[1][chosen]).to_numpy()[:, ::thin, ::thin].astype(np.float64)
    return _Pair(
        first["eta"].isel(time=frames[0][chosen]).to_numpy().astype(np.float64),
        (float(x[0]), float(y[0])),
        float(x[1] - x[0]),
        eta.reshape(len(chosen), -1),
        np.stack([np.gradient(eta, float(u[0, 1] - u[0, 0]), axis=axis) for axis in (2, 1)]).reshape(
            2, len(chosen), -1
        ),
        np.stack([u.ravel(), v.ravel()], axis=1) - camera_m,
    )


def _seen(pair: _Pair, surface: Floats, place: Floats) -> Floats:
    """A field (frames, ny, nx) of the first product at the cells of the second: (frames, cells), bilinear."""
    from scipy.ndimage import map_coordinates

    cosine, sine = np.cos(place[2]), np.sin(place[2])
    x = place[0] + cosine * pair.cells_m[:, 0] - sine * pair.cells_m[:, 1]
    y = place[1] + sine * pair.cells_m[:, 0] + cosine * pair.cells_m[:, 1]
    column = (x - pair.origin_m[0]) / pair.spacing_m
    row = (y - pair.origin_m[1]) / pair.spacing_m
    inside = (column >= 0) & (column <= surface.shape[2] - 1) & (row >= 0) & (row <= surface.shape[1] - 1)
    seen = np.full((len(surface), x.size), np.nan)
    for frame, values in enumerate(surface):
        seen[frame, inside] = map_coordinates(values, [row[inside], column[inside]], order=1, mode="nearest")
    return seen


def _searched(pair: _Pair, near: tuple[float, float, float]) -> Floats:
    """The best place of a coarse grid, by correlation."""
    shifts = np.arange(-_REACH_M, _REACH_M + 1e-9, _STEP_M)
    turns = np.radians(np.arange(-_REACH_DEG, _REACH_DEG + 1e-9, _STEP_DEG))
    best, score = np.array(near), -1.0
    for turn in turns:
        for dx in shifts:
            for dy in shifts:
                place = np.array(near) + np.array([dx, dy, turn])
                found = _correlation(pair.second, _seen(pair, pair.first, place))
                if found > score:
                    best, score = place, found
    if score < _LEAST_CORRELATION:
        raise ReconstructionError(
            f"the two surfaces do not agree anywhere within {100 * _REACH_M:.0f} cm and {_REACH_DEG:.0f}° of the "
            f"place given (best correlation {max(score, 0.0):.2f})",
            remedy="Measure the place of the second camera again (--near), or use a shared board; still water has "
            "nothing to compare.",
        )
    return best


def _correlation(one: Floats, other: Floats) -> float:
    both = np.isfinite(one) & np.isfinite(other)
    if np.count_nonzero(both.any(axis=0)) * _THIN**2 < _LEAST_CELLS or not both.any():
        return -1.0
    a, b = one[both], other[both]
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-30))


def _fitted(pair: _Pair, start: Floats) -> tuple[Floats, Floats, float, float, int]:
    """Place, covariance, standard deviation of what remains, correlation, cells; by Gauss-Newton."""
    along = np.gradient(pair.first, pair.spacing_m, axis=2)
    across = np.gradient(pair.first, pair.spacing_m, axis=1)
    place = start.copy()
    for _ in range(12):
        model = _seen(pair, pair.first, place)
        slope_x, slope_y = _seen(pair, along, place), _seen(pair, across, place)
        cosine, sine = np.cos(place[2]), np.sin(place[2])
        turn_x = -sine * pair.cells_m[:, 0] - cosine * pair.cells_m[:, 1]
        turn_y = cosine * pair.cells_m[:, 0] - sine * pair.cells_m[:, 1]
        design = np.stack(
            [slope_x, slope_y, slope_x * turn_x + slope_y * turn_y, np.ones_like(model)], axis=-1
        )
        own_x = cosine * pair.slopes[0] - sine * pair.slopes[1]
        own_y = sine * pair.slopes[0] + cosine * pair.slopes[1]
        instrument = np.stack([own_x, own_y, own_x * turn_x + own_y * turn_y, np.ones_like(own_x)], axis=-1)
        known = np.isfinite(design).all(axis=-1) & np.isfinite(instrument).all(axis=-1)
        known &= np.isfinite(pair.second) & np.isfinite(model)
        if np.count_nonzero(known.any(axis=0)) < _LEAST_CELLS:
            raise ReconstructionError(
                "the two products hardly overlap: fewer than 60 cells are seen by both",
                remedy="Move the pairs nearer to each other, or use a shared board.",
            )
        rows, others, residuals = design[known], instrument[known], (pair.second - model)[known]
        step = np.linalg.pinv(others.T @ rows) @ (others.T @ residuals)
        place = place + np.clip(step[:3], -0.02, 0.02)
        if np.abs(step[:3]).max() < 1e-7:
            break
    block = _blocks(pair.cells_m)[np.nonzero(known)[1]]
    residuals = residuals - rows @ step
    covariance = _jackknife(rows, others, residuals, block)[:3, :3]
    normal = (others.T @ rows)[:3, :3]
    scale = np.sqrt(np.abs(np.diag(normal))) + 1e-30
    if np.linalg.cond(normal / np.outer(scale, scale)) > _WORST_CONDITION:
        covariance = np.full((3, 3), np.inf)
    correlation = _correlation(pair.second, _seen(pair, pair.first, place))
    return place, covariance, float(residuals.std()), correlation, int(np.count_nonzero(known.any(axis=0)))


def _blocks(cells_m: Floats) -> NDArray[np.int64]:
    """Number of the square of 8 cm that a cell lies in: errors of neighbouring cells hang together."""
    numbers = np.floor(cells_m / _BLOCK_M).astype(np.int64)
    numbers -= numbers.min(axis=0)
    joined: NDArray[np.int64] = numbers[:, 0] * (numbers[:, 1].max() + 1) + numbers[:, 1]
    return joined


def _jackknife(rows: Floats, others: Floats, residuals: Floats, block: NDArray[np.int64]) -> Floats:
    """Covariance of a linear fit from leaving out one block after the other."""
    normal = others.T @ rows
    moved = []
    for one in np.unique(block):
        out = block == one
        without = normal - others[out].T @ rows[out]
        moved.append(-np.linalg.pinv(without) @ (others[out].T @ residuals[out]))
    spread = np.stack(moved)
    covariance: Floats = (len(spread) - 1) / len(spread) * spread.T @ spread
    return covariance
