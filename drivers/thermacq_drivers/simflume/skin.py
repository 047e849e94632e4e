"""Apparent temperature of the water's skin: texture, warming by lamps, emission and reflection.

All in kelvin of radiance above a black body at the water's temperature (see `radiance`). With T the skin's
temperature above it, texture τ plus warming w, c the curvature of radiance, ε the emissivity, and A, L the
apparent rises of surroundings and lamps:

    seen = ε (w + c w² + (1 + 2cw) τ) + (1 - ε) (A + share of lamps in the reflection · (L - A)).

The term c τ² is left out: 0.4 mK for 0.3 K. All but texture and lamps' reflections is smooth, so it is
found at the nodes of the picture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume import lamps as heat_lamps
from thermacq_drivers.simflume.component_sea import ComponentSea
from thermacq_drivers.simflume.cylinder import CylinderWave
from thermacq_drivers.simflume.radiance import WaterSkin, apparent_curvature, apparent_rise
from thermacq_drivers.simflume.regular_wave import RegularWave
from thermacq_drivers.simflume.settings import SceneSettings
from thermacq_drivers.simflume.sight import Continued, Sight, Water
from thermacq_drivers.simflume.surfaces import Floats, StillWater, Surface
from thermacq_drivers.simflume.texture import ThermalTexture, grid_place

_GLARE_MARGIN_M = 0.08


class Skin:
    """The water's skin in one scene.

    Parameters
    ----------
    settings
        The scene.
    surface
        Its water; where its drift is not constant, the lamps' warming is fixed to the flume.
    """

    def __init__(self, settings: SceneSettings, surface: Surface) -> None:
        self._texture = ThermalTexture(settings.texture, settings.seed)
        self._lamps = settings.lamps
        self._drift_m_s = _constant_drift(surface)
        water_k = settings.water_temperature_k
        self._curvature = apparent_curvature(water_k)
        self._emission: WaterSkin | None = None
        if settings.surroundings is not None:
            self._emission = WaterSkin(settings.surroundings.emissivity)
            self._ambient = float(apparent_rise(settings.surroundings.ambient_k, water_k))
        if settings.lamps is not None:
            self._tube = float(apparent_rise(settings.lamps.tube_k, water_k))

    def picture(
        self, sight: Sight, water: Water, labels: tuple[Floats, Floats], time_s: float, read_s: Floats | float
    ) -> NDArray[np.float32]:
        """What the camera would see of the water alone.

        Parameters
        ----------
        sight, water
            The camera, and where the rays of its nodes meet the water.
        labels
            Material labels there, along x and along y.
        time_s, read_s
            Time of the exposure, by which the texture lives, and of each node's read-out.

        Returns
        -------
        numpy.ndarray
            (rows, columns) float32, kelvin above the water's temperature; a new array.
        """
        grid = sight.grid
        rows, columns = (grid.spread_single(grid_place(label)) for label in labels)
        seen = self._texture.sample(rows, columns, time_s)
        if self._lamps is None and self._emission is None:
            return seen
        emissivity, rise, gain = self._smooth(water, sight.rays, labels, read_s)
        seen *= grid.spread_single(gain)
        seen += grid.spread_single(rise)
        self._add_glare(seen, sight, water, emissivity)
        return seen

    def places(
        self, water: Water, rays: Floats, labels: tuple[Floats, Floats], time_s: float, read_s: Floats | float
    ) -> Floats:
        """Like `picture`, at single places: arrays of shape (places, ...), result (places,)."""
        rows, columns = (grid_place(label)[None].astype(np.float32) for label in labels)
        texture = self._texture.sample(rows, columns, time_s)[0]
        emissivity, rise, gain = self._smooth(water, rays, labels, read_s)
        seen: Floats = rise + gain * texture
        if self._lamps is not None and self._emission is not None:
            directions = heat_lamps.reflected(rays, water.slope_x, water.slope_y)
            share = heat_lamps.tube_share(
                self._lamps, *heat_lamps.seen_at(self._lamps, water.points_m, directions)
            )
            seen += (1 - emissivity) * share * (self._tube - self._ambient)
        return seen

    def _smooth(
        self, water: Water, rays: Floats, labels: tuple[Floats, Floats], read_s: Floats | float
    ) -> tuple[Floats, Floats, Floats]:
        """Emissivity, apparent rise without texture, and what the texture is multiplied by."""
        warm: Floats = np.zeros(labels[0].shape)
        if self._lamps is not None:
            mean_x, mean_y = water.points_m[..., 0], water.points_m[..., 1]
            if self._drift_m_s is not None:
                mean_x, mean_y = (
                    label + drift * read_s for label, drift in zip(labels, self._drift_m_s, strict=True)
                )
            warm = heat_lamps.warming(self._lamps, mean_x, mean_y)
        rise = warm + self._curvature * warm**2
        gain = 1 + 2 * self._curvature * warm
        if self._emission is None:
            return np.ones(warm.shape), rise, gain
        along = rays[..., 2] - water.slope_x * rays[..., 0] - water.slope_y * rays[..., 1]
        lengths = np.linalg.norm(rays, axis=-1) * np.sqrt(1 + water.slope_x**2 + water.slope_y**2)
        emissivity = self._emission.emissivity(-along / lengths)
        return emissivity, emissivity * rise + (1 - emissivity) * self._ambient, emissivity * gain

    def _add_glare(self, seen: NDArray[np.float32], sight: Sight, water: Water, emissivity: Floats) -> None:
        """Add the reflections of the lamps' tubes, in those rows of the picture that have some."""
        if self._lamps is None or self._emission is None:
            return
        directions = heat_lamps.reflected(sight.rays, water.slope_x, water.slope_y)
        x, y = heat_lamps.seen_at(self._lamps, water.points_m, directions)
        near = np.flatnonzero(heat_lamps.near_tubes(self._lamps, x, y, _GLARE_MARGIN_M).any(axis=1))
        if not len(near):
            return
        node_rows = sight.grid.nodes_px[:, 0, 1]
        first = max(0, int(node_rows[max(0, near[0] - 1)]))
        last = min(len(seen), int(node_rows[min(len(node_rows) - 1, near[-1] + 1)]) + 1)
        rows = slice(first, last)
        x, y, reflectance = (sight.grid.spread(values, rows) for values in (x, y, 1 - emissivity))
        share = heat_lamps.tube_share(self._lamps, x, y)
        seen[rows] += (reflectance * share * (self._tube - self._ambient)).astype(np.float32)


def _constant_drift(surface: Surface) -> tuple[float, float] | None:
    """Drift with which labels plus drift times time are mean places; None where there is no such thing."""
    if isinstance(surface, Continued):
        surface = surface.surface
    match surface:
        case StillWater():
            return 0.0, 0.0
        case RegularWave():
            return surface.drift_m_s, 0.0
        case ComponentSea() | CylinderWave():
            return surface.drift_m_s
        case _:
            return None
