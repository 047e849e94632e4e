"""Corrections from uniform views of a camera that is known in formulas."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from thermacq_calibration import (
    BadPixel,
    CalibrationError,
    CameraCorrection,
    Corrector,
    make_correction,
    uniformity,
    update_offset,
)


def two_point(camera, **changes) -> CameraCorrection:
    views = [camera.view(292.0), camera.view(298.0)]
    return make_correction(views, **{"serial": "SIM-1", "camera": "left", **changes})


def test_two_points_undo_gain_and_offset(camera):
    correction = two_point(camera)
    expected = 1 / camera.gain
    expected *= correction.gain.mean() / expected.mean()
    # Of gains, two means of 64 frames with noise of 3 counts over 480 counts leave 0.11 %.
    assert (correction.gain / expected - 1).std() == pytest.approx(3 * math.sqrt(2 / 64) / 480, rel=0.1)
    for kelvin in (292.0, 294.0, 295.0, 298.0):
        corrected = Corrector(correction)(np.float32(camera.mean(kelvin)))
        assert corrected.std() < 0.5
        assert correction.to_kelvin(corrected).mean() == pytest.approx(kelvin, abs=0.005)
    assert correction.counts_per_kelvin == pytest.approx(80 * camera.gain.mean(), rel=1e-3)
    assert correction.netd_k == pytest.approx(3 / 80, rel=0.03)
    assert correction.fpa_temperature_k == 305.0
    assert [view["temperature_k"] for view in correction.made_from["views"]] == [292.0, 298.0]


def test_a_held_out_view_is_flat_within_the_noise_floor(camera):
    found = uniformity(two_point(camera), camera.view(295.0))
    # In the middle of the span the two means leave sigma_t sqrt(0.5 / N).
    assert found.sigma_vh_counts == pytest.approx(3 * math.sqrt(0.5 / 64), rel=0.25)
    assert found.sigma_vh_per_netd == pytest.approx(math.sqrt(0.5 / 64), rel=0.25)
    assert found.level_error_k == pytest.approx(0, abs=0.002)
    assert found.kelvin(found.noise_counts) == pytest.approx(3 / 80, rel=0.05)


def test_temporal_noise_is_taken_out_of_the_spatial_deviation(camera):
    correction = two_point(camera)
    pattern = camera.random.normal(0, 4, camera.gain.shape)
    camera.offset += pattern
    few, many = (uniformity(correction, camera.view(295.0, count)) for count in (16, 256))
    assert few.sigma_vh_counts == pytest.approx(4, rel=0.05)
    assert many.sigma_vh_counts == pytest.approx(4, rel=0.05)


def test_rows_columns_and_pixels_are_told_apart(camera):
    correction = two_point(camera)
    camera.offset += 6 * np.sign(np.sin(2 * np.arange(64)))
    camera.offset += 3 * np.sign(np.sin(2 * np.arange(48)))[:, None]
    found = uniformity(correction, camera.view(295.0))
    assert found.sigma_h_counts == pytest.approx(6, rel=0.03)
    assert found.sigma_v_counts == pytest.approx(3, rel=0.03)
    assert found.sigma_vh_counts < 0.6
    assert found.spatial_counts == pytest.approx(math.hypot(6, 3), rel=0.05)


def test_one_point_leaves_gains_alone(camera):
    correction = make_correction([camera.view(295.0)], serial="", camera="left")
    assert (correction.gain == 1).all()
    assert Corrector(correction)(np.float32(camera.mean(295.0))).std() < 0.6
    # 2 K away a gain spread of 3 % is 4.8 counts.
    assert Corrector(correction)(np.float32(camera.mean(297.0))).std() == pytest.approx(4.8, rel=0.1)
    assert correction.counts_per_kelvin is None


def test_views_of_unknown_temperature_correct_without_a_scale(camera):
    views = [camera.view(292.0, known=False), camera.view(298.0, known=False)]
    correction = make_correction(views, serial="", camera="left")
    assert correction.counts_per_kelvin is None
    assert correction.netd_k is None
    assert Corrector(correction)(np.float32(camera.mean(295.0))).std() < 0.5


def test_bad_pixels_are_found_by_reason(camera):
    camera.gain[3, 4] = 0.2
    camera.noise[10, 11] = 9.0
    camera.offset[20, 30] = 20000
    check = camera.view(295.0)
    check.mean.setflags(write=True)
    check.mean[30, 5] += 60
    bad = two_point(camera, check=check).bad_pixels
    assert bad[3, 4] & BadPixel.DEAD
    assert bad[10, 11] == BadPixel.NOISY
    assert bad[20, 30] & BadPixel.DEAD
    assert bad[30, 5] == BadPixel.OUTLIER
    assert (bad > 0).sum() <= 6


def test_stuck_pixels_show_in_a_single_view(camera):
    camera.offset[20, 30] = 20000
    correction = make_correction([camera.view(295.0)], serial="", camera="left")
    assert correction.bad_pixels[20, 30] == BadPixel.DEAD
    assert (correction.bad_pixels > 0).sum() == 1


def test_an_update_follows_drift_of_the_offsets(camera):
    correction = two_point(camera)
    camera.offset += camera.random.normal(0, 20, camera.gain.shape) + 35
    stale = uniformity(correction, camera.view(294.0))
    assert stale.sigma_vh_counts > 15
    fresh = update_offset(correction, camera.view(297.0))
    found = uniformity(fresh, camera.view(294.0))
    assert found.sigma_vh_counts < 0.9
    assert found.level_error_k == pytest.approx(0, abs=0.01)
    np.testing.assert_array_equal(fresh.gain, correction.gain)
    assert fresh.offset_updated
    assert correction.offset_updated == ""
    assert fresh.sha256 != correction.sha256


def test_an_update_at_unknown_temperature_keeps_the_level(camera):
    correction = two_point(camera)
    mean = Corrector(correction)(np.float32(camera.mean(296.0))).mean()
    camera.offset += camera.random.normal(0, 20, camera.gain.shape)
    fresh = update_offset(correction, camera.view(296.0, known=False))
    again = Corrector(fresh)(np.float32(camera.mean(296.0)))
    assert again.std() < 0.6
    assert again.mean() == pytest.approx(mean, abs=1.5)


def test_a_shutter_behind_the_lens_gives_what_changed_since(camera, another_camera):
    # The shutter shows the pixels' offsets but not the lens, whose pattern the views have.
    shutter = another_camera(1)
    camera.shading = 100 * np.linspace(-1, 1, 64) ** 2
    correction = two_point(camera, shutter=shutter.view(300.0))
    drift = camera.random.normal(0, 20, camera.gain.shape)
    camera.offset += drift
    shutter.offset += drift
    fresh = update_offset(correction, shutter.view(300.0), behind_lens=True)
    assert uniformity(fresh, camera.view(294.0)).sigma_vh_counts < 1.0
    # Taken as a view before the lens it would bring the pattern of the lens back.
    wrong = update_offset(correction, shutter.view(300.0, known=False))
    assert uniformity(wrong, camera.view(294.0)).sigma_h_counts > 20
    with pytest.raises(CalibrationError, match="does not know its shutter"):
        update_offset(two_point(camera), shutter.view(300.0), behind_lens=True)


def test_shading_starts_anew_at_the_temperature_of_an_update(camera):
    shading = np.tile(np.linspace(-8, 8, 64), (48, 1))
    correction = replace(
        two_point(camera), shading=shading, shading_temperature_k=307.0, shading_zero_k=305.0
    )
    fresh = update_offset(correction, camera.view(296.0, inside_k=309.0))
    assert fresh.shading_factor(309.0) == pytest.approx(0)
    assert fresh.shading_factor(311.0) == pytest.approx(1)
    assert update_offset(correction, camera.view(296.0, inside_k=None)).shading is None


def test_too_close_temperatures_are_refused(camera):
    with pytest.raises(CalibrationError, match=r"run-295 at 295 K and .* less than 1 K apart"):
        make_correction([camera.view(295.0), camera.view(295.4)], serial="", camera="left")


def test_views_that_do_not_differ_in_counts_are_refused(camera):
    other = replace(camera.view(295.3), temperature_k=300.0)
    with pytest.raises(CalibrationError, match=r"differ by \d+ counts only.*\n.*really taken"):
        make_correction([camera.view(295.0), other], serial="", camera="left")


def test_swapped_temperatures_are_refused(camera):
    cold = replace(camera.view(292.0), temperature_k=298.0)
    hot = replace(camera.view(298.0), temperature_k=292.0)
    with pytest.raises(
        CalibrationError, match=r"at 292 K has \d+ counts more than .* at 298 K, which is warmer\n.*swapped"
    ):
        make_correction([cold, hot], serial="", camera="left")


def test_the_order_of_the_views_does_not_matter(camera):
    views = [camera.view(292.0), camera.view(298.0)]
    one, other = (make_correction(order, serial="", camera="left") for order in (views, views[::-1]))
    np.testing.assert_allclose(one.gain, other.gain, rtol=1e-5)


def test_other_sizes_and_numbers_of_views_are_refused(camera):
    view = camera.view(292.0)
    small = replace(view, mean=view.mean[:20], noise=view.noise[:20], jump=view.jump[:20])
    with pytest.raises(CalibrationError, match="different sizes"):
        make_correction([small, camera.view(298.0)], serial="", camera="left")
    with pytest.raises(CalibrationError, match="another size"):
        update_offset(two_point(camera), small)
    with pytest.raises(CalibrationError, match="one or two uniform views, not 3"):
        make_correction([view] * 3, serial="", camera="left")


def test_a_view_that_is_not_uniform_is_refused(camera):
    camera.gain[:10] = 0.1
    with pytest.raises(CalibrationError, match=r"of the pixels would be bad \(20.* dead"):
        two_point(camera)
