"""Temperatures inside a camera since it was switched on: exponential approach to a steady state.

An uncorrected camera drifts by about 0.55 K of apparent temperature per kelvin of its focal-plane array
(Nugent, Opt. Eng. 52:061304).
"""

from __future__ import annotations

import math

from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.sensor_settings import WarmUpSettings


def fpa_temperature(settings: WarmUpSettings, time_s: float) -> float:
    """Temperature of the focal-plane array at a time of the scene, kelvin."""
    return settings.room_k + _risen(settings, time_s, settings.fpa_rise_k, settings.fpa_time_constant_s)


def settled_fpa_temperature(settings: WarmUpSettings) -> float:
    """Temperature of the focal-plane array in the end, at which the camera was calibrated, kelvin."""
    return settings.room_k + settings.fpa_rise_k


def housing_temperature(settings: WarmUpSettings, time_s: float) -> float:
    """Temperature of housing, lens barrel and shutter at a time of the scene, kelvin."""
    return settings.room_k + _risen(
        settings, time_s, settings.housing_rise_k, settings.housing_time_constant_s
    )


def fpa_reading(settings: WarmUpSettings, time_s: float, seed: int, name: str, number: int) -> float:
    """Temperature of the focal-plane array as the camera reports it with a frame, kelvin."""
    noise = generator(seed, name, "fpa reading", number).normal(0, settings.reading_noise_k)
    return fpa_temperature(settings, time_s) + float(noise)


def _risen(settings: WarmUpSettings, time_s: float, rise_k: float, time_constant_s: float) -> float:
    since_s = max(0.0, settings.powered_for_s + time_s)
    return -rise_k * math.expm1(-since_s / time_constant_s)
