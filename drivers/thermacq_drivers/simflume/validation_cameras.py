"""Checks of the simulated cameras against their settings and formulas, for tests and the validation page."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.signal import welch

from thermacq_calibration.infrared.noise import noise_3d
from thermacq_drivers.simflume.bolometer import lagged_temperature
from thermacq_drivers.simflume.drift import Flicker
from thermacq_drivers.simflume.lens import build_lens
from thermacq_drivers.simflume.mounting import Mounting
from thermacq_drivers.simflume.scene import build_view
from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import (
    BolometerSettings,
    LensSettings,
    SensorSettings,
    WarmUpSettings,
)
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.surfaces import Floats
from thermacq_drivers.simflume.validation_water import Check

_ROWS, _COLUMNS, _FRAMES = 512, 640, 80
NOISE_K = {"t": 0.006, "v": 0.02, "h": 0.03, "tv": 0.004, "th": 0.008, "vh": 0.05, "tvh": 0.035}


def camera_checks() -> list[Check]:
    """All checks of this module."""
    return [*noise_checks(), *flicker_checks(), *lag_checks(), rolling_check(), drift_check(), *lens_checks()]


def noise_checks() -> list[Check]:
    """3-D noise of simulated frames against the settings; `tvh` is the NETD.

    Tolerances are four standard errors, and 0.5 % for what rounding to counts adds.
    """
    settings = SensorSettings(
        netd_k=NOISE_K["tvh"],
        frame_noise_k=NOISE_K["t"],
        row_noise_k=NOISE_K["tv"],
        column_noise_k=NOISE_K["th"],
        offset_k=NOISE_K["vh"],
        row_offset_k=NOISE_K["v"],
        column_offset_k=NOISE_K["h"],
        gain=0.0,
        shading_k=0.0,
        blur_px=0.0,
        bad_pixel_fraction=0.0,
        counts_per_k=1000.0,
    )
    found = noise_3d(uniform_frames(settings, _FRAMES))
    return [
        Check(
            f"3-D noise, component {component}",
            "K",
            level_k,
            found.component(component).sigma,
            noise_tolerance(component) * level_k,
        )
        for component, level_k in NOISE_K.items()
    ]


def noise_tolerance(component: str) -> float:
    """Relative tolerance of one component: four standard errors of the deviation, and 0.5 %."""
    freedom = {"t": _FRAMES - 1, "v": _ROWS - 1, "h": _COLUMNS - 1}
    return 4 / math.sqrt(2 * math.prod(freedom[axis] for axis in component)) + 0.005


def uniform_frames(settings: SensorSettings, count: int) -> Iterator[Floats]:
    """Frames of a uniform view at 50 Hz, in kelvin."""
    sensor = Sensor(settings, _ROWS, _COLUMNS, 1, "left")
    counts = np.empty((_ROWS, _COLUMNS), np.uint16)
    for index in range(count):
        view = np.full(counts.shape, settings.reference_k, np.float32)
        sensor.expose(view, index, counts, index * 0.02)
        yield counts / settings.counts_per_k


def flicker_checks() -> list[Check]:
    """Spectral density of 1/f noise of unit deviation per octave against 1 / (f ln 2), within 20 %."""
    step_s = 0.25
    flicker = Flicker(1.0, (24, 24), 1, "left", "flicker")
    series = np.array([flicker.at(number * step_s).ravel() for number in range(4096)])
    frequency, density = welch(series, fs=1 / step_s, nperseg=1024, axis=0)
    mean = density.mean(axis=1)
    checks = []
    for at_hz in (0.02, 0.06, 0.18):
        near = (frequency > at_hz / 1.4) & (frequency < at_hz * 1.4)
        found = float(np.exp(np.mean(np.log(mean[near] * frequency[near])))) / at_hz
        known = 1 / (at_hz * math.log(2))
        checks.append(Check(f"1/f noise at {at_hz} Hz", "K2/Hz", known, found, 0.2 * known))
    return checks


class _Swing:
    """A uniform view that swings with time."""

    def __init__(self, rate_rad_s: float) -> None:
        self._rate_rad_s = rate_rad_s

    def temperature(self, time_s: float, index: int) -> np.ndarray:  # noqa: ARG002 (of the protocol)
        return np.full((1, 1), math.cos(self._rate_rad_s * time_s), np.float32)


def lag_checks() -> list[Check]:
    """Amplitude of a swinging scene behind the time constant against 1 / sqrt(1 + (ωτ)²)."""
    settings = BolometerSettings(time_constant_s=0.01)
    checks = []
    for turn in (0.5, 1.0, 2.0):
        rate = turn / settings.time_constant_s
        real, imaginary = (
            float(lagged_temperature(_Swing(rate), settings, phase / rate, 0)[0, 0])
            for phase in (0.0, math.pi / 2)
        )
        known = 1 / math.hypot(1, turn)
        checks.append(Check(f"amplitude at ωτ = {turn}", "1", known, math.hypot(real, imaginary), 0.017))
    return checks


def rolling_check() -> Check:
    """Difference between rows of a rolling picture of a wave and the same rows drawn at their own time."""
    scene = parse_scene(
        {"surface": {"kind": "regular", "case": "T0.791-H2/25"}, "texture": {"lifetime_s": 1e9}}
    )
    mounting, line_time_s = Mounting(), 32e-6
    rolling = build_view(scene, mounting, line_time_s).temperature(0.3, 0)
    together = build_view(scene, mounting)
    worst = max(
        float(np.abs(rolling[row] - together.temperature(0.3 + row * line_time_s, 0)[row]).max())
        for row in (10, 256, 500)
    )
    return Check("rolling read-out, rows against their own time", "K", 0.0, worst, 0.002)


def drift_check() -> Check:
    """Apparent drift of a cold camera in 5 minutes against 0.55 K per kelvin of its focal plane."""
    settings = SensorSettings(netd_k=0.0)
    sensor = Sensor(settings, 64, 80, 1, "left", warm_up=WarmUpSettings(powered_for_s=0.0))
    counts = np.empty((64, 80), np.uint16)
    levels_k = []
    for time_s in (0.0, 300.0):
        sensor.expose(np.full(counts.shape, 295.0, np.float32), 0, counts, time_s)
        levels_k.append(float(counts.mean()) / settings.counts_per_k)
    known = 0.55 * 10 * (1 - math.exp(-300 / 480))
    return Check("drift of a cold camera in 300 s", "K", known, levels_k[1] - levels_k[0], 0.005)


def lens_checks() -> list[Check]:
    """Blur of a perfect lens in focus against the diffraction limit times the pixel's area."""
    mounting = Mounting()
    distance_m = mounting.height_m / math.cos(math.radians(mounting.tilt_deg))
    settings = LensSettings(focus_distance_m=distance_m, aberration_px=0.0, fill_factor=1.0)
    kernel = build_lens(settings, mounting, integrated=False).kernel.astype(np.float64)
    taps = np.arange(len(kernel)) - len(kernel) // 2
    checks = []
    for frequency in (0.1, 0.25, 0.4):
        cut = frequency * settings.wavelength_um * settings.f_number / mounting.pixel_pitch_um
        limit = 2 / math.pi * (math.acos(cut) - cut * math.sqrt(1 - cut**2))
        known = limit * math.sin(math.pi * frequency) / (math.pi * frequency)
        found = float(kernel @ np.cos(2 * math.pi * frequency * taps))
        checks.append(Check(f"transfer of the lens at {frequency} cycles/px", "1", known, found, 0.08))
    return checks
