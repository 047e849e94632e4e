"""Rectification: exact geometry for any pair, and resampling within hundredths of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from thermacq_calibration import (
    CalibrationError,
    CameraModel,
    StereoCalibration,
    apply,
    rectify,
    rectify_points,
    vertical_differences_px,
)


@st.composite
def calibrations(draw):
    """Pairs side by side with up to 5 degrees of misalignment and moderate distortion."""
    small = st.floats(-1, 1, allow_nan=False)
    angles = [5 * draw(small) for _ in range(3)]
    cameras = []
    for _ in range(2):
        focal = 700 + 30 * draw(small)
        matrix = np.array(
            [[focal, 0, 319 + 15 * draw(small)], [0, focal * 1.002, 255 + 15 * draw(small)], [0, 0, 1]]
        )
        distortion = np.array([0.15, 0.1, 1e-3, 1e-3, 0.05]) * [draw(small) for _ in range(5)]
        cameras.append(CameraModel(matrix, distortion))
    translation = np.array([-0.06, 0.004 * draw(small), 0.004 * draw(small)])
    return StereoCalibration(
        (640, 512), *cameras, Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), translation
    )


def seen_points(calibration, count=50):
    """Points in front of both cameras (left camera frame, metres) and their pixels."""
    random = np.random.default_rng(5)
    points = np.column_stack([random.uniform(-0.15, 0.15, (count, 2)), random.uniform(0.5, 1.0, count)])
    turn, _ = cv2.Rodrigues(calibration.rotation)
    left = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), calibration.left.matrix, calibration.left.distortion
    )
    right = cv2.projectPoints(
        points, turn, calibration.translation_m, calibration.right.matrix, calibration.right.distortion
    )
    return points, left[0].reshape(-1, 2), right[0].reshape(-1, 2)


@settings(max_examples=40, deadline=None)
@given(calibrations())
def test_rows_correspond_and_disparity_gives_the_depth(calibration):
    points, left, right = seen_points(calibration)
    made = rectify(calibration)
    flat_left = rectify_points(calibration.left, left, made.rotation_left, made.projection_left)
    flat_right = rectify_points(calibration.right, right, made.rotation_right, made.projection_right)
    np.testing.assert_allclose(flat_left[:, 1], flat_right[:, 1], atol=1e-6)
    disparity = flat_left[:, 0] - flat_right[:, 0]
    depth = made.baseline_m * made.focal_px / (disparity + made.doffs_px)
    x_y = (flat_left - made.principal_point_px) / made.focal_px * depth[:, None]
    in_rectified = points @ made.rotation_left.T
    np.testing.assert_allclose(np.column_stack([x_y, depth]), in_rectified, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(vertical_differences_px(calibration, left, right), 0, atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(calibrations())
def test_projection_matrices_agree_with_the_points(calibration):
    points, _, right = seen_points(calibration)
    made = rectify(calibration)
    flat = rectify_points(calibration.right, right, made.rotation_right, made.projection_right)
    homogeneous = np.column_stack([points @ made.rotation_left.T, np.ones(len(points))])
    projected = homogeneous @ made.projection_right.T
    np.testing.assert_allclose(projected[:, :2] / projected[:, 2:], flat, atol=1e-6)


def test_maps_lead_back_to_the_camera_pixels(pair):
    made = rectify(pair.truth)
    assert made.left is not None
    rows, columns = np.mgrid[10:500:70, 10:630:90]
    places = np.column_stack([made.left.map_x[rows, columns].ravel(), made.left.map_y[rows, columns].ravel()])
    back = rectify_points(pair.truth.left, places, made.rotation_left, made.projection_left)
    np.testing.assert_allclose(back, np.column_stack([columns.ravel(), rows.ravel()]), atol=2e-4)


def test_scale_is_kept_and_little_is_lost(pair):
    made = rectify(pair.truth)
    assert made.focal_px == pytest.approx(706.9)
    assert made.baseline_m == pytest.approx(pair.truth.baseline_m)
    assert made.doffs_px == 0
    assert min(valid.mean() for valid in made.valid) > 0.97


def waves(u, v, shortest_px, longest_px):
    """A band-limited texture, and its slope along u."""
    random = np.random.default_rng(3)
    value, slope = np.zeros_like(u), np.zeros_like(u)
    for _ in range(40):
        k = 2 * np.pi / random.uniform(shortest_px, longest_px)
        angle, phase = random.uniform(0, 2 * np.pi, 2)
        argument = k * (np.cos(angle) * u + np.sin(angle) * v) + phase
        value += 100 * np.sin(argument)
        slope += 100 * k * np.cos(angle) * np.cos(argument)
    return 8000 + value, slope


def shift_along_u(error, slope, inside):
    """RMS over blocks of 16 x 16 pixels of the shift that explains the error."""
    shifts = []
    for row in range(32, error.shape[0] - 48, 16):
        for column in range(32, error.shape[1] - 48, 16):
            block = np.s_[row : row + 16, column : column + 16]
            if inside[block].all():
                shifts.append(np.sum(error[block] * slope[block]) / np.sum(slope[block] ** 2))
    assert len(shifts) > 100
    return float(np.sqrt(np.mean(np.square(shifts))))


def test_resampling_moves_texture_by_less_than_a_thousandth_pixel(pair):
    v, u = np.mgrid[:512, :640].astype(float)
    picture, _ = waves(u, v, 6, 30)
    made = rectify(pair.truth)
    rectified, _ = apply(made, picture, picture)
    side = made.left
    assert side is not None
    truth, slope = waves(side.map_x.astype(float), side.map_y.astype(float), 6, 30)
    ours = shift_along_u(rectified - truth, slope, side.valid)
    remapped = cv2.remap(picture.astype(np.float32), side.map_x, side.map_y, cv2.INTER_CUBIC)
    quantised = shift_along_u(remapped - truth, slope, side.valid)
    assert ours < 0.001
    # The reason for not using the usual function: it rounds coordinates to 1/32 pixel.
    assert quantised > 5 * ours


def test_invalid_pixels_are_nan_and_only_those(pair):
    counts = np.full((512, 640), 9000, np.uint16)
    made = rectify(pair.truth)
    for rectified, valid in zip(apply(made, counts, counts), made.valid, strict=True):
        assert rectified.dtype == np.float32
        np.testing.assert_array_equal(np.isfinite(rectified), valid)
        np.testing.assert_allclose(rectified[valid], 9000, rtol=1e-6)


def test_a_pixel_that_is_no_number_spoils_only_its_neighbours(pair):
    counts = np.full((512, 640), 9000.0)
    counts[200, 300] = np.nan
    made = rectify(pair.truth)
    rectified, _ = apply(made, counts, counts)
    spoilt = np.isnan(rectified) & made.valid[0]
    assert 1 <= spoilt.sum() <= 36
    np.testing.assert_allclose(rectified[made.valid[0] & ~spoilt], 9000, rtol=1e-6)


def test_a_picture_without_any_number_stays_without(pair):
    nothing = np.full((512, 640), np.nan)
    rectified, _ = apply(rectify(pair.truth), nothing, nothing)
    assert np.isnan(rectified).all()


def test_rectified_geometry_is_not_resampled():
    given_geometry = StereoCalibration.from_rectified((64, 48), 100.0, (30.0, 20.0), 0.2, 31.0)
    made = rectify(given_geometry)
    assert (made.focal_px, made.principal_point_px, made.doffs_px) == (100.0, (30.0, 20.0), 31.0)
    counts = np.random.default_rng(0).integers(0, 65535, (48, 64)).astype(np.uint16)
    left, right = apply(made, counts, counts)
    np.testing.assert_array_equal(left, counts)
    np.testing.assert_array_equal(right, counts)
    assert all(valid.all() for valid in made.valid)
    point = np.array([0.02, -0.03, 0.8, 1.0])
    (u_left, _, w_left), (u_right, _, w_right) = made.projection_left @ point, made.projection_right @ point
    disparity = u_left / w_left - u_right / w_right
    assert made.baseline_m * made.focal_px / (disparity + made.doffs_px) == pytest.approx(0.8)


def test_exchanged_and_stacked_cameras_are_refused(pair):
    def moved(translation):
        return StereoCalibration(
            (640, 512), pair.truth.left, pair.truth.right, np.eye(3), np.array(translation)
        )

    with pytest.raises(CalibrationError, match="exchanged"):
        rectify(moved([0.06, 0, 0]))
    with pytest.raises(CalibrationError, match="above each other"):
        rectify(moved([-0.001, 0.06, 0]))


def test_pictures_of_another_camera_are_refused(pair):
    small = np.zeros((288, 382), np.uint16)
    right = np.zeros((512, 640), np.uint16)
    with pytest.raises(CalibrationError, match="left picture has 382 x 288"):
        apply(rectify(pair.truth), small, right)
