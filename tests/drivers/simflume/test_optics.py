from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_drivers.simflume.mounting import Mounting, build_camera, nominal_pair
from thermacq_drivers.simflume.optics import distort, rotation_vector, stereo_pose, undistort


def all_pixels(rows: int, columns: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float)), axis=-1)


@pytest.mark.parametrize("side", ["left", "right"])
def test_projection_agrees_with_opencv(side: str) -> None:
    camera = build_camera(Mounting(side=side))
    random = np.random.default_rng(1)
    points = np.stack(
        [random.uniform(0.0, 0.55, 500), random.uniform(-0.35, 0.3, 500), random.uniform(-0.05, 0.05, 500)],
        -1,
    )
    rotation, _ = cv2.Rodrigues(camera.rotation)
    expected, _ = cv2.projectPoints(
        points, rotation, -camera.rotation @ camera.centre_m, camera.matrix, camera.distortion
    )
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-6)


@pytest.mark.parametrize("side", ["left", "right"])
def test_rays_of_all_pixels_project_back_onto_them(side: str) -> None:
    camera = build_camera(Mounting(side=side))
    pixels = all_pixels(camera.rows, camera.columns)
    points = camera.centre_m + 0.7 * camera.rays(pixels)
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-10)


@given(
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.4, 0.4),
    k1=st.floats(-0.3, 0.3),
    k2=st.floats(0, 0.2),
    tangential=st.floats(-0.002, 0.002),
)
def test_undistort_inverts_distort(x: float, y: float, k1: float, k2: float, tangential: float) -> None:
    distortion = np.array([k1, k2, tangential, -tangential, 0.0])
    plane = np.array([[x, y]])
    np.testing.assert_allclose(undistort(distort(plane, distortion), distortion), plane, atol=1e-10)


def test_a_lens_that_folds_the_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="folds"):
        Mounting(distortion=(-3.0, 0.0, 0.0, 0.0, 0.0))


def test_the_geometry_is_that_of_the_paper() -> None:
    left, right = nominal_pair(Mounting())
    assert left.matrix[0, 0] == pytest.approx(705.88, abs=0.01)
    # Table I: field of view 48.77° x 39.87°.
    field_of_view = 2 * np.degrees(np.arctan(np.array([640, 512]) / 2 / left.matrix[0, 0]))
    np.testing.assert_allclose(field_of_view, (48.77, 39.87), atol=0.02)
    assert left.centre_m[2] == 0.6
    assert np.degrees(np.arccos(-left.rotation[2, 2])) == pytest.approx(22.8)
    np.testing.assert_allclose(right.centre_m - left.centre_m, (0, -0.06, 0), atol=1e-15)
    # On the optical axis, at z = 0.65 m, the disparity is about 65 px.
    point = left.centre_m + left.rotation[2] * (0.6 / np.cos(np.radians(22.8)))
    assert point[2] == pytest.approx(0.0, abs=1e-12)
    disparity = left.project(point) - right.project(point)
    assert disparity[0] == pytest.approx(65, abs=0.5)
    assert disparity[1] == pytest.approx(0, abs=1e-9)
    # Picture up is +X, picture right is -Y.
    up, aside = left.project(np.add(point, (0.01, 0, 0))), left.project(np.add(point, (0, -0.01, 0)))
    assert up[1] < left.project(point)[1]
    assert aside[0] > left.project(point)[0]


def test_the_stereo_pose_maps_left_coordinates_to_right_ones() -> None:
    left, right = build_camera(Mounting(side="left")), build_camera(Mounting(side="right"))
    rotation, translation = stereo_pose(left, right)
    point = np.array([0.3, -0.05, 0.02])
    in_left = left.rotation @ (point - left.centre_m)
    in_right = right.rotation @ (point - right.centre_m)
    np.testing.assert_allclose(rotation @ in_left + translation, in_right, atol=1e-14)
    assert np.linalg.norm(translation) == pytest.approx(0.0604, abs=1e-4)


def test_misalignment_turns_the_camera_about_its_own_axes() -> None:
    straight = build_camera(Mounting(misalignment_deg=(0, 0, 0), displacement_m=(0, 0, 0)))
    turned = build_camera(Mounting(misalignment_deg=(0, 0, 1.0), displacement_m=(0, 0, 0)))
    np.testing.assert_allclose(
        turned.rotation @ straight.rotation.T, rotation_vector((0, 0, 1.0)), atol=1e-15
    )
