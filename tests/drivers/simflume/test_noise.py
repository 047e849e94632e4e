from __future__ import annotations

import numpy as np
import pytest

from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import SensorSettings
from thermacq_drivers.simflume.three_d_noise import noise_components

LEVELS_K = {"t": 0.006, "v": 0.02, "h": 0.03, "tv": 0.004, "th": 0.008, "vh": 0.05, "tvh": 0.035}
FREEDOM = {
    "t": 79,
    "v": 511,
    "h": 639,
    "tv": 79 * 511,
    "th": 79 * 639,
    "vh": 511 * 639,
    "tvh": 79 * 511 * 639,
}
FRAMES = 80


def test_components_of_simulated_frames_are_those_of_the_settings() -> None:
    settings = SensorSettings(
        netd_k=LEVELS_K["tvh"],
        frame_noise_k=LEVELS_K["t"],
        row_noise_k=LEVELS_K["tv"],
        column_noise_k=LEVELS_K["th"],
        offset_k=LEVELS_K["vh"],
        row_offset_k=LEVELS_K["v"],
        column_offset_k=LEVELS_K["h"],
        gain=0.0,
        shading_k=0.0,
        blur_px=0.0,
        bad_pixel_fraction=0.0,
        counts_per_k=1000.0,
    )
    sensor = Sensor(settings, 512, 640, 1, "left")
    counts = np.empty((512, 640), np.uint16)

    def frames():
        for index in range(FRAMES):
            sensor.expose(np.full(counts.shape, 295.0, np.float32), index, counts, index * 0.02)
            yield counts / settings.counts_per_k

    found = noise_components(frames())
    for component, level_k in LEVELS_K.items():
        # Four standard errors of a standard deviation, and 0.5 % for what the rounding to counts adds.
        tolerance = 4 / np.sqrt(2 * FREEDOM[component]) + 0.005
        assert found.deviation(component) == pytest.approx(level_k, rel=tolerance), component


def test_estimator_is_unbiased_where_the_plain_one_is_not() -> None:
    random = np.random.default_rng(3)
    found = []
    for _ in range(200):
        cube = random.standard_normal((12, 8, 10)) + 0.3 * random.standard_normal((12, 1, 10))
        found.append(noise_components(cube + 5000))
    assert np.mean([each.tvh for each in found]) == pytest.approx(1.0, rel=0.01)
    assert np.mean([each.th for each in found]) == pytest.approx(0.09, rel=0.1)
    for component in ("t", "v", "h", "tv", "vh"):
        assert abs(np.mean([getattr(each, component) for each in found])) < 0.005, component
