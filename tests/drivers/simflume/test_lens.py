from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from thermacq_drivers.simflume.lens import MTF_TOLERANCE, build_lens, transfer
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import LensSettings, SensorSettings

FREQUENCY = np.linspace(0, 0.5, 101)
DISTANCE_M = 0.6 / np.cos(np.radians(22.8))
PERFECT: dict[str, Any] = {"focus_distance_m": DISTANCE_M, "aberration_px": 0.0}


@pytest.mark.parametrize("f_number", [0.8, 1.0, 1.4, 2.0])
@pytest.mark.parametrize("focus_m", [0.5, 0.65, 0.9, 3.0])
@pytest.mark.parametrize("integrated", [False, True])
def test_the_short_kernel_follows_the_transfer_function(
    f_number: float, focus_m: float, integrated: bool
) -> None:
    settings = LensSettings(f_number=f_number, focus_distance_m=focus_m)
    kernel = build_lens(settings, Mounting(), integrated).kernel.astype(float)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-6)
    assert kernel.min() >= 0
    assert (np.diff(kernel[: len(kernel) // 2 + 1]) >= -1e-9).all()
    reach = len(kernel) // 2
    made = np.cos(2 * np.pi * np.outer(FREQUENCY, np.arange(-reach, reach + 1))) @ kernel
    wanted = transfer(settings, Mounting(), DISTANCE_M, FREQUENCY, integrated)
    np.testing.assert_allclose(made, wanted, atol=MTF_TOLERANCE)


def test_diffraction_ends_at_its_cut_off() -> None:
    # A long wave at a small pixel: 1 / (lambda F) = 0.5 cycles per pixel.
    settings = LensSettings(f_number=1.7, wavelength_um=20.0, fill_factor=1e-3, **PERFECT)
    found = transfer(settings, Mounting(), DISTANCE_M, FREQUENCY, integrated=False)
    assert found[0] == pytest.approx(1.0)
    assert found[50] == pytest.approx(0.391, abs=0.001)  # at half the cut-off, of any circular pupil
    assert found[-1] == pytest.approx(0.0, abs=1e-6)


def test_defocus_is_the_disc_of_geometry() -> None:
    settings = LensSettings(f_number=1.0, focus_distance_m=0.8, aberration_px=0.0)
    focused = settings.model_copy(update=PERFECT)
    ratio = transfer(settings, Mounting(), DISTANCE_M, FREQUENCY, True) / transfer(
        focused, Mounting(), DISTANCE_M, FREQUENCY, True
    )
    disc_px = 12e-3**2 * (1 / DISTANCE_M - 1 / 0.8) / 17e-6
    # A disc of diameter d has the second moment d²/16 along an axis.
    small = FREQUENCY[1:8]
    np.testing.assert_allclose(-np.log(ratio[1:8]), 2 * np.pi**2 * small**2 * disc_px**2 / 16, rtol=0.02)


def seen(lens_settings: LensSettings, scene_k: float) -> np.ndarray:
    quiet = SensorSettings(netd_k=0, offset_k=0, gain=0, shading_k=0, bad_pixel_fraction=0)
    mounting = Mounting()
    sensor = Sensor(quiet, 512, 640, 1, "left", lens=build_lens(lens_settings, mounting, integrated=False))
    counts = np.empty((512, 640), np.uint16)
    sensor.expose(np.full((512, 640), scene_k, np.float32), 0, counts, 0.0)
    return counts.astype(float) / 100 - 60 + 295


def test_vignetting_mixes_the_scene_with_the_housing() -> None:
    found = seen(LensSettings(vignetting=1.0), 285.0)
    rays = build_camera(Mounting())
    column, row = 0, 0
    tangent = np.hypot(*(np.array([column, row]) - rays.matrix[:2, 2]) / rays.matrix[0, 0])
    share = np.cos(np.arctan(tangent)) ** 4
    housing_k = 295 + 6 * (1 - np.exp(-7200 / 900))
    assert found[row, column] == pytest.approx(share * 285 + (1 - share) * housing_k, abs=0.01)
    assert found[254, 323] == pytest.approx(285.0, abs=0.02)


def test_narcissus_is_a_spot_that_grows_with_the_sensors_own_heat() -> None:
    found = seen(LensSettings(narcissus=0.05), 295.0)
    assert found[254, 323] - found[0, 0] == pytest.approx(0.05 * 4.0, abs=0.015)


def test_a_corrected_lens_keeps_uniform_views_uniform() -> None:
    assert np.ptp(seen(LensSettings(), 290.0)) == 0
