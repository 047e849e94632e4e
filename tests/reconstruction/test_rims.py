"""Only what both cameras see well inside their pictures is kept."""

import numpy as np

from thermacq.reconstruction.rims import Interior
from thermacq_calibration import StereoCalibration, rectify

RECTIFICATION = rectify(StereoCalibration.from_rectified((64, 48), 50.0, (32.0, 24.0), 0.06, 0.0))


def test_both_pictures_lose_their_rim():
    kept = Interior.of(RECTIFICATION, 5).keep(np.full((48, 64), 10.0, np.float32))
    expected = np.zeros((48, 64), bool)
    # Right of column 10 + 5 the match is 5 px inside the right picture.
    expected[5:-5, 15:-5] = True
    assert np.array_equal(np.isfinite(kept), expected)
    assert np.all(kept[expected] == 10)


def test_nothing_is_lost_without_a_rim_and_nothing_invented():
    disparity = np.full((48, 64), 3.25, np.float32)
    disparity[10:12] = np.nan
    kept = Interior.of(RECTIFICATION, 0).keep(disparity)
    assert np.array_equal(np.isfinite(kept[:, 3:]), np.isfinite(disparity[:, 3:]))
    assert np.isnan(kept[:, :3]).all()
