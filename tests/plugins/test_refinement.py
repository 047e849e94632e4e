"""Sub-pixel refinement against known disparities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from thermacq_plugins.refinement import refine

ROWS, COLUMNS = 160, 240


def textured_pair(disparity, noise=0.0, gain=1.0, level=0.0, seed=0):
    """Left and right picture of a texture of unit contrast; `disparity(u, v)` belongs to the left picture."""
    rng = np.random.default_rng(seed)
    field = ndimage.gaussian_filter(
        rng.standard_normal((2 * (ROWS + 160), 2 * (COLUMNS + 160))), 3, mode="wrap"
    )
    spline = ndimage.spline_filter(field / field.std(), order=3, mode="grid-wrap")

    def look(u, v):
        place = [2 * (v + 80), 2 * (u + 80)]
        return ndimage.map_coordinates(spline, place, order=3, prefilter=False, mode="grid-wrap")

    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    seen = u + disparity(u, v)
    for _ in range(8):
        seen = u + disparity(seen, v)
    left = look(u, v) + noise * rng.standard_normal(u.shape)
    right = gain * look(seen, v) + level + noise * rng.standard_normal(u.shape)
    return left.astype(np.float32), right.astype(np.float32), disparity(u, v)


def wavy(u, v):
    return 12.0 + 0.03 * v + 0.8 * np.sin(2 * np.pi * v / 150 + 0.01 * u)


def coarse(truth):
    """What a matcher leaves: half-pixel steps."""
    return (np.rint(truth * 2) / 2).astype(np.float32)


def test_noise_free_disparity_is_recovered_to_hundredths_of_a_pixel():
    left, right, truth = textured_pair(wavy)
    refined = refine(left, right, coarse(truth))
    error = (refined - truth)[:, 16:]
    assert np.isfinite(error).mean() > 0.99
    assert np.sqrt(np.nanmean(error**2)) < 0.03
    assert np.sqrt(np.nanmean(error[15:-15, 15:-15] ** 2)) < 0.01


def test_noise_of_35_mk_on_texture_of_300_mk_leaves_three_hundredths():
    left, right, truth = textured_pair(wavy, noise=0.035 / 0.3)
    error = (refine(left, right, coarse(truth)) - truth)[15:-15, 30:-15]
    assert np.sqrt(np.nanmean(error**2)) < 0.03
    assert abs(np.nanmean(error)) < 0.003


@pytest.mark.parametrize(
    ("length_px", "sigma_px", "loss"), [(150, 10.0, 0.005), (100, 10.0, 0.03), (60, 5.0, 0.02)]
)
def test_waves_keep_their_height(length_px, sigma_px, loss):
    """What the docs promise of the window: 150 px are 0.14 m on the water in the paper's geometry."""
    left, right, truth = textured_pair(lambda u, v: 12.0 + np.sin(2 * np.pi * v / length_px))
    wave = (truth - 12.0)[:, 30:-15]
    refined = refine(left, right, coarse(truth), sigma_px=sigma_px)[:, 30:-15] - 12.0
    known = np.isfinite(refined)
    height = (refined[known] @ wave[known]) / (wave[known] @ wave[known])
    assert known.mean() > 0.95
    assert abs(height - 1.0) < loss


def test_gain_and_level_of_the_right_camera_do_not_matter():
    left, right, truth = textured_pair(wavy, gain=1.3, level=5.0)
    error = (refine(left, right, coarse(truth)) - truth)[15:-15, 30:-15]
    assert np.sqrt(np.nanmean(error**2)) < 0.015


def test_a_level_difference_does_no_harm_beside_the_edges():
    """Coarse texture has different surroundings at the edge of one picture than in the middle of the other."""
    left, right, truth = textured_pair(lambda u, v: 40.0 + 0.0 * u, level=3.0)
    error = refine(left, right, coarse(truth)) - truth
    assert np.nanmax(np.abs(error[:, -10:])) < 0.05
    assert np.nanmax(np.abs(error[:, 41:50])) < 0.05


def test_nan_stays_nan_and_nothing_is_invented():
    left, right, truth = textured_pair(wavy)
    disparity = coarse(truth)
    disparity[40:60, 100:140] = np.nan
    refined = refine(left, right, disparity)
    assert np.isnan(refined[40:60, 100:140]).all()
    assert not np.isfinite(refined[np.isnan(disparity)]).any()


def test_unrelated_pictures_give_nothing():
    left, _, truth = textured_pair(wavy, seed=1)
    _, right, _ = textured_pair(wavy, seed=2)
    assert np.isfinite(refine(left, right, coarse(truth))).mean() < 0.02


def test_pictures_with_nan_outside_are_refined_up_to_the_border():
    left, right, truth = textured_pair(wavy)
    left[:, :20], right[:12] = np.nan, np.nan
    refined = refine(left, right, coarse(truth))
    error = (refined - truth)[20:, 40:]
    assert np.sqrt(np.nanmean(error**2)) < 0.03


@pytest.mark.parametrize("step", [6.0, -6.0])
def test_beside_a_step_of_depth_the_matcher_keeps_its_word(step):
    def cliff(u, v):
        return 12.0 + step * (v > 80)

    left, right, truth = textured_pair(cliff)
    refined = refine(left, right, coarse(truth))
    error = np.abs(refined - truth)[:, 25:]
    assert np.nanmax(error) < 1.0
    assert np.isfinite(error).mean() > 0.9
