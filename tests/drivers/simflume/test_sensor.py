from __future__ import annotations

import numpy as np
import pytest

from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import SensorSettings

QUIET = {
    "netd_k": 0.0,
    "offset_k": 0.0,
    "gain": 0.0,
    "shading_k": 0.0,
    "bad_pixel_fraction": 0.0,
    "blur_px": 0.0,
}
SHAPE = (128, 160)
MIDDLE_COUNT = 6000


def expose(
    settings: dict[str, object], temperature_k: float = 295.0, index: int = 0, seed: int = 1
) -> np.ndarray:
    sensor = Sensor(SensorSettings.model_validate(settings), *SHAPE, seed, "left")
    counts = np.empty(SHAPE, np.uint16)
    sensor.expose(np.full(SHAPE, temperature_k, np.float32), index, counts)
    return counts


def test_counts_follow_temperature() -> None:
    assert (expose(QUIET) == MIDDLE_COUNT).all()
    assert (expose(QUIET, 296.5) == MIDDLE_COUNT + 150).all()


def test_counts_stay_within_14_bits() -> None:
    assert expose(QUIET, 1000.0).max() == 2**14 - 1
    assert expose(QUIET, 100.0).min() == 0


def test_noise_has_the_stated_netd_and_differs_between_frames() -> None:
    first, second = (expose({**QUIET, "netd_k": 0.035}, index=index).astype(float) for index in (0, 1))
    difference_k = (first - second).std() / np.sqrt(2) / 100
    assert difference_k == pytest.approx(np.hypot(0.035, 0.01 / np.sqrt(12)), rel=0.03)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.03


def test_quantisation_is_below_a_third_of_the_netd() -> None:
    settings = SensorSettings()
    assert 1 / settings.counts_per_k < settings.netd_k / 3


def test_fixed_pattern_of_offsets_and_gains() -> None:
    offsets = expose({**QUIET, "offset_k": 0.5}).astype(float)
    assert offsets.std() / 100 == pytest.approx(0.5, rel=0.03)
    gains = {**QUIET, "gain": 0.01}
    assert expose(gains, 295.0).std() == 0
    assert expose(gains, 315.0).astype(float).std() == pytest.approx(0.01 * 20 * 100, rel=0.05)


def test_shading_is_smooth_and_of_the_stated_size() -> None:
    shading = expose({**QUIET, "shading_k": 2.0}).astype(float)
    assert np.ptp(shading) == pytest.approx(200, abs=2)
    assert np.abs(np.diff(shading, axis=1)).max() <= 10


def test_bad_pixels_show_unless_the_camera_replaces_them() -> None:
    raw = expose({**QUIET, "bad_pixel_fraction": 0.02, "bad_pixels": "raw"}, 305.0)
    # Only blinking pixels can look good for a moment.
    assert (raw != MIDDLE_COUNT + 1000).mean() == pytest.approx(0.02 * 0.7, rel=0.3)
    replaced = expose({**QUIET, "bad_pixel_fraction": 0.02}, 305.0)
    assert (replaced == MIDDLE_COUNT + 1000).all()


def test_blur_spreads_a_point() -> None:
    sensor = Sensor(SensorSettings.model_validate({**QUIET, "blur_px": 1.0}), *SHAPE, 1, "left")
    scene = np.full(SHAPE, 295.0, np.float32)
    scene[64, 80] += 50
    counts = np.empty(SHAPE, np.uint16)
    sensor.expose(scene, 0, counts)
    rise = counts.astype(float) - MIDDLE_COUNT
    assert rise.sum() == pytest.approx(5000, rel=0.02)
    assert rise[64, 80] == pytest.approx(5000 / (2 * np.pi), rel=0.1)


def test_equal_seed_name_and_index_give_equal_counts() -> None:
    np.testing.assert_array_equal(expose({}, index=7), expose({}, index=7))
    assert (expose({}, index=7) != expose({}, index=8)).mean() > 0.5
    assert (expose({}, seed=1) != expose({}, seed=2)).mean() > 0.5
