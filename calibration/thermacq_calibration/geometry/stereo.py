"""Calibrate a stereo pair from corners of a board, and judge the result.

One joint least-squares fit of both cameras (see `bundle`), with the distortion model that predicts held-out views
best (see `distortion`). Views that fit far worse than the others are left out and say so; what cannot be a
calibration (exchanged sides, a square in millimetres, another board among the views) is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.bundle import Corners, Fit, fit
from thermacq_calibration.geometry.differences import half_set_difference
from thermacq_calibration.geometry.distortion import choose, folds, refit
from thermacq_calibration.geometry.diversity import groups_of_poses
from thermacq_calibration.geometry.judgement import refuse_impossible_square, refuse_wrong_sides
from thermacq_calibration.geometry.outliers import MIN_VIEWS, rows_rms, view_rms, without_outliers
from thermacq_calibration.geometry.record import StereoCalibration
from thermacq_calibration.geometry.solving import first_solution, rms_alone, undetermined
from thermacq_calibration.geometry.uncertainty import REPLICATES, WORKING_DISTANCE_M, bootstrap
from thermacq_calibration.models import Board, Float, ViewReport
from thermacq_calibration.targets.boards import board_points, check_board
from thermacq_calibration.targets.detection import Detection, NoBoard

# Where cameras see parts of a board with markers, a view needs so many corners that both of them see.
MIN_SHARED_CORNERS = 12
COVERAGE_CELLS = (8, 6)


@dataclass(frozen=True)
class View:
    """One pose of the board, as both cameras saw it."""

    name: str
    left: Detection | NoBoard
    right: Detection | NoBoard

    @property
    def problem(self) -> str:
        """Why the view cannot be used; empty when both cameras found enough of the board."""
        if isinstance(self.left, Detection) and isinstance(self.right, Detection):
            shared = np.intersect1d(self.left.indices, self.right.indices).size
            return "" if shared >= MIN_SHARED_CORNERS else f"the two pictures share only {shared} corners"
        return "; ".join(
            f"{side}: {found.reason}"
            for side, found in (("left", self.left), ("right", self.right))
            if isinstance(found, NoBoard)
        )


@dataclass(frozen=True, eq=False)
class _Seen:
    """Corners of a usable view that both cameras saw."""

    name: str
    left: Float
    right: Float
    points: NDArray[np.intp]
    """Which points of the board they are."""


def calibrate_stereo(
    views: Sequence[View],
    board: Board,
    image_size: tuple[int, int],
    source: str = "",
    progress: Callable[[str], None] = lambda _: None,
    *,
    working_distance_m: float = WORKING_DISTANCE_M,
    replicates: int = REPLICATES,
) -> StereoCalibration:
    """Calibrate both cameras and their relative pose.

    Parameters
    ----------
    views
        All views, found or not; those that are not used stand in the record with the reason.
    board
        The chessboard.
    image_size
        (columns, rows) of both cameras' pictures.
    source
        Where the views came from; stands in the record.
    progress
        Told in words what happens.
    working_distance_m
        Distance from the cameras to the water, at which depth is judged.
    replicates
        Of the bootstrap; 0 leaves the uncertainty unknown.

    Returns
    -------
    StereoCalibration
        With per-view reports, rectified vertical error (on held-out views too), coverage, the choice of the
        distortion model, the difference of half-sets, and uncertainties.

    Raises
    ------
    CalibrationError
        The board is ambiguous or impossible, fewer than `MIN_VIEWS` views are usable, the views do not determine
        a geometry or do not belong together, or left and right are exchanged.
    """
    check_board(board)
    refuse_impossible_square(board)
    seen = [_shared_corners(view) for view in views if not view.problem]
    if len(seen) < MIN_VIEWS:
        raise CalibrationError(
            f"only {len(seen)} of {len(views)} views show the board in both pictures; {MIN_VIEWS} are needed"
            " at the least and 25 wanted",
            remedy="Record the board in more poses, tilted by 20 to 40 degrees, over the whole picture.",
        )
    progress(f"calibrating with {len(seen)} views")
    points_m = board_points(board)
    every = Corners.join([(points_m[view.points], view.left, view.right) for view in seen])
    names = [view.name for view in seen]
    first = first_solution(every, image_size)
    groups = _poses(first, points_m)
    found, kept, outliers = without_outliers(first, every, names, image_size)
    corners, groups = every.select(kept), groups[kept]
    refuse_wrong_sides(found.geometry.calibration(image_size))
    progress("choosing the distortion model")
    model, scores = choose(found, corners)
    found = refit(found, corners, model)
    reports = _reports(found, corners, [names[index] for index in kept], points_m, image_size)
    half = half_set_difference(found, corners, image_size, working_distance_m)
    record = _with_alone(found, corners, image_size, model)
    return replace(
        record,
        rms_px=_rms(found.errors_px) * np.sqrt(2),
        vertical_rms_px=_rms([report.vertical_rms_px for report in reports.values()]),
        held_out_vertical_rms_px=_rms([report.held_out_vertical_rms_px for report in reports.values()]),
        coverage=(coverage([corners.left], image_size), coverage([corners.right], image_size)),
        board=board,
        views=tuple(_report(view, reports, outliers) for view in views),
        poses=int(np.unique(groups).size),
        working_distance_m=working_distance_m,
        distortion={"model": model, "scores": [asdict(score) for score in scores]},
        half_set={"rms_px": half.rms_px, "worst_px": half.worst_px, "depth_m": half.depth_m},
        uncertainty=None
        if replicates == 0
        else bootstrap(found, corners, image_size, groups, working_distance_m, replicates, progress),
        corners={view.name: _plain(view) for view in seen},
        source=source,
    )


def coverage(corners: Sequence[Float], image_size: tuple[int, int]) -> float:
    """Part of the 8 x 6 cells of the picture that hold at least one corner, 0 to 1."""
    points = np.vstack(corners)
    limits = [(0, image_size[0]), (0, image_size[1])]
    counts, *_ = np.histogram2d(points[:, 0], points[:, 1], bins=COVERAGE_CELLS, range=limits)
    return float(np.mean(counts > 0))


def _shared_corners(view: View) -> _Seen:
    assert isinstance(view.left, Detection)
    assert isinstance(view.right, Detection)
    shared, in_left, in_right = np.intersect1d(view.left.indices, view.right.indices, return_indices=True)
    return _Seen(view.name, view.left.corners[in_left], view.right.corners[in_right], shared)


def _plain(view: _Seen) -> dict[str, Any]:
    """Corners for the record: 0.001 px is far below what any detector does."""
    return {
        "points": view.points.tolist(),
        "left": view.left.round(3).tolist(),
        "right": view.right.round(3).tolist(),
    }


def _poses(found: Fit, points_m: NDArray[Any]) -> NDArray[np.intp]:
    """(views,) which views show the same pose of the board; too few poses are refused."""
    turns = found.poses.rotations
    groups = groups_of_poses(turns, turns @ points_m.mean(axis=0) + found.poses.translations_m)
    if (poses := np.unique(groups).size) < MIN_VIEWS:
        raise undetermined(f"the {groups.size} usable views show only {poses} different poses of the board")
    return groups


def _with_alone(found: Fit, corners: Corners, image_size: tuple[int, int], model: str) -> StereoCalibration:
    """The geometry as a record, with the error of each camera calibrated alone."""
    record = found.geometry.calibration(image_size)
    left, right = rms_alone(corners, image_size, model)
    return replace(record, left=replace(record.left, rms_px=left), right=replace(record.right, rms_px=right))


def _reports(
    found: Fit, corners: Corners, names: Sequence[str], points_m: NDArray[Any], image_size: tuple[int, int]
) -> dict[str, ViewReport]:
    """Reports of the used views by name."""
    left, right = (view_rms(found.errors_px[:, side], corners) for side in (slice(0, 2), slice(2, 4)))
    rows = rows_rms(found.geometry, corners, image_size)
    held_out = _held_out_rows(found, corners, image_size)
    turns, shifts = found.poses.rotations, found.poses.translations_m
    distances = np.linalg.norm(turns @ points_m.mean(axis=0) + shifts, axis=1)
    tilts = np.degrees(np.arccos(np.minimum(1.0, np.abs(turns[:, 2, 2]))))
    return {
        name: ViewReport(
            name,
            used=True,
            left_rms_px=float(left[index]),
            right_rms_px=float(right[index]),
            vertical_rms_px=float(rows[index]),
            held_out_vertical_rms_px=float(held_out[index]),
            tilt_deg=float(tilts[index]),
            distance_m=float(distances[index]),
        )
        for index, name in enumerate(names)
    }


def _held_out_rows(found: Fit, corners: Corners, image_size: tuple[int, int]) -> Float:
    """(views,) difference of rows in each view under a calibration made without it (and the rest of its fold)."""
    rows = np.empty(corners.views)
    for train, test in folds(corners.views):
        part = fit(found.geometry, found.poses.select(train), corners.select(train), found.free)
        rows[test] = rows_rms(part.geometry, corners.select(test), image_size)
    return rows


def _report(view: View, reports: dict[str, ViewReport], outliers: dict[str, str]) -> ViewReport:
    problem = view.problem or outliers.get(view.name, "")
    report = ViewReport(view.name, used=False, reason=problem) if problem else reports[view.name]
    found = [side for side in (view.left, view.right) if isinstance(side, Detection)]
    if not found:
        return report
    return replace(
        report,
        sharpness_px=max(side.sharpness_px for side in found),
        contrast=min(side.contrast for side in found),
    )


def _rms(values: Sequence[Any] | Float) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
