"""Corners of a board in metres, as one pair of cameras or several pairs see them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.views import detect_views, open_views
from thermacq_calibration import Board, Detection, StereoCalibration, View, rectify, rectify_points

CORNER_PX = 0.1
"""Standard uncertainty of a corner in each coordinate, pixels; a heated board in focus is found this well."""
_FRAMES = re.compile(r"(\d+)-(\d+)")


@dataclass(frozen=True, eq=False)
class BoardCorners:
    """Corners of one view in the rectified left camera of a pair.

    Parameters
    ----------
    frames
        Pairs of the run in which the board stood like this.
    indices
        (n,) which points of the board.
    points_m
        (n, 3) float64.
    covariance
        (n, 3, 3) float64, m².
    """

    frames: range
    indices: NDArray[np.intp]
    points_m: NDArray[np.float64]
    covariance: NDArray[np.float64]


def board_corners(
    run_path: Path,
    board: Board,
    calibration: StereoCalibration,
    pair: str | None,
    frames_per_view: int | None,
) -> list[BoardCorners]:
    """Corners of every view in which both cameras of a pair see the board.

    Raises
    ------
    ReconstructionError, StoreError, ImportDataError
        The run cannot be read, or the board stands still in none of its views.
    """
    with open_views([run_path], frames_per_view, pair) as pictures:
        views, _ = detect_views(pictures, board)
    return [corners for view in views if (corners := _triangulated(view, calibration)) is not None]


def common_corners(
    first: list[BoardCorners], second: list[BoardCorners]
) -> list[tuple[BoardCorners, BoardCorners]]:
    """Views of two pairs at the same time, cut down to the corners that both see.

    Raises
    ------
    ReconstructionError
        There is none.
    """
    found = []
    for one in first:
        same = [other for other in second if set(one.frames) & set(other.frames)]
        if not same:
            continue
        other = max(same, key=lambda view: len(set(one.frames) & set(view.frames)))
        _, mine, its = np.intersect1d(one.indices, other.indices, return_indices=True)
        if mine.size >= 4:
            found.append((_chosen(one, mine), _chosen(other, its)))
    if not found:
        raise ReconstructionError(
            f"no view of the board is shared: the first pair sees it in {len(first)} views, the second in "
            f"{len(second)}, and never both at once",
            remedy="Hold the board where all four cameras see the whole of it.",
        )
    return found


def _triangulated(view: View, calibration: StereoCalibration) -> BoardCorners | None:
    if not (isinstance(view.left, Detection) and isinstance(view.right, Detection)):
        return None
    indices, mine, its = np.intersect1d(view.left.indices, view.right.indices, return_indices=True)
    points, covariance = triangulate_corners(view.left.corners[mine], view.right.corners[its], calibration)
    frames = _FRAMES.fullmatch(view.name)
    if frames is None or not np.isfinite(points).all():
        return None
    return BoardCorners(range(int(frames[1]), int(frames[2]) + 1), indices, points, covariance)


def triangulate_corners(
    left: NDArray[np.float64], right: NDArray[np.float64], calibration: StereoCalibration
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of corresponding pixels of the pictures as recorded, and their covariance.

    Parameters
    ----------
    left, right
        (n, 2) pixels (u, v).
    calibration
        Of the pair.

    Returns
    -------
    points : numpy.ndarray
        (n, 3) float64, rectified left camera, metres; NaN where the rays do not meet in front of the cameras.
    covariance : numpy.ndarray
        (n, 3, 3) float64, m², for `CORNER_PX` in every coordinate.
    """
    rectified = rectify(calibration)
    focal, baseline = rectified.focal_px, rectified.baseline_m
    seen_left, seen_right = (
        rectify_points(camera, pixels, rotation, projection)
        for camera, pixels, rotation, projection in (
            (calibration.left, left, rectified.rotation_left, rectified.projection_left),
            (calibration.right, right, rectified.rotation_right, rectified.projection_right),
        )
    )
    u0, v0 = rectified.principal_point_px
    disparity = seen_left[:, 0] - seen_right[:, 0] + rectified.doffs_px
    depth = baseline * focal / np.where(disparity > 0, disparity, np.nan)
    u = (seen_left[:, 0] - u0) / focal
    v = ((seen_left[:, 1] + seen_right[:, 1]) / 2 - v0) / focal
    ray = np.stack([u, v, np.ones_like(u)], axis=1)
    # Columns: by the left column, the right column, and the mean row.
    slope = (depth**2 / (baseline * focal))[:, None]
    across = np.zeros_like(ray)
    across[:, 0] = depth / focal
    along = np.zeros_like(ray)
    along[:, 1] = depth / focal / np.sqrt(2)
    derivative = np.stack([across - slope * ray, slope * ray, along], axis=2)
    covariance = CORNER_PX**2 * derivative @ derivative.transpose(0, 2, 1)
    return depth[:, None] * ray, covariance


def _chosen(corners: BoardCorners, which: NDArray[np.intp]) -> BoardCorners:
    return BoardCorners(
        corners.frames, corners.indices[which], corners.points_m[which], corners.covariance[which]
    )
