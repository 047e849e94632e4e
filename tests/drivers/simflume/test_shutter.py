from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import SensorSettings, ShutterSettings, WarmUpSettings
from thermacq_drivers.simflume.shutter import Shutter
from thermacq_drivers.simflume.warm_up import housing_temperature


def test_without_events_it_is_always_open() -> None:
    shutter = Shutter(ShutterSettings(), 1, "left")
    assert shutter.closed_since(5.0) is None
    assert shutter.corrected_at(5.0) is None
    assert shutter.frames_frozen(5.0, 50.0) == 0
    assert not ShutterSettings().is_used


def test_events_on_command() -> None:
    shutter = Shutter(ShutterSettings(at_s=(1.0, 3.0), closed_s=0.5), 1, "left")
    assert shutter.closed_since(0.99) is None
    assert shutter.closed_since(1.0) == shutter.closed_since(1.49) == 1.0
    assert shutter.closed_since(1.5) is None
    assert [shutter.corrected_at(time_s) for time_s in (1.4, 1.5, 3.4, 3.6)] == [None, 1.5, 1.5, 3.5]


def test_automatic_events_come_once_a_period_and_not_at_once_on_both_sides() -> None:
    starts = []
    for name in ("left", "right"):
        shutter = Shutter(ShutterSettings(period_s=10.0, closed_s=0.5), 1, name)
        closed = [shutter.closed_since(time_s) for time_s in np.arange(0.0, 50.0, 0.01)]
        found = sorted({start_s for start_s in closed if start_s is not None})
        np.testing.assert_allclose(np.diff(found), 10.0)
        assert sum(start_s is not None for start_s in closed) == pytest.approx(250, abs=60)
        starts.append(found[0])
    assert abs(starts[0] - starts[1]) > 0.1


def test_the_frozen_picture_is_the_last_one_before_the_event() -> None:
    # Two events in a row: the second begins while the picture of the first is still frozen.
    shutter = Shutter(ShutterSettings(at_s=(1.01, 1.4), closed_s=0.5), 1, "left")
    for frame in range(51, 95):
        assert frame - shutter.frames_frozen(frame / 50, 50.0) == 50
    assert shutter.frames_frozen(50 / 50, 50.0) == 0
    assert shutter.frames_frozen(96 / 50, 50.0) == 0


def test_a_period_shorter_than_the_event_is_refused() -> None:
    with pytest.raises(ValidationError, match="hardly opens"):
        ShutterSettings(period_s=0.6, closed_s=0.5)


def test_an_event_takes_away_offsets_drift_and_flicker() -> None:
    settings = SensorSettings(
        offset_k=2.0, shading_k=2.0, drift_spread_k_per_k=0.05, flicker_k=0.002, bad_pixel_fraction=0.0
    )
    warm_up = WarmUpSettings(powered_for_s=0.0)
    shutter = ShutterSettings(at_s=(600.0,), frames_averaged=16)
    sensor = Sensor(settings, 128, 160, 1, "left", warm_up=warm_up, shutter=shutter)
    counts = np.empty((128, 160), np.uint16)

    def seen_k(time_s: float) -> np.ndarray:
        scene_k = housing_temperature(warm_up, time_s)
        sensor.expose(np.full((128, 160), scene_k, np.float32), int(time_s * 50), counts, time_s)
        return (counts.astype(float) - settings.middle_count) / settings.counts_per_k + 295.0 - scene_k

    assert seen_k(599.0).std() > 1.5
    after = seen_k(600.6)
    # What stays: noise of this frame, of the mean of 16 shutter frames, and rounding.
    left_k = np.sqrt(0.035**2 * (1 + 1 / 16) + 0.01**2 / 12)
    assert after.std() == pytest.approx(left_k, rel=0.05)
    assert abs(after.mean()) < 0.01
    # It then drifts away again, each pixel in its own way.
    assert seen_k(900.0).std() > 1.5 * left_k
    assert abs(seen_k(900.0).mean()) > 0.5
