from __future__ import annotations

import numpy as np

from thermacq.reconstruction.outliers import reject_outliers


def slope(noise=0.05, seed=0):
    v, u = np.mgrid[:200, :300]
    rng = np.random.default_rng(seed)
    return (60 + 0.04 * v + 0.02 * u + noise * rng.standard_normal(v.shape)).astype(np.float32)


def test_a_clean_slope_loses_nothing():
    disparity = slope()
    np.testing.assert_array_equal(reject_outliers(disparity), disparity)


def test_scattered_outliers_go_and_the_rest_stays():
    disparity = slope()
    rng = np.random.default_rng(1)
    wrong = rng.random(disparity.shape) < 0.2
    disparity[wrong] += rng.choice([-1, 1], wrong.sum()) * rng.uniform(3, 30, wrong.sum())
    kept = np.isfinite(reject_outliers(disparity))
    assert not kept[wrong].any()
    assert kept[~wrong].mean() > 0.98


def test_an_island_beyond_the_edge_of_the_view_goes():
    disparity = slope()
    disparity[:, :60] = np.nan
    disparity[90:100, 5:25] = 20.0
    assert np.isnan(reject_outliers(disparity)[:, :60]).all()


def test_nothing_is_invented_and_nothing_known_is_changed():
    disparity = slope()
    disparity[50:90, 100:180] = np.nan
    kept = reject_outliers(disparity)
    known = np.isfinite(kept)
    assert not known[50:90, 100:180].any()
    np.testing.assert_array_equal(kept[known], disparity[known])


def test_an_empty_map_stays_empty():
    assert np.isnan(reject_outliers(np.full((40, 50), np.nan, np.float32))).all()
