"""The whole correction against simulated raw cameras of which everything is known.

Full pictures of 640 x 512, drawn from the sensor directly. Views are apart in time as in a laboratory, so that
1/f noise acts between them; each frame has noise of its own.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from thermacq_calibration import (
    BadPixel,
    CameraCorrection,
    ReferenceView,
    fit_growth,
    make_correction,
    observe,
    uniformity,
    update_offset,
    with_shading,
)
from thermacq_calibration.infrared.bad_pixels import blinking_pixels
from thermacq_drivers.simflume.bad_pixels import BadPixel as TrueKind
from thermacq_drivers.simflume.camera import CameraSettings, in_condition, make_sensor
from thermacq_drivers.simflume.ready_made import scene_toml
from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.warm_up import fpa_temperature, housing_temperature

NO_FLICKER = {"flicker_k": 0.0, "column_flicker_k": 0.0}


class RawCamera:
    """A camera of a shipped scene, before blackbodies and with its shutter."""

    def __init__(
        self,
        scene: str = "dirty-sensor-blackbody",
        name: str = "left",
        room_k: float = 295.0,
        powered_for_s: float = 7200.0,
        **sensor: Any,
    ) -> None:
        settings = parse_scene(tomllib.loads(scene_toml(scene)))
        camera = in_condition(CameraSettings(), settings.camera)
        self.warm_up = camera.warm_up.model_copy(update={"room_k": room_k, "powered_for_s": powered_for_s})
        camera = camera.model_copy(
            update={
                "warm_up": self.warm_up,
                "shutter": camera.shutter.model_copy(update={"period_s": 0.0}),
                "sensor": camera.sensor.model_copy(update=sensor),
            }
        )
        self.sensor = make_sensor(camera, settings, name)
        self.shape = camera.rows, camera.columns
        self._lensless = Sensor(camera.sensor, *self.shape, settings.seed, name, warm_up=self.warm_up)
        # Another camera of the same kind must not see the same noise again.
        self._index = round(room_k * 1e6 + powered_for_s)

    def view(
        self, kelvin: float, start_s: float, count: int = 64, seconds: float = 5.0, known: bool = True
    ) -> ReferenceView:
        inside_k = fpa_temperature(self.warm_up, start_s + seconds / 2)
        frames = self._frames(self.sensor, kelvin, start_s, count, seconds)
        return observe(frames, kelvin if known else None, inside_k)

    def shutter(self, start_s: float, count: int = 64, seconds: float = 2.0) -> ReferenceView:
        """The shutter between lens and sensor, as warm as the housing."""
        kelvin = housing_temperature(self.warm_up, start_s)
        frames = self._frames(self._lensless, kelvin, start_s, count, seconds)
        return observe(frames, fpa_temperature_k=fpa_temperature(self.warm_up, start_s))

    def _frames(
        self, sensor: Sensor, kelvin: float, start_s: float, count: int, seconds: float
    ) -> Iterator[np.ndarray]:
        counts = np.empty(self.shape, np.uint16)
        for number in range(count):
            self._index += 1
            view = np.full(self.shape, kelvin, np.float32)
            sensor.expose(view, self._index, counts, start_s + seconds * number / count)
            yield counts


def correct(camera: RawCamera, span_k: float, count: int, **more: Any) -> CameraCorrection:
    """Two-point correction around 295 K from views of 20 s each, and a check in the middle."""
    half_k = span_k / 2
    cold, hot, check = (
        camera.view(295 + above_k, start_s, count, 20.0)
        for above_k, start_s in ((-half_k, 0.0), (half_k, 22.0), (0.0, 44.0))
    )
    return make_correction([cold, hot], check, serial="SIM-1", camera="left", **more)


@cache
def dirty() -> tuple[RawCamera, CameraCorrection]:
    camera = RawCamera()
    return camera, correct(camera, 6.0, 128)


def large_scale_k(correction: CameraCorrection, view: ReferenceView) -> float:
    found = uniformity(correction, view)
    kelvin = found.kelvin(found.large_scale_counts)
    assert kelvin is not None
    return kelvin


@pytest.mark.slow
def test_a_raw_camera_is_uniform_at_a_held_out_temperature():
    camera, correction = dirty()
    held_out = uniformity(correction, camera.view(294.0, 66.0))
    assert held_out.sigma_vh_per_netd <= 0.5
    assert abs(held_out.level_error_k) < 0.005
    assert held_out.kelvin(held_out.large_scale_counts) <= 0.05
    # A uniform view 4 s before takes most of the 1/f noise between the views away.
    fresh = update_offset(correction, camera.view(296.5, 72.0, 96, 2.0))
    again = uniformity(fresh, camera.view(294.0, 76.0, 64, 2.0))
    assert again.sigma_vh_per_netd <= 0.33
    assert again.sigma_vh_per_netd < held_out.sigma_vh_per_netd


@pytest.mark.slow
def test_bad_pixels_are_found_and_good_ones_left():
    camera, correction = dirty()
    true, found = camera.sensor.bad.map(*camera.shape), correction.bad_pixels
    assert np.mean(found[true > 0] > 0) >= 0.999
    assert np.mean(found[true == 0] > 0) <= 0.0002
    for reason, kinds in (
        (BadPixel.DEAD, (TrueKind.DEAD, TrueKind.HOT)),
        (BadPixel.NOISY, (TrueKind.NOISY,)),
        (BadPixel.OUTLIER, (TrueKind.OUTLIER,)),
    ):
        assert np.mean(found[np.isin(true, kinds)] & reason > 0) >= 0.98
        # Blinking pixels may show as any of the others, depending on when they jump.
        wrong = (found & reason > 0) & ~np.isin(true, (*kinds, TrueKind.BLINKING, TrueKind.NOISY))
        assert wrong.mean() <= 0.0002


@pytest.mark.slow
def test_without_1_over_f_noise_a_quarter_of_the_netd_is_met():
    camera = RawCamera(name="right", **NO_FLICKER)
    correction = correct(camera, 6.0, 64)
    assert uniformity(correction, camera.view(294.0, 66.0)).sigma_vh_per_netd <= 0.25


@pytest.mark.slow
def test_curvature_is_the_limit_of_a_wide_span():
    camera = RawCamera(**NO_FLICKER)
    correction = correct(camera, 20.0, 32)
    found = uniformity(correction, camera.view(295.0, 66.0, 32))
    # In the middle of a span of 20 K pixels differ by sigma_q (10 K)², of which the lens passes a part.
    lens = camera.sensor._lens
    assert lens is not None
    expected_k = 8e-4 * 10**2 * float(np.sqrt(np.mean(lens.transmission**2)))
    assert found.kelvin(found.sigma_vh_counts) == pytest.approx(expected_k, rel=0.05)
    assert found.sigma_vh_per_netd > 1


@pytest.mark.slow
def test_a_camera_with_its_own_correction_gets_better_still():
    camera = RawCamera("blackbody")
    views = [camera.view(290.0, 0.0), camera.view(300.0, 6.0)]
    correction = make_correction(views, serial="SIM-1", camera="left")
    held_out = camera.view(295.0, 12.0)
    found = uniformity(correction, held_out)
    assert found.sigma_vh_per_netd <= 0.12
    nothing = replace(correction, gain=np.ones(camera.shape), offset=np.zeros(camera.shape))
    assert uniformity(nothing, held_out).spatial_counts > 10 * found.spatial_counts


@pytest.mark.slow
def test_shading_follows_the_temperature_of_the_room():
    """Learnt from a uniform view in a room 2 K warmer, it serves in one 3 K warmer and another time."""
    _, correction = dirty()
    learnt_from = RawCamera(room_k=297.0).view(295.0, 100.0, 32)
    held_out = RawCamera(room_k=298.0).view(294.0, 200.0, 32)
    assert large_scale_k(correction, held_out) > 1.5
    shaded = with_shading(correction, learnt_from)
    assert large_scale_k(shaded, held_out) <= 0.1
    assert large_scale_k(shaded, learnt_from) <= 0.05


@pytest.mark.slow
def test_the_internal_shutter_follows_a_camera_that_warms_up():
    camera, correction = dirty()
    correction = replace(correction, shutter=camera.shutter(64.0).mean)
    cold = RawCamera(powered_for_s=600.0)
    held_out = cold.view(294.0, 103.0, 32)
    stale = uniformity(correction, held_out)
    updated = update_offset(correction, cold.shutter(100.0), behind_lens=True)
    fresh = uniformity(updated, held_out)
    assert large_scale_k(updated, held_out) <= 0.1
    assert fresh.large_scale_counts < 0.05 * stale.large_scale_counts
    assert fresh.sigma_vh_counts < 0.6 * stale.sigma_vh_counts


SMALL = (96, 120)


def small_frames(sensor: Sensor, count: int, start_s: float, step_s: float) -> Iterator[np.ndarray]:
    counts = np.empty(SMALL, np.uint16)
    for index in range(count):
        view = np.full(SMALL, 295.0, np.float32)
        sensor.expose(view, round(1e3 * start_s) + index, counts, start_s + index * step_s)
        yield counts


def test_blinking_pixels_need_time_rather_than_frames():
    settings = in_condition(
        CameraSettings(), parse_scene(tomllib.loads(scene_toml("dirty-sensor-blackbody"))).camera
    ).sensor
    sensor = Sensor(settings.model_copy(update={"bad_pixel_fraction": 0.05}), *SMALL, 1, "left")
    true = sensor.bad.of(TrueKind.BLINKING)
    good = np.setdiff1d(np.arange(SMALL[0] * SMALL[1]), sensor.bad.places)
    recall = {}
    for seconds in (20, 100):
        found = blinking_pixels(observe(small_frames(sensor, 1000, 0.0, seconds / 1000))).ravel()
        recall[seconds] = np.mean(found[true] > 0)
        assert not found[good].any()
    assert recall[100] >= 0.98
    assert 0.8 < recall[20] < recall[100]


def test_growth_of_the_pattern_is_predicted_from_its_beginning():
    """1/f noise makes fixed-pattern noise grow; what was seen within 5 minutes tells that of half an hour."""
    settings = in_condition(
        CameraSettings(), parse_scene(tomllib.loads(scene_toml("dirty-sensor-blackbody"))).camera
    ).sensor
    sensor = Sensor(settings.model_copy(update={"bad_pixel_fraction": 0.0}), *SMALL, 1, "left")
    correction = make_correction([observe(small_frames(sensor, 64, 0.0, 0.02))], serial="", camera="left")
    sigma = {}
    for age_s in (3.0, 10.0, 30.0, 100.0, 300.0, 1800.0):
        view = observe(small_frames(sensor, 64, age_s, 0.02))
        sigma[age_s] = uniformity(correction, view).sigma_vh_counts / settings.counts_per_k
    early = [age_s for age_s in sigma if age_s <= 300]
    growth = fit_growth(early, [sigma[age_s] for age_s in early])
    assert sigma[1800.0] > 1.5 * sigma[3.0]
    assert growth.sigma_k(1800.0) == pytest.approx(sigma[1800.0], rel=0.25)
