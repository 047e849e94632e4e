from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from thermacq.reconstruction.triangulation import depth_per_pixel, plane_disparity, triangulate

GEOMETRY = {"focal_px": 700.0, "principal_point_px": (31.5, 23.5), "baseline_m": 0.06}


@given(
    point=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.2, 5.0)),
    doffs=st.floats(-40, 40),
)
def test_a_projected_point_comes_back(point, doffs):
    """Project by hand into both cameras, triangulate the difference of columns."""
    x, y, z = point
    u_left = GEOMETRY["focal_px"] * x / z + GEOMETRY["principal_point_px"][0]
    v = GEOMETRY["focal_px"] * y / z + GEOMETRY["principal_point_px"][1]
    u_right = GEOMETRY["focal_px"] * (x - 0.06) / z + GEOMETRY["principal_point_px"][0] + doffs
    shifted = {**GEOMETRY, "principal_point_px": (31.5 - u_left, 23.5 - v), "doffs_px": doffs}
    back = triangulate(np.array([[u_left - u_right]], np.float64), **shifted)[0, 0]
    np.testing.assert_allclose(back, point, atol=1e-9)


def test_unknown_and_impossible_disparities_have_no_point():
    points = triangulate(np.array([[np.nan, 0.0, -3.0, 5.0]], np.float32), **GEOMETRY)
    assert np.isnan(points[0, :3]).all()
    assert np.isfinite(points[0, 3]).all()


def test_negative_disparity_has_a_depth_when_the_principal_points_differ():
    points = triangulate(np.array([[-3.0]], np.float32), **GEOMETRY, doffs_px=10.0)
    assert points[0, 0, 2] == 0.06 * 700.0 / 7.0


def test_disparity_of_a_plane_triangulates_back_onto_the_plane():
    normal = np.array([0.1, -0.4, -0.9])
    normal /= np.linalg.norm(normal)
    disparity = plane_disparity((48, 64), normal, 0.6, **GEOMETRY, doffs_px=4.0)
    points = triangulate(disparity, **GEOMETRY, doffs_px=4.0)
    np.testing.assert_allclose(points @ normal + 0.6, 0.0, atol=1e-9)


def test_a_plane_behind_the_camera_has_no_disparity():
    assert np.isnan(plane_disparity((4, 4), np.array([0.0, 0.0, 1.0]), 0.6, **GEOMETRY)).all()


def test_one_pixel_in_the_papers_geometry_is_ten_millimetres():
    assert abs(depth_per_pixel(0.65, 705.9, 0.06) - 0.00998) < 1e-5
