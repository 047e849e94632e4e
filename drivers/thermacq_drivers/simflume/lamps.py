"""Heat lamps upstream: how they warm the water's skin, and how their reflections show in it.

A lamp warms the skin as it drifts by below; downstream the warm film sinks its heat into the water. The mean
warming belongs to a particle's mean place, not to where its orbit just carries it:
``rise · exp(-X / decay)`` for X downstream of the lamps, less between the lamps.
"""

from __future__ import annotations

import numpy as np

from thermacq_drivers.simflume.heat_settings import LampSettings
from thermacq_drivers.simflume.surfaces import Floats

_ONSET_M = 0.1
# Distance over which the skin warms up below the lamps.
_EDGE_M = 0.003
# About what a pixel sees of a lamp's reflection: edges are softened by it.
_FLATTEST = 0.05
# Rays reflected more flatly than this (vertical part of the direction) pass below any lamp.


def warming(lamps: LampSettings, mean_x_m: Floats, mean_y_m: Floats) -> Floats:
    """Mean warming of the skin, kelvin, at mean places of its particles (any shape), metres."""
    onset = 0.5 * (1 + np.tanh((mean_x_m - lamps.x_m) / _ONSET_M))
    along = lamps.rise_k * np.exp(-np.maximum(mean_x_m, lamps.x_m) / lamps.decay_length_m)
    middles = np.array(lamps.y_m)
    nearest = np.abs(np.asarray(mean_y_m)[..., None] - middles).min(axis=-1)
    between = 1 - np.exp(-2 * (nearest / lamps.length_m) ** 2)
    warm: Floats = onset * along * (1 - lamps.unevenness * between)
    return warm


def reflected(rays: Floats, slope_x: Floats, slope_y: Floats) -> Floats:
    """Directions (..., 3) of rays (..., 3) after reflection at water of this slope; of the rays' length."""
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    along = (rays * normal).sum(axis=-1) / (normal * normal).sum(axis=-1)
    directions: Floats = rays - 2 * along[..., None] * normal
    return directions


def seen_at(lamps: LampSettings, points_m: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Places (x, y), metres, at which rays from points (..., 3) reach the height of the lamps."""
    length = np.linalg.norm(directions, axis=-1)
    rise = np.maximum(directions[..., 2], _FLATTEST * length)
    way = (lamps.height_m - points_m[..., 2]) / rise
    return points_m[..., 0] + way * directions[..., 0], points_m[..., 1] + way * directions[..., 1]


def near_tubes(lamps: LampSettings, x_m: Floats, y_m: Floats, margin_m: float) -> np.ndarray:
    """Whether places at the lamps' height are within a margin of the tubes, (...) bool."""
    near = np.abs(x_m - lamps.x_m) < 0.5 * lamps.width_m + margin_m
    reach = 0.5 * lamps.length_m + margin_m
    beside = (y_m > min(lamps.y_m) - reach) & (y_m < max(lamps.y_m) + reach)
    found: np.ndarray = near & beside
    return found


def tube_share(lamps: LampSettings, x_m: Floats, y_m: Floats) -> Floats:
    """Part of what a pixel sees at the lamps' height that is a glowing tube, 0 to 1."""
    across = _inside(np.abs(x_m - lamps.x_m), 0.5 * lamps.width_m)
    along = np.zeros(np.shape(y_m))
    for middle in lamps.y_m:
        along = np.maximum(along, _inside(np.abs(y_m - middle), 0.5 * lamps.length_m))
    share: Floats = across * along
    return share


def _inside(distance_m: Floats, half_m: float) -> Floats:
    return np.clip(0.5 + (half_m - distance_m) / _EDGE_M, 0.0, 1.0)
