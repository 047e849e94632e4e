from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq.errors import ReconstructionError
from thermacq.reconstruction import grid_over, grid_points


def grid():
    return grid_over(np.array([-0.02, 0.03]), np.array([0.0, 0.04]), 0.01)


def test_cell_centres_are_multiples_of_the_spacing_and_cover_the_view():
    made = grid_over(np.array([-0.013, 0.304, 0.9]), np.array([0.096, 0.096, np.nan]), 0.005)
    assert made.x_m[0] == -0.015
    assert made.x_m[-1] == 0.305
    np.testing.assert_allclose(np.diff(made.x_m), 0.005, atol=1e-12)
    np.testing.assert_array_equal(made.y_m, [0.095])


def test_no_view_and_an_endless_view_are_refused():
    with pytest.raises(ReconstructionError, match="no common view"):
        grid_over(np.array([np.nan]), np.array([np.nan]), 0.01)
    with pytest.raises(ReconstructionError, match="cells"):
        grid_over(np.array([0.0, 100.0]), np.array([0.0, 100.0]), 0.001)


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 10**6), count=st.integers(0, 400), least=st.integers(1, 6))
def test_mean_count_and_deviation_agree_with_a_loop(seed, count, least):
    rng = np.random.default_rng(seed)
    points = rng.uniform((-0.04, -0.02, -0.1), (0.05, 0.06, 0.1), (count, 3))
    points[rng.random(count) < 0.1] = np.nan
    made = grid()
    surface = grid_points(points.reshape(1, count, 3), made, least)
    for row, y in enumerate(made.y_m):
        for column, x in enumerate(made.x_m):
            near = (np.rint((points[:, 0] - made.x_m[0]) / 0.01) == column) & (
                np.rint((points[:, 1] - made.y_m[0]) / 0.01) == row
            )
            heights = points[near, 2]
            assert surface.points[row, column] == heights.size, (x, y)
            if heights.size < least:
                assert np.isnan(surface.eta_m[row, column])
                assert np.isnan(surface.sd_m[row, column])
                continue
            assert surface.eta_m[row, column] == pytest.approx(heights.mean(), abs=1e-7)
            if heights.size > 1:
                assert surface.sd_m[row, column] == pytest.approx(heights.std(ddof=1), abs=1e-7)
            else:
                assert np.isnan(surface.sd_m[row, column])


def test_no_cell_is_invented():
    """One cell is full, all its neighbours are empty and stay so."""
    points = np.tile([0.01, 0.02, 0.005], (50, 1))
    surface = grid_points(points, grid(), 3)
    assert np.isfinite(surface.eta_m).sum() == 1
    assert surface.eta_m[2, 3] == np.float32(0.005)
    assert surface.points.sum() == 50
    assert surface.sd_m[2, 3] < 1e-12
