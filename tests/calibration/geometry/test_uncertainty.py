"""Stated uncertainties against true errors, on simulated corners."""

from __future__ import annotations

import numpy as np
import pytest

from thermacq_calibration import CalibrationError, board_points, calibrate_stereo, findings
from thermacq_calibration.geometry.acceptance import acceptance, verdict
from thermacq_calibration.geometry.bundle import Corners, Geometry
from thermacq_calibration.geometry.distortion import refit
from thermacq_calibration.geometry.diversity import groups_of_poses
from thermacq_calibration.geometry.solving import first_solution
from thermacq_calibration.geometry.uncertainty import CREST_M, bootstrap, from_covariance, judge, look

SIZE = (640, 512)
MODEL = "k1 k2 p1 p2"


def solve(pair, views):
    points = board_points(pair.board)
    corners = Corners.join([(points, view.left.corners, view.right.corners) for view in views])
    return refit(first_solution(corners, SIZE), corners, MODEL), corners


def z_scores(pair, seed: int, replicates: int = 20) -> dict[str, float]:
    """Error over stated standard uncertainty of one simulated calibration, the distortion model chosen anew."""
    made = calibrate_stereo(pair.views(40, 0.1, seed=seed), pair.board, SIZE, replicates=replicates)
    truth = Geometry.of(pair.truth)
    scene = look(truth, SIZE, 0.65)
    known, found = (judge(one, scene, SIZE)[0] for one in (truth, Geometry.of(made)))
    return {key: (found[key] - known[key]) / made.standard_uncertainty(key) for key in known}


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_errors_are_as_large_as_stated(pair):
    """20 calibrations from 40 diverse views each: errors in units of their sigma look like a normal."""
    from scipy import stats

    scores = [z_scores(pair, seed=300 + trial) for trial in range(20)]
    # The principal point takes up what a distortion model chosen too small leaves over.
    for quantity in ("baseline_m", "left_fx_px", "depth_m", "left_cx_px", "left_cy_px"):
        z = np.array([score[quantity] for score in scores])
        # Sum of squares of 20 normals: chi-square, of which this leaves out 1 in 1000.
        low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], 20) / 20)
        assert low < np.sqrt(np.mean(z**2)) < high, quantity
        assert stats.kstest(z, "norm").pvalue > 1e-3, quantity


def test_bootstrap_and_covariance_agree_where_errors_are_independent(pair):
    found, corners = solve(pair, pair.views(30, 0.1, seed=21))
    made = bootstrap(found, corners, SIZE, np.arange(30), replicates=100)
    for quantity in ("baseline_m", "left_fx_px", "depth_m", "rotation_z_deg"):
        # Bootstrap over 30 views: known to about 15 %.
        assert made["standard"][quantity] == pytest.approx(made["from_covariance"][quantity], rel=0.5)
    assert made["poses"] == 30


def test_repeated_poses_do_not_make_the_uncertainty_smaller(pair):
    once = pair.views(12, 0.0, seed=22)
    noisy = pair.views(12, 0.15, seed=22)
    found, corners = solve(pair, noisy)
    alone = bootstrap(found, corners, SIZE, np.arange(12), replicates=80)["standard"]["left_fx_px"]
    found, corners = solve(pair, noisy + noisy + noisy)
    again = bootstrap(found, corners, SIZE, np.tile(np.arange(12), 3), replicates=80)["standard"]
    assert again["left_fx_px"] == pytest.approx(alone, rel=0.25)
    # Taken for 36 views it would look as if it were known better.
    naive = bootstrap(found, corners, SIZE, np.arange(36), replicates=80)["standard"]
    assert naive["left_fx_px"] < 0.8 * alone
    assert len(once) == 12


def test_groups_are_poses():
    turns = np.stack([np.eye(3), np.eye(3), np.diag([-1.0, -1.0, 1.0]), np.eye(3)])
    middles = np.array([[0, 0, 0.7], [0.01, 0, 0.7], [0, 0, 0.7], [0.1, 0, 0.7]])
    assert groups_of_poses(turns, middles).tolist() == [0, 0, 2, 3]


def test_the_truth_judges_itself_without_error(pair):
    truth = Geometry.of(pair.truth)
    scene = look(truth, SIZE, 0.65)
    values, depth, elevation = judge(truth, scene, SIZE)
    assert values["baseline_m"] == pytest.approx(pair.truth.baseline_m)
    np.testing.assert_allclose(depth, 0.65, atol=1e-6)
    np.testing.assert_allclose(elevation, CREST_M, atol=1e-6)
    assert 0.5 < scene.seen.mean() < 1


def test_a_baseline_error_is_an_error_of_depth_and_elevation_in_proportion(pair):
    truth = Geometry.of(pair.truth)
    scene = look(truth, SIZE, 0.65)
    longer = Geometry(truth.left, truth.right, truth.rotation, truth.translation_m * 1.01)
    values, depth, elevation = judge(longer, scene, SIZE)
    assert values["depth_m"] == pytest.approx(0.65 * 1.01, rel=1e-6)
    np.testing.assert_allclose(depth, 0.6565, rtol=1e-6)
    np.testing.assert_allclose(elevation, 1.01 * CREST_M, rtol=1e-5)


def test_the_map_has_holes_where_only_one_camera_sees(pair):
    found, corners = solve(pair, pair.views(12, 0.1, seed=1))
    made = bootstrap(found, corners, SIZE, np.arange(12), replicates=10)
    cells = [value for row in made["depth_map_m"] for value in row]
    assert (len(made["depth_map_m"]), len(made["depth_map_m"][0])) == (12, 16)
    assert None in cells
    assert all(1e-5 < value < 1e-2 for value in cells if value is not None)


def test_a_distance_without_common_view_is_refused(pair):
    with pytest.raises(CalibrationError, match="next to nothing in common"):
        look(Geometry.of(pair.truth), SIZE, 0.06)


def test_covariance_knows_the_same_quantities(pair):
    found, corners = solve(pair, pair.views(12, 0.1, seed=1))
    scene = look(found.geometry, SIZE, 0.65)
    assert from_covariance(found, corners, scene, SIZE).keys() == judge(found.geometry, scene, SIZE)[0].keys()


def test_near_frontal_views_have_the_rms_of_diverse_ones_and_fail(pair):
    frontal = calibrate_stereo(pair.views(40, 0.1, seed=9, tilt_deg=8.0), pair.board, SIZE, replicates=60)
    diverse = calibrate_stereo(pair.views(40, 0.1, seed=8), pair.board, SIZE, replicates=60)
    assert frontal.rms_px == pytest.approx(diverse.rms_px, abs=0.004)
    assert frontal.standard_uncertainty("depth_m") > 3 * diverse.standard_uncertainty("depth_m")
    assert frontal.standard_uncertainty("left_fx_px") > 3 * diverse.standard_uncertainty("left_fx_px")
    rows = {row.measure: row.verdict for row in acceptance(frontal)}
    assert rows["stereo RMS"] == "pass"
    assert rows["tilt"] == rows["depth-bias σ at 0.65 m"] == verdict(acceptance(frontal)) == "fail"
    assert any("weakly determined" in sentence for sentence in findings(frontal))
    assert verdict(acceptance(diverse)) == "pass"
