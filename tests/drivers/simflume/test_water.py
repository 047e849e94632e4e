from __future__ import annotations

import json
import tomllib
from typing import Any

import numpy as np
import pytest

from thermacq.errors import RigError
from thermacq_drivers.simflume.composed import Ramped, Superposed
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.projection import PixelGrid, check_view, intersect
from thermacq_drivers.simflume.ready_made import scene_toml
from thermacq_drivers.simflume.scene import build_surface
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.surfaces import Surface
from thermacq_drivers.simflume.validation_water import mean_period, record
from thermacq_drivers.simflume.water_facts import surface_facts

REGULAR = {"surface": {"kind": "regular", "case": "T0.791-H2/25"}}
SCENES: dict[str, dict[str, Any]] = {
    "jonswap": {"surface": {"kind": "irregular"}},
    "directional": {"surface": {"kind": "irregular", "spreading": 10}},
    "white": {"surface": {"kind": "irregular", "spectrum": "white", "band": [0.5, 2]}},
    "gaussian": {"surface": {"kind": "group", "focus_time_s": 0.3}},
    "focused": {"surface": {"kind": "group", "shape": "focused", "focus_time_s": 0.3}},
    "reflection": {**REGULAR, "reflection": {"coefficient": 0.1}},
    "ramp": {**REGULAR, "ramp": {"start_s": -1.0}},
    "seiche": {"seiche": {}},
    "wave and seiche": {**REGULAR, "seiche": {}},
}
SHIPPED = [
    "irregular-sea",
    "directional-sea",
    "wave-group",
    "focused-group",
    "reflection",
    "seiche",
    "start-up",
]


def water(values: dict[str, Any]) -> Surface:
    return build_surface(parse_scene(values))


@pytest.mark.parametrize("name", SCENES)
def test_every_pixel_sees_its_own_point_of_the_water(name: str) -> None:
    surface, grid = water(SCENES[name]), PixelGrid(512, 640)
    camera = build_camera(Mounting())
    check_view(camera, surface)
    rays = camera.rays(grid.nodes_px)
    depth = intersect(surface, camera, rays, 0.31)
    points = camera.centre_m + depth[..., None] * rays
    rows = slice(0, 512, 5)
    x, y = grid.spread(points[..., 0], rows), grid.spread(points[..., 1], rows)
    seen = camera.project(np.stack([x, y, surface.elevation(x, y, 0.31)], axis=-1))
    pixels = np.stack(np.meshgrid(np.arange(640.0), np.arange(512.0)[rows]), axis=-1)
    assert np.linalg.norm(seen - pixels, axis=-1).max() < 0.001


@pytest.mark.parametrize("name", SCENES)
def test_slope_and_label_are_those_of_the_elevation_and_the_velocity(name: str) -> None:
    surface = water(SCENES[name])
    x, y, step = np.linspace(-0.1, 0.6, 40), np.linspace(-0.3, 0.3, 40), 1e-4
    sides = surface.elevation(x + step, y, 0.4) - surface.elevation(x - step, y, 0.4)
    np.testing.assert_allclose(surface.slope(x, y, 0.4)[0], sides / (2 * step), atol=1e-4)
    along, across = (part * step for part in surface.velocity(x, y, 0.4))
    later = surface.label(x + along, y + across, 0.4 + step)[0]
    before = surface.label(x - along, y - across, 0.4 - step)[0]
    # A sum of waters and a starting wave keep labels to first order only: lost, a part of the speed, ka = 0.25.
    approximate = isinstance(surface, Superposed | Ramped)
    speed = np.abs(along).max() / step
    assert np.abs(later - before).max() / (2 * step) < (0.15 * speed if approximate else 1e-4)


def test_a_reflected_group_comes_back_from_the_absorber() -> None:
    group = {"kind": "group", "period_s": 0.8, "bandwidth": 0.15, "focus_x_m": 0.0, "focus_time_s": 5.0}
    scene = {"surface": group, "reflection": {"coefficient": 0.4, "absorber_x_m": 2.0}}
    surface, incident = water(scene), water({"surface": group})
    time_s = np.arange(0, 20, 0.02)
    back = record(surface, 0.0, time_s) - record(incident, 0.0, time_s)
    # There and back, 4 m, as the group alone would look 4 m farther on.
    np.testing.assert_allclose(back, 0.4 * record(incident, 4.0, time_s), atol=1e-12)


def test_the_seiche_is_the_first_mode_of_the_flume() -> None:
    surface = water({"seiche": {"amplitude_m": 0.002}})
    time_s = np.arange(0, 300, 0.05)
    eta = record(surface, -8.0, time_s)
    k = np.pi / 20
    period_s = 2 * np.pi / np.sqrt(9.81 * k * np.tanh(k * 0.9))
    assert mean_period(time_s, eta) == pytest.approx(period_s, rel=1e-4)
    # Merian's formula holds for water that is shallow against the flume's length.
    assert period_s == pytest.approx(2 * 20 / np.sqrt(9.81 * 0.9), rel=0.005)
    assert np.abs(eta).max() == pytest.approx(0.002, rel=1e-3)
    np.testing.assert_allclose(record(surface, 12.0, time_s), -eta, atol=1e-12)
    assert np.abs(record(surface, 2.0, time_s)).max() < 1e-12


def test_waves_start_with_a_front_at_the_group_speed() -> None:
    surface = water({**REGULAR, "ramp": {"start_s": 2.0, "rise_s": 4.0}})
    full = water(REGULAR)
    time_s = np.arange(0, 40, 0.02)
    here, there = record(surface, 0.0, time_s), record(surface, 1.0, time_s)
    assert not here[time_s <= 2.0].any()
    speed = 0.5 * 9.81 * 0.791 / (2 * np.pi)
    assert not there[time_s <= 2.0 + 0.99 / speed].any()
    np.testing.assert_array_equal(here[time_s > 6.0], record(full, 0.0, time_s)[time_s > 6.0])
    half = time_s[np.abs(time_s - 4.0) < 0.4]
    assert np.abs(record(surface, 0.0, half)).max() == pytest.approx(full.highest_m / 2, rel=0.2)


def test_what_floats_drifts_only_once_the_waves_are_there() -> None:
    scene = {**REGULAR, "ramp": {"start_s": 2.0, "rise_s": 4.0}}
    surface, drift = water(scene), water(REGULAR).drift_m_s
    x, y = np.array([0.1]), np.zeros(1)
    np.testing.assert_array_equal(surface.label(x, y, 1.9)[0], x)
    later = surface.label(x, y, 20 * 0.791)[0] - surface.label(x, y, 40 * 0.791)[0]
    assert later[0] == pytest.approx(20 * 0.791 * drift, rel=1e-9)
    # The rise counts as ∫ sin⁴ = 3/8 of its time.
    speed = 0.5 * 9.81 * 0.791 / (2 * np.pi)
    begun = 20 * 0.791 - 2.0 - 0.1 / speed - 4.0 * 5 / 8
    whole = water(REGULAR).label(x, y, 0.0)[0] - surface.label(x, y, 20 * 0.791)[0]
    assert whole[0] == pytest.approx(begun * drift, abs=1e-3)


def test_a_sum_of_waters_adds_up() -> None:
    both, wave, seiche = water({**REGULAR, "seiche": {}}), water(REGULAR), water({"seiche": {}})
    x, y = np.linspace(0, 0.5, 7), np.zeros(7)
    total = wave.elevation(x, y, 0.3) + seiche.elevation(x, y, 0.3)
    np.testing.assert_allclose(both.elevation(x, y, 0.3), total, atol=1e-15)
    shift = wave.label(x, y, 0.3)[0] - x + seiche.label(x, y, 0.3)[0] - x
    np.testing.assert_allclose(both.label(x, y, 0.3)[0], x + shift, atol=1e-12)
    assert both.drift_m_s == (wave.drift_m_s, 0.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"surface": {"kind": "irregular", "significant_wave_height_m": 0.2}}, "Hm0 = 0.2 m is too high"),
        ({"surface": {"kind": "irregular", "band": [2.0, 1.0]}}, "in order"),
        ({"surface": {"kind": "group", "shape": "focused", "amplitude_m": 0.08}}, "the group is too steep"),
        ({"surface": {"kind": "regular", "period_s": 0.8, "steepness": 0.14}}, "too high"),
        (
            {"surface": {"kind": "regular", "case": "T0.791-H1/10"}, "reflection": {"coefficient": 0.9}},
            "with its reflection the wave is",
        ),
        ({"reflection": {}}, "no waves to reflect"),
        ({"depth_m": -0.9}, "greater than 0.05"),
        ({**REGULAR, "cylinder": {"radius_m": 0.6}}, "does not fit"),
        ({**SCENES["jonswap"], "cylinder": {}}, "not diffracted"),
        ({**REGULAR, "cylinder": {}, "reflection": {}}, "not diffracted by a cylinder"),
    ],
)
def test_water_that_cannot_be_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(RigError) as caught:
        parse_scene(values)
    assert message in str(caught.value)


@pytest.mark.parametrize("name", [*SCENES, "cylinder"])
def test_facts_are_plain_numbers(name: str) -> None:
    values = {**REGULAR, "cylinder": {"radius_m": 0.06}} if name == "cylinder" else SCENES[name]
    facts = json.loads(json.dumps(surface_facts(water(values))))
    assert facts["kind"] in ("components", "superposed", "ramped", "diffracted")
    if name == "jonswap":
        assert facts["significant_wave_height_m"] == pytest.approx(0.04)
    if name == "cylinder":
        assert facts["cylinder"]["radius_m"] == 0.06
        assert facts["highest_m"] > facts["crest_m"]


@pytest.mark.parametrize("name", [*SHIPPED, "cylinder", "cylinder-long-wave", "cylinder-still"])
def test_shipped_scenes_can_be_looked_at(name: str) -> None:
    scene = parse_scene(tomllib.loads(scene_toml(name)))
    surface = build_surface(scene)
    for side in ("left", "right"):
        check_view(build_camera(Mounting(side=side)), surface)
