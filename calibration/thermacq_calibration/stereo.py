"""Calibrate a stereo pair from chessboard corners, and judge the result.

Each camera is calibrated alone first; the joint calibration starts from there and refines everything
together (on real pairs this halves the influence of single views). Views that fit far worse than the
others are left out and say so.

Distortion is Brown-Conrady in OpenCV's five coefficients with k3 fixed at 0: k1, k2, p1, p2 are free. On
17 real 640 x 512 pairs a free k3 lowers the RMS by 0.0003 px while k1 and k2 move by half of their values
and k2 and k3 cancel each other at the border; a 12 mm lens on a 17 um sensor needs no sixth power.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.boards import board_points, check_board
from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.models import Board, CameraModel, Float, ViewReport
from thermacq_calibration.record import StereoCalibration
from thermacq_calibration.rectification import vertical_differences_px
from thermacq_calibration.targets import Detection, NoBoard

MIN_VIEWS = 5
# Where cameras see parts of a board with markers, a view needs so many corners that both of them see.
MIN_SHARED_CORNERS = 12
COVERAGE_CELLS = (8, 6)
_FOLDS = 5
# A view is an outlier when its reprojection error, or the difference of its rows after rectification (two
# pictures that were not taken at the same moment), exceeds the median of the views by this many robust
# standard deviations and is more than twice the median. At most a quarter of the views may go.
_OUTLIER_SIGMAS = 5.0
_OUTLIER_RATIO = 2.0
_MAX_OUTLIER_PART = 0.25


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
class _Pair:
    """Corners of a usable view that both cameras saw: (n, 2) float64 pixels each, (n, 3) metres on the board."""

    name: str
    left: Float
    right: Float
    points: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class _Solution:
    """A joint calibration and what it says about each view."""

    calibration: StereoCalibration
    errors_px: Float
    """(views, 2) reprojection RMS, left and right."""
    rotations: Float
    """(views, 3) rotation vector, board to left camera."""
    translations_m: Float
    """(views, 3)."""


def calibrate_stereo(
    views: Sequence[View],
    board: Board,
    image_size: tuple[int, int],
    source: str = "",
    progress: Callable[[str], None] = lambda _: None,
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

    Returns
    -------
    StereoCalibration
        With per-view reports, rectified vertical error (on held-out views too) and coverage.

    Raises
    ------
    CalibrationError
        The board is ambiguous, fewer than `MIN_VIEWS` views are usable, or the views do not determine a
        geometry.
    """
    check_board(board)
    pairs = [
        _shared_corners(view.name, view.left, view.right, board)
        for view in views
        if isinstance(view.left, Detection) and isinstance(view.right, Detection) and not view.problem
    ]
    if len(pairs) < MIN_VIEWS:
        raise CalibrationError(
            f"only {len(pairs)} of {len(views)} views show the board in both pictures; {MIN_VIEWS} are needed"
            " at the least and 25 wanted",
            remedy="Record the board in more poses, tilted by 20 to 40 degrees, over the whole picture.",
        )
    progress(f"calibrating with {len(pairs)} views")
    solution, pairs, outliers = _without_outliers(pairs, image_size)
    progress("cross-validating")
    held_out = _held_out_vertical(pairs, image_size)
    measured = _measure(solution, pairs, held_out, board)
    reports = tuple(_report(view, measured, outliers) for view in views)
    vertical = _squares_mean([report.vertical_rms_px for report in measured.values()])
    return replace(
        solution.calibration,
        vertical_rms_px=vertical,
        held_out_vertical_rms_px=_squares_mean(held_out),
        coverage=(
            coverage([pair.left for pair in pairs], image_size),
            coverage([pair.right for pair in pairs], image_size),
        ),
        board=board,
        views=reports,
        source=source,
    )


def _shared_corners(name: str, left: Detection, right: Detection, board: Board) -> _Pair:
    shared, in_left, in_right = np.intersect1d(left.indices, right.indices, return_indices=True)
    return _Pair(name, left.corners[in_left], right.corners[in_right], board_points(board)[shared])


def coverage(corners: Sequence[Float], image_size: tuple[int, int]) -> float:
    """Part of the 8 x 6 cells of the picture that hold at least one corner, 0 to 1."""
    points = np.vstack(corners)
    limits = [(0, image_size[0]), (0, image_size[1])]
    counts, *_ = np.histogram2d(points[:, 0], points[:, 1], bins=COVERAGE_CELLS, range=limits)
    return float(np.mean(counts > 0))


def _without_outliers(
    pairs: list[_Pair], image_size: tuple[int, int]
) -> tuple[_Solution, list[_Pair], dict[str, str]]:
    """Calibrate, leave out the view that fits far worse than the others, and repeat until none does."""
    outliers: dict[str, str] = {}
    may_go = min(int(_MAX_OUTLIER_PART * len(pairs)), len(pairs) - MIN_VIEWS)
    while True:
        solution = _solve(pairs, image_size)
        fit = np.sqrt(np.mean(solution.errors_px**2, axis=1))
        rows = np.array([_vertical_rms(solution.calibration, pair) for pair in pairs])
        excess = np.array([fit / _outlier_limit(fit), rows / _outlier_limit(rows)])
        kind, worst = divmod(int(np.argmax(excess)), len(pairs))
        if excess[kind, worst] <= 1 or len(outliers) >= may_go:
            return solution, pairs, outliers
        outliers[pairs[worst].name] = _outlier_reason(fit, worst) if kind == 0 else _moved_reason(rows, worst)
        pairs = pairs[:worst] + pairs[worst + 1 :]


def _outlier_limit(errors: Float) -> float:
    median = float(np.median(errors))
    sigma = 1.4826 * float(np.median(np.abs(errors - median)))
    return max(median + _OUTLIER_SIGMAS * sigma, _OUTLIER_RATIO * median, 1e-9)


def _outlier_reason(errors: Float, index: int) -> str:
    return (
        f"outlier: reprojection error {errors[index]:.2f} px, median of the views {np.median(errors):.2f} px"
    )


def _moved_reason(errors: Float, index: int) -> str:
    return (
        f"outlier: rows differ by {errors[index]:.2f} px, median of the views {np.median(errors):.2f} px; "
        "perhaps the two pictures were not taken at the same moment"
    )


def _solve(pairs: Sequence[_Pair], image_size: tuple[int, int]) -> _Solution:
    """Mono calibrations, then the joint one."""
    import cv2

    points = [pair.points for pair in pairs]
    left = [pair.left.astype(np.float32) for pair in pairs]
    right = [pair.right.astype(np.float32) for pair in pairs]
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9)
    try:
        mono = [_solve_mono(points, corners, image_size, stop) for corners in (left, right)]
        rms, left_k, left_d, right_k, right_d, rotation, translation, _, _, rvecs, tvecs, errors = (
            cv2.stereoCalibrateExtended(
                points,
                left,
                right,
                mono[0].matrix.copy(),
                mono[0].distortion.copy(),
                mono[1].matrix.copy(),
                mono[1].distortion.copy(),
                image_size,
                np.eye(3),
                np.zeros((3, 1)),
                flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
                criteria=stop,
            )
        )
    except cv2.error as error:
        raise _undetermined(str(error.err)) from None
    if not np.isfinite(rms):
        raise _undetermined("the fit did not converge")
    calibration = StereoCalibration(
        image_size,
        CameraModel(np.asarray(left_k, np.float64), _five(left_d), mono[0].rms_px),
        CameraModel(np.asarray(right_k, np.float64), _five(right_d), mono[1].rms_px),
        np.asarray(rotation, np.float64),
        np.ravel(translation),
        rms_px=float(rms),
    )
    return _Solution(
        calibration,
        np.asarray(errors, np.float64).reshape(-1, 2),
        np.array([np.ravel(vector) for vector in rvecs]),
        np.array([np.ravel(vector) for vector in tvecs]),
    )


def _solve_mono(
    points: list[NDArray[np.float32]],
    corners: list[NDArray[np.float32]],
    image_size: tuple[int, int],
    stop: tuple[int, int, float],
) -> CameraModel:
    import cv2

    guess = cv2.initCameraMatrix2D(points, corners, image_size)
    rms, matrix, distortion, *_ = cv2.calibrateCamera(
        points,
        corners,
        image_size,
        guess,
        np.zeros(5),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
        criteria=stop,
    )
    return CameraModel(np.asarray(matrix, np.float64), _five(distortion), float(rms))


def _five(distortion: NDArray[Any]) -> Float:
    return np.asarray(distortion, np.float64).ravel()[:5]


def _undetermined(detail: str) -> CalibrationError:
    return CalibrationError(
        f"the views do not determine the geometry of the cameras ({detail})",
        remedy="Tilt the board by 20 to 40 degrees about both axes, and show it all over the picture.",
    )


def _held_out_vertical(pairs: list[_Pair], image_size: tuple[int, int]) -> list[float]:
    """Vertical RMS of each view under a calibration made without it (and without the rest of its fold)."""
    folds = min(_FOLDS, len(pairs))
    held_out = np.zeros(len(pairs))
    for fold in range(folds):
        rest = [pair for index, pair in enumerate(pairs) if index % folds != fold]
        calibration = _solve(rest, image_size).calibration
        for index in range(fold, len(pairs), folds):
            held_out[index] = _vertical_rms(calibration, pairs[index])
    return [float(value) for value in held_out]


def _measure(
    solution: _Solution, pairs: list[_Pair], held_out: list[float], board: Board
) -> dict[str, ViewReport]:
    """Reports of the used views by name."""
    import cv2

    middle = board_points(board).mean(axis=0)
    reports = {}
    for index, pair in enumerate(pairs):
        rotation = cv2.Rodrigues(solution.rotations[index])[0]
        centre = rotation @ middle + solution.translations_m[index]
        reports[pair.name] = ViewReport(
            pair.name,
            used=True,
            left_rms_px=float(solution.errors_px[index, 0]),
            right_rms_px=float(solution.errors_px[index, 1]),
            vertical_rms_px=_vertical_rms(solution.calibration, pair),
            held_out_vertical_rms_px=held_out[index],
            tilt_deg=float(np.degrees(np.arccos(min(1.0, abs(rotation[2, 2]))))),
            distance_m=float(np.linalg.norm(centre)),
        )
    return reports


def _report(view: View, measured: dict[str, ViewReport], outliers: dict[str, str]) -> ViewReport:
    problem = view.problem or outliers.get(view.name, "")
    report = ViewReport(view.name, used=False, reason=problem) if problem else measured[view.name]
    found = [side for side in (view.left, view.right) if isinstance(side, Detection)]
    if not found:
        return report
    return replace(
        report,
        sharpness_px=max(side.sharpness_px for side in found),
        contrast=min(side.contrast for side in found),
    )


def _vertical_rms(calibration: StereoCalibration, pair: _Pair) -> float:
    return float(np.sqrt(np.mean(vertical_differences_px(calibration, pair.left, pair.right) ** 2)))


def _squares_mean(values: Sequence[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
