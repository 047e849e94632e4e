"""The water of a scene in numbers, for truth files and reports."""

from __future__ import annotations

from typing import Any

from thermacq_drivers.simflume.component_sea import ComponentSea
from thermacq_drivers.simflume.composed import Ramped, Superposed
from thermacq_drivers.simflume.cylinder import CylinderWave, Pierced
from thermacq_drivers.simflume.regular_wave import RegularWave
from thermacq_drivers.simflume.surfaces import Surface


def surface_facts(surface: Surface) -> dict[str, Any]:
    """The waves in numbers; "kind" says which."""
    facts: dict[str, Any] = {"kind": "still"}
    match surface:
        case RegularWave():
            facts = _regular_facts(surface)
        case ComponentSea():
            facts = {
                "kind": "components",
                "count": len(surface.components.amplitude_m),
                "significant_wave_height_m": surface.components.significant_wave_height_m,
                "drift_m_s": surface.drift_m_s[0],
            }
        case CylinderWave():
            facts = {**_regular_facts(surface.wave), "kind": "diffracted", "highest_m": surface.highest_m}
        case Superposed():
            facts = {"kind": "superposed", "parts": [surface_facts(part) for part in surface.parts]}
        case Ramped():
            start = {"start_s": surface.start_s, "rise_s": surface.rise_s}
            facts = {"kind": "ramped", "waves": surface_facts(surface.waves), **start}
        case Pierced():
            cylinder = surface.cylinder
            place = {"x_m": cylinder.x_m, "y_m": cylinder.y_m, "radius_m": cylinder.radius_m}
            facts = {**surface_facts(surface.surface), "cylinder": place}
    return facts


def _regular_facts(wave: RegularWave) -> dict[str, Any]:
    return {
        "kind": "regular",
        "period_s": wave.period_s,
        "length_m": wave.length_m,
        "height_m": wave.height_m,
        "steepness": wave.height_m / wave.length_m,
        "celerity_m_s": wave.celerity_m_s,
        "drift_m_s": wave.drift_m_s,
        "crest_m": wave.highest_m,
    }
