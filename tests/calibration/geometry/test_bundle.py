"""Joint least squares: derivatives, agreement with OpenCV, covariance."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from thermacq_calibration import CameraModel, StereoCalibration, board_points
from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.bundle import (
    PARAMETERS,
    Corners,
    Geometry,
    Poses,
    covariance,
    fit,
    fit_poses,
    linearise,
    project,
)
from thermacq_calibration.geometry.distortion import FIRST, free_parameters, refit
from thermacq_calibration.geometry.solving import first_solution

SIZE = (640, 512)


def corners_of(views, board) -> Corners:
    points = board_points(board)
    return Corners.join([(points, view.left.corners, view.right.corners) for view in views])


@pytest.fixture(scope="module")
def solved(pair):
    corners = corners_of(pair.views(12, 0.1, seed=1), pair.board)
    return first_solution(corners, SIZE), corners


def test_projection_is_that_of_opencv(pair):
    points = np.random.default_rng(0).uniform([-0.2, -0.2, 0.5], [0.2, 0.2, 0.9], (20, 3))
    left, right = project(Geometry.of(pair.truth), points)
    for pixels, camera, turn, shift in (
        (left, pair.truth.left, np.eye(3), np.zeros(3)),
        (right, pair.truth.right, pair.truth.rotation, pair.truth.translation_m),
    ):
        rvec = cv2.Rodrigues(turn)[0]
        wanted = cv2.projectPoints(points, rvec, shift, camera.matrix, camera.distortion)[0].reshape(-1, 2)
        np.testing.assert_allclose(pixels, wanted, atol=1e-9)


def test_no_small_step_makes_the_solution_better(solved):
    found, corners = solved
    cost = np.sum(found.errors_px**2)
    sigma = np.sqrt(np.diag(covariance(found, corners)))
    for place, one in zip(np.flatnonzero(found.free), sigma, strict=True):
        for way in (1, -1):
            step = np.zeros(PARAMETERS)
            step[place] = way * one
            _, errors = fit_poses(found.geometry.moved(step), found.poses, corners)
            assert np.sum(errors**2) > cost


def test_the_solution_is_that_of_opencv(solved):
    found, corners = solved
    made = found.geometry.calibration(SIZE)
    parts = [slice(*corners.starts[view : view + 2]) for view in range(corners.views)]
    points, left, right = (
        [values[part].astype(np.float32) for part in parts]
        for values in (corners.points_m, corners.left, corners.right)
    )
    rms, left_k, left_d, _, _, _, shift, *_ = cv2.stereoCalibrate(
        points,
        left,
        right,
        made.left.matrix.copy(),
        made.left.distortion.copy(),
        made.right.matrix.copy(),
        made.right.distortion.copy(),
        SIZE,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12),
    )
    assert np.sqrt(np.sum(found.errors_px**2) / (2 * len(corners.left))) == pytest.approx(rms, rel=1e-5)
    np.testing.assert_allclose(made.left.matrix, left_k, atol=5e-3)
    np.testing.assert_allclose(made.left.distortion, np.ravel(left_d)[:5], atol=1e-4)
    np.testing.assert_allclose(made.translation_m, np.ravel(shift), atol=1e-6)


def test_views_with_parts_of_the_board_are_fitted_too(pair):
    points = board_points(pair.board)
    views = pair.views(12, 0.0, seed=1)
    some = [np.flatnonzero(np.arange(54) % (2 + index % 3)) for index in range(12)]
    corners = Corners.join(
        [
            (points[part], view.left.corners[part], view.right.corners[part])
            for view, part in zip(views, some, strict=True)
        ]
    )
    found = first_solution(corners, SIZE)
    assert np.abs(found.errors_px).max() < 1e-3
    assert np.linalg.norm(found.geometry.translation_m) == pytest.approx(pair.truth.baseline_m, rel=1e-5)


def test_weights_are_as_good_as_repetition(solved):
    found, corners = solved
    weights = np.array([3.0, 0, 2, 1, 1, 1, 1, 0, 1, 1, 1, 2])
    weighted = fit(found.geometry, found.poses, corners, found.free, weights)
    repeated = np.repeat(np.arange(12), weights.astype(int))
    again = fit(found.geometry, found.poses.select(repeated), corners.select(repeated), found.free)
    np.testing.assert_allclose(weighted.geometry.left, again.geometry.left, rtol=1e-6, atol=1e-6)


def test_parameters_that_are_not_free_stay(solved):
    found, corners = solved
    none = refit(found, corners, "none")
    assert not none.geometry.left[4:].any()
    assert not none.geometry.right[4:].any()
    rational = refit(found, corners, "rational")
    assert rational.geometry.calibration(SIZE).left.distortion.size == 8
    assert np.sum(rational.errors_px**2) <= np.sum(found.errors_px**2)


def test_covariance_is_that_of_many_trials(pair):
    """Linear theory against brute force: 60 fits to the same poses with fresh noise."""
    exact = corners_of(pair.views(15, 0.0, seed=4), pair.board)
    start = first_solution(exact, SIZE)
    random = np.random.default_rng(5)
    free = free_parameters(FIRST)
    estimates, sigmas = [], []
    for _ in range(60):
        noisy = Corners(
            exact.points_m,
            exact.left + random.normal(0, 0.1, exact.left.shape),
            exact.right + random.normal(0, 0.1, exact.right.shape),
            exact.starts,
        )
        found = fit(start.geometry, start.poses, noisy, free)
        estimates.append([*found.geometry.left[:4], *found.geometry.translation_m])
        sigmas.append(np.sqrt(np.diag(covariance(found, noisy)))[[0, 1, 2, 3, -3, -2, -1]])
    ratio = np.std(estimates, axis=0, ddof=1) / np.mean(sigmas, axis=0)
    # A standard deviation from 60 trials is known to 9 %.
    np.testing.assert_allclose(ratio, 1.0, atol=0.3)


def test_one_pose_again_and_again_has_no_covariance(small_pair):
    """Two pictures of a plane give 16 numbers; pose, relative pose and two pinhole cameras are 20."""
    view = small_pair.views(1, 0.0, seed=2)[0]
    corners = corners_of([view] * 6, small_pair.board)
    rotation, shift = small_pair.poses(1, seed=2)[0]
    poses = Poses(np.repeat(rotation[None], 6, axis=0), np.repeat(shift[None], 6, axis=0))
    found = fit(Geometry.of(small_pair.truth), poses, corners, free_parameters("none"), iterations=1)
    assert covariance(found, corners) is None


def test_unknown_distortion_is_refused(pair):
    strange = CameraModel(pair.truth.left.matrix, np.array([0.0] * 8 + [1e-3, 0, 0, 0]))
    record = StereoCalibration(SIZE, strange, strange, np.eye(3), np.array([-0.06, 0, 0]))
    with pytest.raises(CalibrationError, match="prism"):
        Geometry.of(record)


def test_linearise_fills_up_short_views(solved, pair):
    found, corners = solved
    system = linearise(found.geometry, found.poses, corners, found.free)
    part = np.array([3, 5])
    alone = linearise(found.geometry, found.poses.select(part), corners.select(part), found.free)
    np.testing.assert_allclose(system.matrix[part], alone.matrix, rtol=1e-9)
