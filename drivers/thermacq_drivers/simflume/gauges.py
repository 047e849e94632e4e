"""What kinds of wave gauge make of the water: hysteresis, drift with temperature, footprint, drop-outs, steps.

A gauge reads

    volts = zero + slope · [g (immersed + elevation seen + noise) - immersed],   g = 1 + α (T - T_calibrated),

with the temperature T(t) of the water and the length immersed in still water, whose reading drifts too. What
a gauge sees is a pure function of scene, seed and time:

- resistance: the elevation at its place;
- capacitance: the same less ``meniscus_m · tanh(rate / 1 cm/s)``: the meniscus hangs back where the water rises, and
  stays up where it falls;
- ultrasonic: the mean over a disc at each ping, held until the next one; nothing (NaN) where the echo is lost, at
  random or because the water's slope sends it elsewhere. Such samples are not delivered: a gap of the sample index.

For a static calibration the gauge is moved in still water: it sees one step after the other, and no waves.
Left out: wetting that depends on the water's cleanness, spray, the wake of the rods, the speed of sound in air.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.settings import SceneSettings, Table
from thermacq_drivers.simflume.surfaces import Floats, Surface

_FULL_HYSTERESIS_M_S = 0.01
_RATE_STEP_S = 0.0005
_ANGLES = 8
_RINGS = 3


class UltrasonicSettings(Table):
    """Settings of an ultrasonic gauge above the water."""

    footprint_radius_m: float = Field(0.02, gt=0, le=0.1, description="of the disc over which it averages")
    ping_rate_hz: float = Field(50.0, gt=0, le=200)
    slope_limit: float = Field(0.2, gt=0, description="a steeper place sends no echo back")
    dropout_probability: float = Field(0.005, ge=0, lt=1, description="of a ping whose echo is lost anyway")


class TemperatureSettings(Table):
    """How a gauge's coefficient follows the water's temperature."""

    coefficient_per_k: float = Field(
        0.0, gt=-0.1, lt=0.1, description="relative; about 0.02 where nothing compensates the conductivity"
    )
    calibrated_at_k: float = Field(295.0, gt=273, lt=373)
    warming_k_per_h: float = Field(0.0, gt=-100, lt=100, description="of the water, from scene time 0 on")
    immersed_m: float = Field(0.2, ge=0, le=2, description="length of the gauge under still water")


def gain(settings: TemperatureSettings, water_temperature_k: float, time_s: Floats) -> Floats:
    """True coefficient over that at the temperature of calibration, (...) like the times."""
    water_k = water_temperature_k + settings.warming_k_per_h * time_s / 3600
    return 1 + settings.coefficient_per_k * (water_k - settings.calibrated_at_k)


def steps(levels_m: Sequence[float], seconds_per_step: float, time_s: Floats) -> tuple[Floats, Floats]:
    """Elevation that a gauge sees when it is lowered step by step, and the direction of the last move.

    Parameters
    ----------
    levels_m
        What it sees at each step; before the first it hangs at 0, and at the last it stays.
    seconds_per_step
        Duration of a step.
    time_s
        (samples,) times of the scene.

    Returns
    -------
    tuple
        (samples,) metres, and (samples,) 1 where it was lowered, -1 where it was raised, 0 where neither.
    """
    levels = np.array(levels_m, np.float64)
    step = np.clip(np.floor(time_s / seconds_per_step), 0, levels.size - 1).astype(np.int64)
    return levels[step], np.sign(np.diff(levels, prepend=0.0))[step]


def rise(surface: Surface, x_m: float, y_m: float, time_s: Floats) -> Floats:
    """Direction in which the water moves at a place: near 1 where it rises, near -1 where it falls."""
    before, after = (
        surface.elevation(np.full(time_s.shape, x_m), np.full(time_s.shape, y_m), time_s + step_s)
        for step_s in (-_RATE_STEP_S, _RATE_STEP_S)
    )
    return np.tanh((after - before) / (2 * _RATE_STEP_S) / _FULL_HYSTERESIS_M_S)


def disc_mean(surface: Surface, x_m: float, y_m: float, radius_m: float, time_s: Floats) -> Floats:
    """Mean elevation over a disc, (samples,): exact for polynomials of x and y up to degree 7."""
    # Gauss-Legendre in the square of the radius, evenly spaced angles.
    nodes, weights = np.polynomial.legendre.leggauss(_RINGS)
    radii = radius_m * np.sqrt((nodes + 1) / 2)
    angles = 2 * math.pi * np.arange(_ANGLES) / _ANGLES
    x = (x_m + radii[:, None] * np.cos(angles)).reshape(-1, 1)
    y = (y_m + radii[:, None] * np.sin(angles)).reshape(-1, 1)
    elevation = surface.elevation(x, y, time_s[None, :]).reshape(_RINGS, _ANGLES, -1)
    mean: Floats = np.tensordot(weights / 2, elevation.mean(axis=1), 1)
    return mean


def lost_pings(settings: UltrasonicSettings, seed: int, device: str, pings: np.ndarray) -> np.ndarray:
    """Whether the echo of each ping is lost at random, (pings,) bool."""
    if settings.dropout_probability == 0:
        return np.zeros(len(pings), bool)
    draws = [generator(seed, device, "echo", int(ping)).uniform() for ping in pings]
    return np.array(draws) < settings.dropout_probability


def runs(present: np.ndarray) -> list[slice]:
    """Stretches of samples that are there, of (samples,) bool."""
    edges = np.flatnonzero(np.diff(present, prepend=False, append=False))
    return [slice(int(start), int(end)) for start, end in edges.reshape(-1, 2)]


def check_place(scene: SceneSettings, x_m: float, y_m: float, reach_m: float) -> None:
    """Refuse a gauge in the cylinder, or whose footprint reaches it; raises `ValueError`."""
    cylinder = scene.cylinder
    if cylinder is None or scene.view != "water":
        return
    if math.hypot(x_m - cylinder.x_m, y_m - cylinder.y_m) <= cylinder.radius_m + reach_m:
        what = "its footprint reaches" if reach_m else "it stands inside"
        raise ValueError(
            f"{what} the cylinder of radius {cylinder.radius_m:g} m at ({cylinder.x_m:g}, {cylinder.y_m:g}) m, "
            "where there is no water to measure"
        )
