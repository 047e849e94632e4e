"""The water of a scene, put together from its settings."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from thermacq_drivers.simflume import spectra, wave_group
from thermacq_drivers.simflume.component_sea import Components, ComponentSea, join
from thermacq_drivers.simflume.composed import Ramped, Superposed
from thermacq_drivers.simflume.cylinder import Cylinder, CylinderWave, Pierced
from thermacq_drivers.simflume.dispersion import breaking_height, frequency, group_speed
from thermacq_drivers.simflume.regular_wave import RegularWave, solve_wave
from thermacq_drivers.simflume.surfaces import Floats, StillWater
from thermacq_drivers.simflume.water_settings import (
    GroupSurface,
    IrregularSurface,
    ReflectionSettings,
    SeicheSettings,
)

if TYPE_CHECKING:
    from thermacq_drivers.simflume.settings import RegularSurface, SceneSettings

Waves: TypeAlias = StillWater | RegularWave | ComponentSea | CylinderWave | Superposed | Ramped
"""Every kind of water, but for the hole of a cylinder."""


def build_water(settings: SceneSettings) -> Waves | Pierced:
    """The water of a scene; around a cylinder it is `cylinder.Pierced`.

    Raises
    ------
    ValueError
        Physics does not allow this water.
    """
    water = _build_waves(settings)
    if settings.seiche is not None:
        seiche = ComponentSea(seiche_components(settings.seiche, settings.depth_m))
        water = seiche if isinstance(water, StillWater) else Superposed((water, seiche), drift(water))
    if settings.cylinder is None:
        return water
    return Pierced(water, _cylinder(settings), drift(water))


def drift(water: Waves) -> tuple[float, float]:
    """Mean drift of the surface along x and y, m/s."""
    if isinstance(water, StillWater):
        return 0.0, 0.0
    if isinstance(water, RegularWave):
        return water.drift_m_s, 0.0
    return water.drift_m_s


def seiche_components(settings: SeicheSettings, depth_m: float) -> Components:
    """The two waves that make a standing wave of the flume, with antinodes at its ends."""
    k = math.pi * settings.mode / settings.flume_length_m
    wave = Components(
        amplitude_m=np.array([settings.amplitude_m / 2]),
        omega_rad_s=np.array([frequency(k, depth_m)]),
        along_rad_m=np.array([k]),
        across_rad_m=np.zeros(1),
        phase_rad=np.array([math.radians(settings.phase_deg) - k * settings.flume_start_x_m]),
        depth_m=depth_m,
    )
    return join(wave, wave.reflected(1.0, settings.flume_start_x_m))


def sea_components(settings: IrregularSurface, depth_m: float, seed: int) -> Components:
    """The waves of an irregular sea; raises `ValueError` for one that breaks all over."""
    peak_hz = 1 / settings.peak_period_s
    shapes: dict[str, Callable[[Floats], Floats]] = {
        "jonswap": partial(
            spectra.jonswap, peak_frequency_hz=peak_hz, peak_enhancement=settings.peak_enhancement
        ),
        "pierson-moskowitz": partial(spectra.pierson_moskowitz, peak_frequency_hz=peak_hz),
        "white": spectra.white,
    }
    spectra.check_sea(settings.significant_wave_height_m, settings.peak_period_s, depth_m)
    return spectra.draw_components(
        shapes[settings.spectrum],
        (settings.band[0] * peak_hz, settings.band[1] * peak_hz),
        settings.significant_wave_height_m,
        settings.components,
        depth_m,
        seed,
        random_amplitudes=settings.amplitudes == "random",
        spreading=settings.spreading,
    )


def group_components(settings: GroupSurface, depth_m: float) -> Components:
    """The waves of a group; raises `ValueError` for one that breaks at its focus."""
    if settings.shape == "focused":
        waves = wave_group.focused_group(settings.amplitude_m, settings.period_s, depth_m)
    else:
        make = wave_group.bichromatic if settings.shape == "bichromatic" else wave_group.gaussian_group
        waves = make(settings.amplitude_m, settings.period_s, settings.bandwidth, depth_m)
    wave_group.check_group(waves)
    return wave_group.focus(waves, settings.focus_x_m, settings.focus_time_s)


def _build_waves(settings: SceneSettings) -> Waves:
    """The waves with reflection and start-up, without seiche."""
    surface = settings.surface
    if surface.kind == "still":
        return StillWater()
    if surface.kind == "regular":
        waves = _regular_waves(settings, surface)
        period_s = surface.wave[0]
    else:
        waves = _linear_waves(settings, surface)
        period_s = surface.peak_period_s if surface.kind == "irregular" else surface.period_s
    if settings.ramp is None:
        return waves
    speed_m_s = group_speed(2 * math.pi / period_s, settings.depth_m)
    return Ramped(waves, drift(waves), settings.ramp.start_s, settings.ramp.rise_s, speed_m_s)


def _linear_waves(settings: SceneSettings, surface: IrregularSurface | GroupSurface) -> ComponentSea:
    if settings.cylinder is not None:
        raise ValueError(
            "a cylinder stands in still water or in regular waves only: other waves are not diffracted here"
        )
    if surface.kind == "irregular":
        components = sea_components(surface, settings.depth_m, settings.seed)
    else:
        components = group_components(surface, settings.depth_m)
    back = settings.reflection
    if back is not None:
        components = join(components, components.reflected(back.coefficient, back.absorber_x_m))
    return ComponentSea(components, random_phases=surface.kind == "irregular")


def _regular_waves(settings: SceneSettings, surface: RegularSurface) -> Waves:
    """A regular wave with its reflection or diffraction."""
    period_s, steepness = surface.wave
    wave = solve_wave(period_s, steepness, settings.depth_m, math.radians(surface.phase_deg))
    reflection = settings.reflection
    if settings.cylinder is not None:
        if reflection is not None:
            raise ValueError(
                "waves reflected by the absorber are not diffracted by a cylinder here: leave one out"
            )
        return CylinderWave(wave, _cylinder(settings))
    if reflection is None:
        return wave
    highest_m = breaking_height(period_s, settings.depth_m)
    antinode_m = wave.height_m * (1 + reflection.coefficient)
    if antinode_m > highest_m:
        raise ValueError(
            f"with its reflection the wave is {antinode_m:.3f} m high in places and breaks: waves of "
            f"{period_s:g} s break at {highest_m:.3f} m"
        )
    back = ComponentSea(reflected_wave(wave, reflection, settings.depth_m))
    return Superposed((wave, back), (wave.drift_m_s + back.drift_m_s[0], 0.0))


def reflected_wave(wave: RegularWave, reflection: ReflectionSettings, depth_m: float) -> Components:
    """The first harmonic of a regular wave, sent back by the absorber, with the wave's own length."""
    incident = Components(
        amplitude_m=np.array([wave.elevation_series[1]]),
        omega_rad_s=np.array([2 * math.pi / wave.period_s]),
        along_rad_m=np.array([wave.wavenumber_rad_m]),
        across_rad_m=np.zeros(1),
        phase_rad=np.array([wave.phase_rad]),
        depth_m=depth_m,
    )
    return incident.reflected(reflection.coefficient, reflection.absorber_x_m)


def _cylinder(settings: SceneSettings) -> Cylinder:
    assert settings.cylinder is not None
    return Cylinder(settings.cylinder.x_m, settings.cylinder.y_m, settings.cylinder.radius_m)
