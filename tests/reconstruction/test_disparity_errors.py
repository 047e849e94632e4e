from __future__ import annotations

import numpy as np
import pytest

from thermacq.errors import ReconstructionError, StoreError
from thermacq.reconstruction import depth_errors, disparity_errors, load_disparity, save_disparity
from thermacq_calibration import StereoCalibration, rectify


def test_figures_of_a_small_map_by_hand():
    truth = np.array([[10.0, 10.0, 10.0, 10.0, np.inf]])
    matched = np.array([[10.5, 8.5, np.nan, 13.0, 4.0]], np.float32)
    errors = disparity_errors(matched, truth)
    assert errors.density == 0.75
    assert errors.bad1 == pytest.approx(2 / 3)
    assert errors.bad2 == pytest.approx(1 / 3)
    assert errors.bad2_all == 0.5
    assert errors.epe_px == pytest.approx((0.5 + 1.5 + 3.0) / 3)
    assert errors.bias_px == pytest.approx((0.5 - 1.5 + 3.0) / 3)


def test_depths_follow_from_parallax():
    rectification = rectify(StereoCalibration.from_rectified((3, 1), 1000.0, None, 0.2, doffs_px=5.0))
    errors = depth_errors(
        np.array([[95.0, 94.0, 45.0]], np.float32), np.array([[95.0, 95.0, 95.0]]), rectification
    )
    assert errors.median_relative == pytest.approx(1 / 99)
    assert errors.median_m == pytest.approx(2.0 / 99)
    assert errors.within_1_percent == pytest.approx(1 / 3)


def test_nothing_to_compare_is_refused():
    with pytest.raises(ReconstructionError, match="no pixel was matched"):
        disparity_errors(np.full((2, 2), np.nan, np.float32), np.ones((2, 2)))
    with pytest.raises(ReconstructionError, match="shape"):
        disparity_errors(np.ones((2, 2), np.float32), np.ones((2, 3)))


def test_disparity_files_come_back_and_foreign_ones_are_refused(tmp_path):
    disparity = np.array([[1.5, np.nan]], np.float32)
    save_disparity(tmp_path / "d.npz", disparity)
    np.testing.assert_array_equal(load_disparity(tmp_path / "d.npz"), disparity)
    np.save(tmp_path / "d.npy", disparity)
    np.testing.assert_array_equal(load_disparity(tmp_path / "d.npy"), disparity)
    np.savez(tmp_path / "two.npz", a=disparity, b=disparity)
    (tmp_path / "text.npz").write_text("no array")
    np.save(tmp_path / "line.npy", np.ones(3))
    for name in ("two.npz", "text.npz", "line.npy"):
        with pytest.raises(StoreError, match="holds no disparity map"):
            load_disparity(tmp_path / name)
    with pytest.raises(StoreError, match="there is no file"):
        load_disparity(tmp_path / "none.npz")
