from __future__ import annotations

import math

import numpy as np
import pytest

from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import SensorSettings, WarmUpSettings
from thermacq_drivers.simflume.warm_up import fpa_reading, fpa_temperature, housing_temperature

COLD = WarmUpSettings(powered_for_s=0.0)


def test_temperatures_approach_their_end_exponentially() -> None:
    assert fpa_temperature(COLD, 0.0) == housing_temperature(COLD, 0.0) == 295.0
    assert fpa_temperature(COLD, 480.0) == pytest.approx(295 + 10 * (1 - 1 / math.e))
    assert housing_temperature(COLD, 1800.0) == pytest.approx(295 + 6 * (1 - math.exp(-2)))
    assert fpa_temperature(COLD, -5.0) == 295.0
    assert fpa_temperature(WarmUpSettings(), 0.0) == pytest.approx(305.0, abs=1e-5)


def test_after_half_an_hour_the_focal_plane_is_ready_by_the_usual_limit() -> None:
    # 50 mK/min, the limit for a preheated camera, is passed in the paper's half hour and not much earlier.
    minute = [(fpa_temperature(COLD, t + 60.0) - fpa_temperature(COLD, t)) for t in (900.0, 1800.0)]
    assert minute[0] > 0.05 > minute[1]


def test_the_reading_is_noisy_and_reproducible() -> None:
    readings = [fpa_reading(COLD, 100.0, 1, "left", number) for number in range(400)]
    assert np.std(readings) == pytest.approx(0.005, rel=0.2)
    assert np.mean(readings) == pytest.approx(fpa_temperature(COLD, 100.0), abs=0.001)
    assert fpa_reading(COLD, 100.0, 1, "left", 7) == readings[7]


def test_a_cold_camera_drifts_by_its_coefficient() -> None:
    settings = SensorSettings(netd_k=0.0, shading_k=0.0, bad_pixel_fraction=0.0)
    sensor = Sensor(settings, 64, 80, 1, "left", warm_up=COLD)
    counts = np.empty((64, 80), np.uint16)
    levels_k = []
    for time_s in (0.0, 300.0):
        sensor.expose(np.full((64, 80), 295.0, np.float32), 0, counts, time_s)
        levels_k.append(counts.mean() / settings.counts_per_k)
    warmer_k = fpa_temperature(COLD, 300.0) - fpa_temperature(COLD, 0.0)
    assert levels_k[1] - levels_k[0] == pytest.approx(0.55 * warmer_k, abs=0.005)
