"""The direction of X of a world frame, measured: from a board, from two marks, or from the waves themselves."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.shared_board import BoardCorners
from thermacq.reconstruction.world import WorldFrame
from thermacq_calibration import Board, StereoCalibration, board_points, rectify, rectify_points

if TYPE_CHECKING:
    import xarray as xr

_LEAST_FLAT = 0.85
"""Cosine of the steepest a board may lie whose rows shall be a horizontal direction (32 degrees)."""
_TIME_BLOCKS = 8
_SPACE_BLOCKS = 3
_LEAST_FRAMES = 24
_MOST_UNCERTAIN_DEG = 20.0
_LEAST_TRAVEL = 0.15
"""Flux over what the same rates and slopes would carry if all waves travelled one way; standing waves have none."""


@dataclass(frozen=True)
class Direction:
    """A horizontal direction in a world frame.

    Parameters
    ----------
    angle_rad
        From the frame's X towards its Y.
    u_rad
        Standard uncertainty.
    source
        How it was found, as plain values.
    """

    angle_rad: float
    u_rad: float
    source: dict[str, Any]


def turned_frame(world: WorldFrame, direction: Direction) -> WorldFrame:
    """The frame with its X along a direction; the coordinates of the camera stay what they were.

    The rig's ``[world]`` table measures the place of the camera in the flume, along the flume, so the place is
    right already; only the axes were not.
    """
    cosine, sine = np.cos(direction.angle_rad), np.sin(direction.angle_rad)
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    slopes = np.eye(3)
    slopes[1:, 1:] = turn[:2, :2]
    return dataclasses.replace(
        world,
        rotation=turn @ world.rotation,
        covariance=slopes @ world.covariance @ slopes.T,
        x_axis_u_deg=float(np.degrees(direction.u_rad)),
        source={**world.source, "x_axis": direction.source},
    )


def direction_of_board(world: WorldFrame, views: Sequence[BoardCorners], board: Board) -> Direction:
    """Direction in which the corners of a row are counted, of a board that lies along the flume.

    The uncertainty comes from the spread of several views; of a single one, from the misfit of its corners.

    Raises
    ------
    ReconstructionError
        There is no view, or the board stands rather than lies.
    """
    if not views:
        raise ReconstructionError(
            "the board was found in no view of both cameras", remedy="Lay it flat, in focus, wholly in view."
        )
    angles, own_u = zip(*(_board_angle(world, view, board) for view in views), strict=True)
    vectors = np.exp(1j * np.array(angles))
    mean = vectors.mean()
    off = np.angle(vectors / mean)
    spread = float(off.std(ddof=1) / np.sqrt(off.size)) if off.size > 1 else 0.0
    uncertainty = max(spread, float(np.mean(own_u)) / np.sqrt(off.size))
    source = {"from": "board", "views": len(angles), "u_deg": float(np.degrees(uncertainty))}
    return Direction(float(np.angle(mean)), uncertainty, source)


def _board_angle(world: WorldFrame, view: BoardCorners, board: Board) -> tuple[float, float]:
    """Angle and standard uncertainty of the rows of one view, by a rigid fit in the plane."""
    seen = world.to_world(view.points_m)
    flat = board_points(board)[view.indices].astype(np.float64)
    centred, model = seen - seen.mean(axis=0), flat - flat.mean(axis=0)
    u, _, vt = np.linalg.svd(centred.T @ model)
    rows = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    # Stereo knows the size; a wrong length of the squares must not count as misfit.
    model = model * np.sqrt((centred**2).sum() / (model**2).sum())
    if abs(rows[2, 2]) < _LEAST_FLAT:
        lean = np.degrees(np.arccos(abs(rows[2, 2])))
        raise ReconstructionError(
            f"the board leans by {lean:.0f}° from the horizontal: its rows do not tell a direction on the water",
            remedy="Lay it flat, its rows along the flume.",
        )
    along = rows[:, 0]
    residuals = (centred - model @ rows.T)[:, :2]
    lever = float((model**2).sum())
    sigma = float(np.sqrt((residuals**2).sum() / max(2 * len(residuals) - 4, 1)))
    return float(np.arctan2(along[1], along[0])), sigma / np.sqrt(lever)


def direction_of_marks(first_m: Sequence[float], second_m: Sequence[float], u_m: float) -> Direction:
    """Direction from one mark on the water to another.

    Parameters
    ----------
    first_m, second_m
        World coordinates x, y.
    u_m
        Standard uncertainty of each coordinate.

    Raises
    ------
    ReconstructionError
        They are too near to each other for a direction.
    """
    apart = np.subtract(second_m, first_m)[:2]
    distance = float(np.hypot(*apart))
    if not np.isfinite(distance) or distance < 10 * u_m or distance == 0:
        raise ReconstructionError(
            f"two marks {1000 * distance:.1f} mm apart, each known to {1000 * u_m:.1f} mm, give no direction",
            remedy="Choose marks farther apart.",
        )
    uncertainty = float(np.sqrt(2) * u_m / distance)
    source = {
        "from": "two marks",
        "marks_m": [list(map(float, first_m)), list(map(float, second_m))],
        "u_deg": float(np.degrees(uncertainty)),
    }
    return Direction(float(np.arctan2(apart[1], apart[0])), uncertainty, source)


def on_water(
    world: WorldFrame, calibration: StereoCalibration, pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where the rays of pixels of the left picture, as recorded, meet the still water.

    Parameters
    ----------
    world
        World frame.
    calibration
        Of its pair.
    pixels
        (n, 2) column and row.

    Returns
    -------
    numpy.ndarray
        (n, 3) float64, world coordinates.

    Raises
    ------
    ReconstructionError
        A pixel lies outside the picture, or looks above the horizon.
    """
    columns, rows = calibration.image_size
    if (pixels < -0.5).any() or (pixels > np.array([columns - 0.5, rows - 0.5])).any():
        raise ReconstructionError(f"a mark lies outside the picture of {columns} x {rows} pixels")
    rotation = rectify(calibration).rotation_left
    plane = rectify_points(calibration.left, pixels, rotation, np.eye(3))
    rays = np.column_stack([plane, np.ones(len(plane))]) @ world.rotation.T
    if (rays[:, 2] >= 0).any():
        raise ReconstructionError("a mark lies above the horizon, not on the water")
    points: NDArray[np.float64] = world.translation_m - rays * (world.translation_m[2] / rays[:, 2])[:, None]
    return points


def direction_of_waves(product: xr.Dataset) -> Direction:
    """Direction in which the waves travel, from the gradients of the surface in space and time.

    A wave ``a cos(k·x - w t)`` has ``-mean(eta_t grad eta) = a² w k / 2``: the sum over all waves is a vector along
    their energy-weighted mean direction, and its sign is that of their motion. Noise that is new in every
    frame cancels, because the central differences in time and in space use different frames; a constant
    error of the surface has no derivative in time. The uncertainty is the scatter across the vector between
    parts of the time and between parts of the area (waves from several sides show there).

    Raises
    ------
    ReconstructionError
        Too few frames or cells, hardly any waves, or no direction to speak of.
    """
    eta = product["eta"].to_numpy().astype(np.float64)
    time_s, x, y = (product[name].to_numpy().astype(np.float64) for name in ("time", "x", "y"))
    if time_s.size < _LEAST_FRAMES or min(x.size, y.size) < 3 * _SPACE_BLOCKS:
        raise ReconstructionError(
            f"{time_s.size} frames on {x.size} x {y.size} cells are too few for a direction of waves",
            remedy=f"Reconstruct at least {_LEAST_FRAMES} frames, better ten periods.",
        )
    flux, rate_rms, slope_rms = _flux(eta, time_s, x, y)
    total = np.nanmean(flux, axis=(1, 2, 3))
    size = float(np.hypot(*total))
    across = np.array([-total[1], total[0]]) / max(size, 1e-30)
    sideways = np.tensordot(across, flux, axes=1)
    parts_of_time = [np.nanmean(part) for part in np.array_split(sideways, _TIME_BLOCKS, axis=0)]
    parts_of_area = [
        np.nanmean(part)
        for band in np.array_split(sideways, _SPACE_BLOCKS, axis=1)
        for part in np.array_split(band, _SPACE_BLOCKS, axis=2)
    ]
    scatter = [np.nanstd(part, ddof=1) / np.sqrt(len(part)) for part in (parts_of_time, parts_of_area)]
    uncertainty = float(np.hypot(*scatter) / max(size, 1e-30))
    open_direction = not np.isfinite(uncertainty) or np.degrees(uncertainty) > _MOST_UNCERTAIN_DEG
    if open_direction or size < _LEAST_TRAVEL * rate_rms * slope_rms:
        raise ReconstructionError(
            "the surface shows no waves that travel in one direction (standing waves, or hardly any)",
            remedy="Use a record of travelling waves, two marks, or a board.",
        )
    source = {"from": "waves", "frames": int(time_s.size), "u_deg": float(np.degrees(uncertainty))}
    return Direction(float(np.arctan2(total[1], total[0])), uncertainty, source)


def _flux(
    eta: NDArray[np.float64], time_s: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, float]:
    """``-eta_t grad eta`` at inner frames and cells, (2, frames - 2, ny - 2, nx - 2), and the RMS of both factors."""
    inner = eta[1:-1, 1:-1, 1:-1]
    span = (time_s[2:] - time_s[:-2])[:, None, None]
    rate = (eta[2:, 1:-1, 1:-1] - eta[:-2, 1:-1, 1:-1]) / span
    along = (eta[1:-1, 1:-1, 2:] - eta[1:-1, 1:-1, :-2]) / (x[2:] - x[:-2])
    across = (eta[1:-1, 2:, 1:-1] - eta[1:-1, :-2, 1:-1]) / (y[2:] - y[:-2])[:, None]
    flux = np.stack([-rate * along, -rate * across])
    flux[:, ~np.isfinite(inner)] = np.nan
    rates, slopes = rate[np.isfinite(flux[0])], np.hypot(along, across)[np.isfinite(flux).all(axis=0)]
    if rates.size == 0 or slopes.size == 0:
        raise ReconstructionError("no cell is supported together with its neighbours in space and time")
    return flux, float(np.sqrt(np.mean(rates**2))), float(np.sqrt(np.mean(slopes**2)))
