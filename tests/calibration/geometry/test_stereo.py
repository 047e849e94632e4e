"""Calibration on corners of known geometry: truth recovered, bad views removed, weak sets named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thermacq_calibration import (
    Board,
    CalibrationError,
    NoBoard,
    StereoCalibration,
    calibrate_stereo,
    findings,
)
from thermacq_calibration.geometry.stereo import coverage


def moved(view, by_px, side="right"):
    """The view with all corners of one side moved, as when the board moved between the exposures."""
    found = getattr(view, side)
    return replace(view, **{side: replace(found, corners=found.corners + by_px)})


@pytest.fixture(scope="module")
def calibrated(pair) -> StereoCalibration:
    """25 views with 0.1 px of corner noise per axis."""
    return calibrate_stereo(
        pair.views(25, noise_px=0.1, seed=1), pair.board, (640, 512), "synthetic", replicates=30
    )


def test_without_noise_the_truth_comes_back(pair):
    made = calibrate_stereo(pair.views(12, seed=2), pair.board, (640, 512), replicates=0)
    # Corners pass through float32 (1e-5 px), which bounds everything.
    assert made.rms_px < 1e-3
    assert made.baseline_m == pytest.approx(pair.truth.baseline_m, rel=1e-4)
    np.testing.assert_allclose(made.left.matrix, pair.truth.left.matrix, atol=0.1)
    np.testing.assert_allclose(made.left.distortion[:2], pair.truth.left.distortion[:2], atol=2e-3)
    turn = Rotation.from_matrix(made.rotation @ pair.truth.rotation.T).magnitude()
    assert np.degrees(turn) < 1e-3


def test_with_noise_the_error_stays_within_what_the_noise_allows(pair, calibrated):
    # 0.1 px per axis is 0.141 px of distance, less the fitted degrees of freedom.
    assert calibrated.rms_px == pytest.approx(0.139, abs=0.006)
    assert calibrated.left.rms_px == pytest.approx(0.137, abs=0.008)
    # Five standard deviations of the reference's Monte Carlo at this number of poses.
    assert calibrated.baseline_m == pytest.approx(pair.truth.baseline_m, abs=2e-4)
    assert calibrated.left.matrix[0, 0] == pytest.approx(pair.truth.left.matrix[0, 0], abs=2.5)
    assert calibrated.vertical_rms_px == pytest.approx(0.1 * np.sqrt(2), abs=0.015)
    assert calibrated.held_out_vertical_rms_px >= calibrated.vertical_rms_px
    assert calibrated.held_out_vertical_rms_px < 0.16
    # The reference's Monte Carlo: 0.02 to 0.07 mm between 40 and 10 poses.
    assert 1.5e-5 < calibrated.standard_uncertainty("baseline_m") < 8e-5


def test_views_carry_their_pose(pair, calibrated):
    for view, (rotation, shift) in zip(calibrated.views, pair.poses(25, seed=1), strict=True):
        middle = rotation @ pair.corner_points().mean(axis=0) + shift
        assert view.used
        assert view.distance_m == pytest.approx(np.linalg.norm(middle), abs=0.004)
        assert view.tilt_deg == pytest.approx(np.degrees(np.arccos(rotation[2, 2])), abs=1.5)
        assert view.sharpness_px == 2.5
        assert view.contrast == 500.0


def test_the_distortion_model_is_chosen_and_said(calibrated):
    # The lenses have k1, k2, p1, p2 and no k3.
    assert calibrated.distortion["model"] in {"k1 k2", "k1 k2 p1 p2"}
    assert len(calibrated.distortion["scores"]) == 6
    assert calibrated.left.distortion.shape == (5,)
    assert calibrated.left.distortion[4] == 0
    assert calibrated.left.distortion[0] != 0


def test_views_that_fit_badly_are_left_out_with_the_reason(pair):
    views = pair.views(20, noise_px=0.1, seed=3)
    views[4] = moved(views[4], (0.0, 1.5))
    views[11] = replace(views[11], right=views[12].right)
    made = calibrate_stereo(views, pair.board, (640, 512), replicates=0)
    reasons = {view.name: view.reason for view in made.views if not view.used}
    assert reasons.keys() == {"04", "11"}
    assert "rows differ" in reasons["04"]
    assert "outlier" in reasons["11"]
    assert made.baseline_m == pytest.approx(pair.truth.baseline_m, abs=2e-4)
    assert any("outliers" in sentence for sentence in findings(made))


@pytest.mark.parametrize("seed", range(3))
def test_good_views_are_not_left_out(pair, seed):
    made = calibrate_stereo(
        pair.views(15, noise_px=0.15, seed=10 + seed), pair.board, (640, 512), replicates=0
    )
    assert all(view.used for view in made.views)


def test_views_without_board_stand_in_the_record(pair):
    views = pair.views(8, noise_px=0.1, seed=5)
    views[2] = replace(views[2], left=NoBoard("too blurred"), right=NoBoard("constant"))
    made = calibrate_stereo(views, pair.board, (640, 512), replicates=0)
    assert made.views[2].reason == "left: too blurred; right: constant"
    assert not made.views[2].used
    assert sum(view.used for view in made.views) == 7


def test_too_few_views_are_refused(pair):
    views = pair.views(6, seed=6)
    views[0] = replace(views[0], left=NoBoard("x"))
    views[1] = replace(views[1], right=NoBoard("x"))
    with pytest.raises(CalibrationError, match="only 4 of 6 views"):
        calibrate_stereo(views, pair.board, (640, 512), replicates=0)


def test_an_ambiguous_board_is_refused(pair):
    with pytest.raises(CalibrationError, match="half a turn"):
        calibrate_stereo(pair.views(6, seed=6), Board(9, 7, 0.05), (640, 512))


def test_the_same_view_again_and_again_is_no_set_of_views(pair):
    view = pair.views(1, seed=7, tilt_deg=20.0)[0]
    views = [replace(view, name=str(index)) for index in range(8)]
    with pytest.raises(CalibrationError, match="8 usable views show only 1 different"):
        calibrate_stereo(views, pair.board, (640, 512), replicates=0)


def test_repeated_poses_do_not_count_as_views(pair):
    once = pair.views(13, 0.1, seed=12)
    again = [replace(view, name=view.name + " again") for view in once]
    made = calibrate_stereo(once + again, pair.board, (640, 512), replicates=0)
    assert made.poses == 13
    assert any("26 views show only 13 different poses" in sentence for sentence in findings(made))


def test_a_good_set_raises_no_findings(pair):
    assert findings(calibrate_stereo(pair.views(40, 0.1, seed=8), pair.board, (640, 512))) == []


def test_near_frontal_views_are_named_weak(pair):
    made = calibrate_stereo(
        pair.views(30, noise_px=0.1, seed=9, tilt_deg=5.0), pair.board, (640, 512), replicates=0
    )
    assert made.rms_px < 0.15
    assert any("tilted" in sentence for sentence in findings(made))


def test_exchanged_sides_are_refused(pair):
    views = [replace(view, left=view.right, right=view.left) for view in pair.views(8, 0.1, seed=1)]
    with pytest.raises(
        CalibrationError, match=r"exchanged: the right camera stands 6(\.\d+)? cm to the left"
    ):
        calibrate_stereo(views, pair.board, (640, 512), replicates=0)


def test_squares_in_millimetres_are_refused(pair):
    with pytest.raises(CalibrationError, match="wanted in metres") as caught:
        calibrate_stereo(pair.views(8, 0.1, seed=1), Board(9, 6, 50.0), (640, 512))
    assert "give 0.05" in caught.value.remedy


def test_views_of_another_board_are_refused_by_name(pair):
    views = pair.views(15, noise_px=0.1, seed=3)
    other = replace(pair, board=Board(9, 6, 0.04)).views(3, noise_px=0.1, seed=4)
    mixed = views + [replace(view, name=f"other {view.name}") for view in other]
    with pytest.raises(CalibrationError, match="another board") as caught:
        calibrate_stereo(mixed, pair.board, (640, 512))
    assert caught.value.what.count("other 0") == 3
    assert "0.8" in caught.value.what


def test_two_boards_half_and_half_fit_nothing(pair):
    views = pair.views(6, noise_px=0.1, seed=3)
    other = replace(pair, board=Board(9, 6, 0.03)).views(6, noise_px=0.1, seed=4)
    mixed = views + [replace(view, name=f"other {view.name}") for view in other]
    with pytest.raises(CalibrationError, match=r"another board|do not fit together"):
        calibrate_stereo(mixed, pair.board, (640, 512))


def test_coverage_counts_cells():
    middle_of_first = np.array([[40.0, 42.0]])
    assert coverage([middle_of_first], (640, 512)) == pytest.approx(1 / 48)
    u, v = np.meshgrid(np.arange(40, 640, 80), np.arange(42, 512, 85))
    assert coverage([np.column_stack([u.ravel(), v.ravel()])], (640, 512)) == 1.0
