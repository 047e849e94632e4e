from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.evaluation.quantisation import (
    depth_error_m,
    lateral_error_m,
    quantisation_curve,
    world_errors_m,
)

FOCAL_PX = 12e-3 / 17e-6


def test_one_pixel_in_the_papers_geometry():
    assert depth_error_m(0.65, 0.06, FOCAL_PX) == pytest.approx(7.05e-3, abs=5e-6)


def test_hand_numbers_of_equations_5_to_7():
    # z = 2 m, B = 0.5 m, f = 1000 px, e = 1 px; x = 0.5 m gives a root of sqrt(1 + 1/2).
    assert depth_error_m(2.0, 0.5, 1000) == pytest.approx(4 / (math.sqrt(2) * 500))
    assert lateral_error_m(2.0, 0.0, 0.5, 1000) == pytest.approx(0.002)
    assert lateral_error_m(2.0, 0.5, 0.5, 1000) == pytest.approx(0.002 * math.sqrt(1.5))
    assert lateral_error_m(2.0, 0.5, 0.5, 1000, 0.25) == pytest.approx(0.0005 * math.sqrt(1.5))


def test_depth_error_is_the_derivative_of_triangulation():
    z, baseline, focal = 0.65, 0.06, FOCAL_PX
    disparity = baseline * focal / z
    step = 1e-4
    change = baseline * focal / (disparity - step) - z
    assert depth_error_m(z, baseline, focal, step * math.sqrt(2)) == pytest.approx(change, rel=1e-4)


def test_lateral_error_is_the_error_propagation_of_equation_2():
    z, baseline, focal, column = 0.65, 0.06, FOCAL_PX, 250.0
    depth = depth_error_m(z, baseline, focal)
    propagated = math.hypot(z / focal, column / focal * depth)
    assert lateral_error_m(z, z * column / focal, baseline, focal) == pytest.approx(propagated)


@given(z=st.floats(0.1, 10), factor=st.floats(0.1, 10))
def test_depth_error_grows_with_the_square_of_distance(z, factor):
    assert depth_error_m(factor * z, 0.06, 700) == pytest.approx(factor**2 * depth_error_m(z, 0.06, 700))


def test_equation_8_takes_the_least_favourable_signs():
    errors = np.array([1.0, 2.0, 3.0])
    assert world_errors_m(np.eye(3), errors) == pytest.approx(errors)
    down = np.diag([1.0, -1.0, -1.0])
    assert world_errors_m(down, errors) == pytest.approx(errors)
    angle = math.radians(22.8)
    tilted = np.array(
        [[1, 0, 0], [0, math.cos(angle), -math.sin(angle)], [0, math.sin(angle), math.cos(angle)]]
    )
    assert world_errors_m(tilted, errors)[2] == pytest.approx(2 * math.sin(angle) + 3 * math.cos(angle))


def test_the_curve_of_figure_16():
    angle = math.radians(22.8)
    rotation = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]]) @ np.array(
        [[1, 0, 0], [0, math.cos(angle), -math.sin(angle)], [0, math.sin(angle), math.cos(angle)]]
    )
    distance = np.linspace(0.5, 2.0, 16)
    curve = quantisation_curve(distance, 0.06, FOCAL_PX, (320, 256), rotation)
    assert curve.depth_error_m == pytest.approx(depth_error_m(distance, 0.06, FOCAL_PX))
    lateral = lateral_error_m(distance, distance * 256 / FOCAL_PX, 0.06, FOCAL_PX)
    expected = math.sin(angle) * lateral + math.cos(angle) * curve.depth_error_m
    assert curve.vertical_error_m == pytest.approx(expected)
    assert np.all(np.diff(curve.vertical_error_m) > 0)
