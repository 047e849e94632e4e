"""The matcher ``sgbm`` against known disparities, through the door that every matcher uses."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import ndimage

from thermacq.plugins import load_plugins
from thermacq.reconstruction import disparity_errors
from thermacq_plugins.sgbm import SgbmSettings, take_out_shading


def matcher(**settings):
    found = load_plugins().matcher("sgbm")
    return found.make(found.settings()(**settings))


def textured_pair(disparity, shading=0.0, noise=0.035, seed=0, rows=160, columns=320):
    """Thermal texture of 0.3 K rms in counts of 10 mK, as a 14-bit camera gives it."""
    rng = np.random.default_rng(seed)
    field = ndimage.gaussian_filter(rng.standard_normal((2 * rows + 200, 2 * columns + 400)), 3, mode="wrap")
    spline = ndimage.spline_filter(0.3 * field / field.std(), order=3, mode="grid-wrap")

    def look(u, v):
        place = [2 * v + 100, 2 * u + 200]
        return ndimage.map_coordinates(spline, place, order=3, prefilter=False, mode="grid-wrap")

    v, u = np.mgrid[:rows, :columns].astype(float)
    seen = u + disparity(u, v)
    for _ in range(8):
        seen = u + disparity(seen, v)
    left = look(u, v) + shading * (u / columns) ** 2 + noise * rng.standard_normal(u.shape)
    right = look(seen, v) - shading * v / rows + noise * rng.standard_normal(u.shape)
    return (
        np.rint(6000 + 100 * left).astype(np.float32),
        np.rint(6000 + 100 * right).astype(np.float32),
        disparity(u, v),
    )


def wavy(u, v):
    return 30.0 + 0.03 * v + 1.5 * np.sin(2 * np.pi * v / 200 + 0.01 * u)


def common(truth):
    """Pixels whose match lies inside the right picture."""
    matched = np.arange(truth.shape[1]) - truth
    return (matched >= 2) & (matched <= truth.shape[1] - 3)


def test_it_comes_in_through_the_entry_point():
    assert "sgbm" in load_plugins().matchers()


def test_thermal_water_is_matched_to_hundredths_of_a_pixel():
    left, right, truth = textured_pair(wavy)
    disparity = matcher(min_disparity=10, max_disparity=60).match(left, right)
    error = np.where(common(truth), disparity - truth, np.nan)
    assert disparity.dtype == np.float32
    assert np.isfinite(error[common(truth)]).mean() > 0.97
    assert 1.4826 * np.nanmedian(np.abs(error)) < 0.03
    assert np.nanmean(np.abs(error) > 0.5) < 0.01


def test_refinement_beats_the_sixteenths_of_opencv_fivefold():
    left, right, truth = textured_pair(wavy)
    spread = {}
    for refine in (False, True):
        disparity = matcher(min_disparity=10, max_disparity=60, refine=refine).match(left, right)
        spread[refine] = np.nanmedian(np.abs(np.where(common(truth), disparity - truth, np.nan)))
    assert spread[True] < spread[False] / 5


def test_columns_near_the_left_edge_are_matched_as_far_as_their_match_is_in_the_picture():
    left, right, _ = textured_pair(lambda u, v: 30.0 + 0.0 * u)
    disparity = matcher(min_disparity=10, max_disparity=100).match(left, right)
    assert np.isfinite(disparity[:, 40:100]).mean() > 0.95
    assert np.isfinite(disparity[:, :25]).mean() < 0.05


@pytest.mark.parametrize("middle", [-40.0, 0.0])
def test_negative_disparities_are_legal(middle):
    left, right, truth = textured_pair(lambda u, v: middle + 2.0 * np.sin(v / 30))
    disparity = matcher(min_disparity=int(middle) - 10, max_disparity=int(middle) + 10).match(left, right)
    errors = disparity_errors(disparity, np.where(common(truth), truth, np.nan))
    assert errors.density > 0.95
    assert errors.epe_px < 0.05
    assert errors.bad1 < 0.01


def test_strong_shading_of_the_two_cameras_does_not_matter():
    left, right, truth = textured_pair(wavy, shading=4.0)
    disparity = matcher(min_disparity=10, max_disparity=60).match(left, right)
    error = np.where(common(truth), disparity - truth, np.nan)
    assert np.isfinite(error[common(truth)]).mean() > 0.95
    assert 1.4826 * np.nanmedian(np.abs(error)) < 0.03


def test_noise_without_texture_gives_nothing():
    rng = np.random.default_rng(0)
    left, right = (6000 + 3.5 * rng.standard_normal((2, 160, 320))).astype(np.float32)
    assert np.isfinite(matcher(min_disparity=0, max_disparity=60).match(left, right)).mean() < 0.02


@pytest.mark.parametrize("value", [np.nan, 6000.0])
def test_empty_pictures_give_nothing(value):
    picture = np.full((64, 128), value, np.float32)
    assert not np.isfinite(matcher(max_disparity=30).match(picture, picture)).any()


def test_pixels_outside_the_rectified_pictures_stay_nan():
    left, right, _ = textured_pair(wavy)
    left[:30], right[:, 200:] = np.nan, np.nan
    disparity = matcher(min_disparity=10, max_disparity=60).match(left, right)
    matched = np.arange(320) - disparity
    assert np.isnan(disparity[:30]).all()
    assert not (matched >= 200.5).any()
    assert np.isfinite(disparity[40:, 60:190]).mean() > 0.9


@pytest.mark.parametrize(
    "wrong",
    [
        {"block_size": 4},
        {"min_disparity": 10, "max_disparity": 10},
        {"mode": "5way"},
        {"blocksize": 5},
        {"refine_sigma_px": 0},
    ],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValidationError):
        SgbmSettings(**wrong)


def test_shading_of_low_order_is_taken_out_and_texture_is_not():
    rng = np.random.default_rng(0)
    texture = rng.standard_normal((120, 200)).astype(np.float32)
    y, x = np.mgrid[-1:1:120j, -1:1:200j]
    shaded = (texture + 50 + 10 * x - 5 * y * y + 3 * x * y * y).astype(np.float32)
    shaded[:10] = np.nan
    flat = take_out_shading(shaded, 3)
    assert np.isnan(flat[:10]).all()
    assert np.nanstd(flat - texture) < 0.3


def test_motorcycle_is_matched_better_than_the_reference(shared_data):
    import cv2

    folder = shared_data / "middlebury_motorcycle"
    pictures = [
        cv2.imread(str(folder / f"motorcycle_{side}.png"), cv2.IMREAD_GRAYSCALE).astype(np.float32)
        for side in ("left", "right")
    ]
    with np.load(folder / "motorcycle_disp.npz") as arrays:
        truth = arrays["arr_0"]
    settings = {"block_size": 3, "presmooth_px": 0, "shading_degree": 0, "refine": False, "mode": "hh"}
    errors = disparity_errors(matcher(min_disparity=0, max_disparity=79, **settings).match(*pictures), truth)
    assert errors.density > 0.846
    assert errors.bad2 < 0.059
    assert errors.epe_px < 0.99
