from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from thermacq_drivers.simflume.bad_pixels import KINDS, BadPixel
from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import BadPixelShares, SensorSettings

SHAPE = (128, 160)
SETTINGS = SensorSettings(bad_pixel_fraction=0.02, bad_pixels="raw", offset_k=0.0, shading_k=0.0, blur_px=0.0)


def frames(sensor: Sensor, temperature_k: float, count: int, step_s: float = 0.02) -> np.ndarray:
    """(count, pixels) kelvin above 295 K."""
    counts, taken = np.empty(SHAPE, np.uint16), []
    for index in range(count):
        sensor.expose(np.full(SHAPE, temperature_k, np.float32), index, counts, index * step_s)
        taken.append((counts.ravel().astype(float) - SETTINGS.middle_count) / SETTINGS.counts_per_k)
    return np.array(taken)


@pytest.fixture(scope="module")
def sensor() -> Sensor:
    return Sensor(SETTINGS, *SHAPE, 1, "left")


def test_the_map_tells_kind_and_place(sensor: Sensor) -> None:
    picture = sensor.bad.map(*SHAPE)
    assert picture.dtype == np.uint8
    assert (picture > 0).mean() == pytest.approx(0.02, rel=0.15)
    for kind, share in zip(KINDS, SETTINGS.bad_pixel_shares.in_order, strict=True):
        assert (picture == kind).sum() / (picture > 0).sum() == pytest.approx(share, abs=0.07)
        np.testing.assert_array_equal(np.flatnonzero(picture == kind), sensor.bad.of(kind))


def test_each_kind_behaves_by_its_definition(sensor: Sensor) -> None:
    cold, middle, warm = (frames(sensor, kelvin, 64) for kelvin in (285.0, 295.0, 305.0))
    responsivity = (warm.mean(axis=0) - cold.mean(axis=0)) / 20
    good = np.setdiff1d(np.arange(responsivity.size), sensor.bad.places)
    assert np.abs(responsivity[good] - 1).max() < 0.02
    assert responsivity[sensor.bad.of(BadPixel.DEAD)].max() < 0.5 * responsivity.mean()
    assert (middle[:, sensor.bad.of(BadPixel.HOT)] > 100).all()
    noise = middle.std(axis=0)
    assert noise[sensor.bad.of(BadPixel.NOISY)].min() > 2 * noise[good].mean()
    assert noise[good].max() < 2 * noise[good].mean()
    # After a two-point correction only outliers are wrong at a third temperature.
    gain = 20 / (warm.mean(axis=0) - cold.mean(axis=0) + 1e-9)
    corrected = gain * (middle.mean(axis=0) - cold.mean(axis=0)) - 10
    spread = np.median(np.abs(corrected[good] - np.median(corrected[good])))
    assert np.abs(corrected[sensor.bad.of(BadPixel.OUTLIER)]).min() > 6 * spread
    assert np.abs(corrected[good]).max() < 0.04


def test_blinking_pixels_jump_to_and_fro(sensor: Sensor) -> None:
    seen = frames(sensor, 295.0, 120, step_s=0.5)
    blinking = seen[:, sensor.bad.of(BadPixel.BLINKING)]
    jumps = np.abs(np.diff(blinking, axis=0)) > 0.3
    assert (jumps.sum(axis=0) >= 2).mean() > 0.95
    assert jumps.mean() < 0.3
    span = np.ptp(blinking, axis=0)
    assert span.min() > 0.5
    assert span.max() < 2.4
    others = np.setdiff1d(np.arange(seen.shape[1]), sensor.bad.places)
    assert np.ptp(seen[:, others], axis=0).max() < 0.5


def test_another_camera_has_other_bad_pixels(sensor: Sensor) -> None:
    again, other = Sensor(SETTINGS, *SHAPE, 1, "left"), Sensor(SETTINGS, *SHAPE, 1, "right")
    np.testing.assert_array_equal(again.bad.map(*SHAPE), sensor.bad.map(*SHAPE))
    both = (other.bad.map(*SHAPE) > 0) & (sensor.bad.map(*SHAPE) > 0)
    assert both.mean() < 0.002


def test_bad_pixels_without_any_kind_are_refused() -> None:
    with pytest.raises(ValidationError, match="share above 0"):
        BadPixelShares(dead=0, hot=0, noisy=0, blinking=0, outlier=0)
