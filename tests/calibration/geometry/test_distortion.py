"""The choice of a distortion model."""

from __future__ import annotations

import numpy as np
import pytest

from thermacq_calibration import CameraModel, StereoCalibration, board_points
from thermacq_calibration.geometry.bundle import PARAMETERS, Corners
from thermacq_calibration.geometry.distortion import CANDIDATES, choose, folds, free_parameters, refit
from thermacq_calibration.geometry.solving import first_solution

SIZE = (640, 512)


def views_of(pair, distortion, noise_px=0.05):
    """Corners of 20 views through lenses of a distortion."""
    truth = pair.truth
    cameras = [CameraModel(camera.matrix, np.array(distortion)) for camera in (truth.left, truth.right)]
    lenses = StereoCalibration(SIZE, *cameras, truth.rotation, truth.translation_m)
    points = board_points(pair.board)
    seen = type(pair)(lenses, pair.board)
    return Corners.join(
        [(points, view.left.corners, view.right.corners) for view in seen.views(20, noise_px, seed=2)]
    )


@pytest.mark.parametrize(
    ("distortion", "wanted"),
    [
        ([0.0, 0.0, 0.0, 0.0], {"none", "k1"}),
        ([-0.2, 0.0, 0.0, 0.0], {"k1", "k1 k2", "k1 k2 p1 p2"}),
        ([-0.3, 0.2, 3e-3, -3e-3], {"k1 k2 p1 p2", "k1 k2 p1 p2 k3"}),
    ],
)
def test_the_choice_follows_the_lens(pair, distortion, wanted):
    corners = views_of(pair, distortion)
    model, scores = choose(first_solution(corners, SIZE), corners)
    assert model in wanted
    assert [score.model for score in scores] == list(CANDIDATES)
    by_name = {score.model: score for score in scores}
    assert by_name[model].determined
    assert by_name[model].excess_px2 <= 2 * by_name[model].excess_se_px2
    assert min(score.excess_px2 for score in scores if score.determined) == 0


def forty_views(pair, seed):
    points = board_points(pair.board)
    return Corners.join(
        [(points, view.left.corners, view.right.corners) for view in pair.views(40, 0.1, seed=seed)]
    )


def test_weak_tangential_distortion_is_not_left_out(pair):
    """The principal point would take it up, and err by several of its stated uncertainties."""
    corners = forty_views(pair, seed=1027)
    model, scores = choose(first_solution(corners, SIZE), corners)
    assert next(score for score in scores if score.excess_px2 == 0).model == "k1 k2"
    assert model == "k1 k2 p1 p2"


def test_a_rational_model_of_a_narrow_lens_is_not_determined(pair):
    """Its coefficients cancel: here it predicts held-out views best, but says nothing on depth."""
    corners = forty_views(pair, seed=1073)
    model, scores = choose(first_solution(corners, SIZE), corners)
    assert not scores[-1].determined
    assert scores[-1].excess_px2 < 0
    assert model == "k1 k2 p1 p2"


def test_a_strong_fisheye_needs_more_coefficients(pair):
    corners = views_of(pair, [-0.6, 0.9, 0.0, 0.0, -1.2], noise_px=0.02)
    model, scores = choose(first_solution(corners, SIZE), corners)
    assert model in {"k1 k2 p1 p2 k3", "rational"}
    assert next(score for score in scores if score.model == "k1 k2").excess_px2 > 0


def test_held_out_error_is_that_of_the_noise(pair):
    corners = views_of(pair, [-0.2, 0.0, 0.0, 0.0], noise_px=0.1)
    _, scores = choose(first_solution(corners, SIZE), corners)
    by_name = {score.model: score.held_out_rms_px for score in scores}
    # 0.1 px per axis, 6 of 216 figures go into the pose of a view.
    assert by_name["k1"] == pytest.approx(0.1 * np.sqrt(2 * (1 - 6 / 216)), rel=0.05)
    assert by_name["none"] > 2 * by_name["k1"]


def test_free_parameters_name_both_cameras():
    assert free_parameters("rational").sum() == PARAMETERS
    assert free_parameters("none").sum() == 4 + 4 + 6
    assert free_parameters("k1 k2").sum() == 14 + 4


def test_coefficients_that_a_model_has_not_become_zero(pair):
    corners = views_of(pair, [-0.2, 0.1, 2e-3, 0.0])
    found = refit(first_solution(corners, SIZE), corners, "k1")
    assert np.flatnonzero(found.geometry.left[4:]).tolist() == [0]


def test_every_view_is_held_out_once():
    held_out = np.concatenate([test for _, test in folds(13)])
    assert sorted(held_out) == list(range(13))
    assert all(np.intersect1d(train, test).size == 0 for train, test in folds(13))
