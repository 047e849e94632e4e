"""Differences of calibrations: only what a change of frame cannot undo counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thermacq_calibration import CalibrationError, StereoCalibration, calibrate_stereo
from thermacq_calibration.geometry.bundle import PARAMETERS, Geometry
from thermacq_calibration.geometry.differences import compare, projection_difference

SIZE = (640, 512)


def test_a_calibration_does_not_differ_from_itself(pair):
    truth = Geometry.of(pair.truth)
    found = projection_difference(truth, truth, SIZE)
    assert found.worst_px < 1e-6
    assert found.depth_m == pytest.approx(0, abs=1e-9)


def test_moved_rows_of_one_camera_remain_as_half_their_size_in_each(pair):
    """The right principal point 1 px lower: the rig is placed so that both cameras share the error."""
    truth = Geometry.of(pair.truth)
    step = np.zeros(PARAMETERS)
    step[15] = 1.0
    found = projection_difference(truth, truth.moved(step), SIZE)
    assert found.rms_px == pytest.approx(0.5, abs=0.05)


def test_a_longer_baseline_shows_as_depth(pair):
    truth = Geometry.of(pair.truth)
    longer = Geometry(truth.left, truth.right, truth.rotation, truth.translation_m * 1.01)
    found = projection_difference(truth, longer, SIZE)
    assert found.depth_m == pytest.approx(0.0065, rel=0.01)
    assert found.rms_px > 0.1


def test_maps_have_holes_where_only_the_left_camera_sees(pair):
    found = projection_difference(Geometry.of(pair.truth), Geometry.of(pair.truth), SIZE)
    assert np.isnan(found.left_px).any()
    assert np.isfinite(found.left_px).mean() > 0.5
    plain = found.to_dict()
    assert any(None in row for row in plain["left_px"])
    assert plain["rms_px"] == found.rms_px


def test_comparison_is_in_units_of_both_uncertainties(pair):
    truth = pair.truth
    first = replace(truth, uncertainty={"standard": {"baseline_m": 3e-5}})
    second = replace(
        truth, translation_m=truth.translation_m * 1.001, uncertainty={"standard": {"baseline_m": 4e-5}}
    )
    changes = {change.quantity: change for change in compare(first, second)}
    baseline = changes["baseline_m"]
    assert baseline.sigma == pytest.approx(5e-5)
    assert baseline.in_sigmas == pytest.approx(truth.baseline_m * 1e-3 / 5e-5)
    assert changes["left_fx_px"].in_sigmas is None
    assert changes["depth_m"].second / changes["depth_m"].first == pytest.approx(1.001)


def test_a_turned_camera_is_named_as_such(pair):
    truth = pair.truth
    turn = Rotation.from_rotvec([0, 0, 0.2], degrees=True).as_matrix()
    changes = {
        change.quantity: change for change in compare(truth, replace(truth, rotation=turn @ truth.rotation))
    }
    turned = changes["rotation_z_deg"].second - changes["rotation_z_deg"].first
    assert turned == pytest.approx(0.2, abs=0.01)


def test_pictures_of_other_sizes_are_not_compared(pair):
    given = StereoCalibration.from_rectified((64, 48), 100.0, None, 0.06)
    with pytest.raises(CalibrationError, match="640 x 512 and 64 x 48"):
        compare(pair.truth, given)


def test_half_sets_of_diverse_views_agree(pair):
    made = calibrate_stereo(pair.views(40, 0.1, seed=8), pair.board, SIZE, replicates=0)
    assert 0 < made.half_set["rms_px"] < 0.2
    assert made.half_set["worst_px"] > made.half_set["rms_px"]
