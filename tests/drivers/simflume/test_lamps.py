from __future__ import annotations

import numpy as np
import pytest

from thermacq_drivers.simflume.heat_settings import LampSettings
from thermacq_drivers.simflume.lamps import reflected, seen_at, tube_share, warming
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.radiance import apparent_rise
from thermacq_drivers.simflume.scene import WaterView, build_surface
from thermacq_drivers.simflume.settings import parse_scene

PLAIN = {"texture": {"rms_k": 1e-6}}
BLACK = {**PLAIN, "surroundings": {"emissivity": 1.0, "ambient_k": 295.0}}
FLAT = {"misalignment_deg": (0.0, 0.0, 0.0), "distortion": (0.0,) * 5}


def test_the_water_cools_downstream_of_the_lamps() -> None:
    lamps = LampSettings(rise_k=1.5, decay_length_m=0.8)
    x = np.array([0.0, 0.8, 1.6])
    in_line = warming(lamps, x, np.zeros(3))
    np.testing.assert_allclose(in_line, 1.5 * np.exp(-x / 0.8), rtol=1e-4)
    between = warming(lamps, x, np.full(3, 0.14))
    assert np.all(between < in_line)
    assert np.all(between > (1 - lamps.unevenness) * in_line)
    assert warming(lamps, np.array(-1.2), np.zeros(())) < 1e-3


def test_the_picture_shows_the_gradient_in_radiance() -> None:
    scene = parse_scene({**PLAIN, "lamps": {"unevenness": 0.0}})
    camera = build_camera(Mounting())
    seen = WaterView(scene, camera).temperature(0.0, 0)
    rays = camera.rays(np.array([[320.0, 480.0], [320.0, 30.0]]))
    x = -camera.centre_m[2] / rays[:, 2] * rays[:, 0] + camera.centre_m[0]
    expected = 295.0 + apparent_rise(295.0 + 1.5 * np.exp(-x / 0.8), 295.0)
    np.testing.assert_allclose(seen[[480, 30], 320], expected, atol=0.002)
    assert seen[480, 320] - seen[30, 320] > 0.4


def test_the_warm_water_moves_with_its_particles() -> None:
    scene = parse_scene({**PLAIN, "lamps": {}, "surface": {"kind": "regular", "case": "T0.791-H2/25"}})
    surface = build_surface(scene)
    view = WaterView(scene, build_camera(Mounting()))
    # After a period the water has the same shape, and stationary warmth is where it was.
    np.testing.assert_allclose(
        view.temperature(0.2, 0), view.temperature(0.2 + surface.period_s, 0), atol=2e-3
    )
    # Between crest and trough isotherms are carried to and fro by centimetres.
    middle = [view.temperature(share * surface.period_s, 0)[256, 320] for share in (0.0, 0.25, 0.5, 0.75)]
    assert np.ptp(middle) > 0.03


def test_still_water_mirrors_as_it_should() -> None:
    rays = np.array([[0.3, -0.2, -1.0]])
    zero = np.zeros(1)
    np.testing.assert_allclose(reflected(rays, zero, zero), [[0.3, -0.2, 1.0]])
    tilted = reflected(rays, np.array([0.2]), np.array([-0.1]))
    assert np.linalg.norm(tilted) == pytest.approx(np.linalg.norm(rays))
    lamps = LampSettings(height_m=0.5)
    x, y = seen_at(lamps, np.array([[1.0, 2.0, 0.0]]), np.array([[0.3, -0.2, 1.0]]))
    assert (x[0], y[0]) == (pytest.approx(1.15), pytest.approx(1.9))


def test_a_tube_fills_its_length_and_width() -> None:
    lamps = LampSettings(x_m=1.0, y_m=(0.0,), length_m=0.2, width_m=0.02)
    x, y = np.meshgrid(np.linspace(0.9, 1.1, 2001), np.linspace(-0.2, 0.2, 401))
    share = tube_share(lamps, x, y)
    assert share.sum() * 0.0001 * 0.001 == pytest.approx(0.2 * 0.02, rel=0.01)
    assert share[200, 1000] == 1.0


def test_reflections_appear_where_geometry_says() -> None:
    # The image of a lamp lies as far below still water as the lamp is above it.
    lamps = {"x_m": 0.75, "height_m": 0.45, "y_m": (0.1,), "length_m": 0.1, "rise_k": 0.0}
    camera = build_camera(Mounting(**FLAT))
    mirrored = camera.project(np.array([0.75, 0.1, -0.45]))
    lit = parse_scene({**PLAIN, "surroundings": {}, "lamps": lamps})
    dark = parse_scene({**PLAIN, "surroundings": {}})
    glare = WaterView(lit, camera).temperature(0.0, 0) - WaterView(dark, camera).temperature(0.0, 0)
    rows, columns = np.nonzero(glare > 1.0)
    weights = glare[rows, columns]
    assert np.average(columns, weights=weights) == pytest.approx(mirrored[0], abs=0.3)
    assert np.average(rows, weights=weights) == pytest.approx(mirrored[1], abs=0.3)
    angle = np.arctan2(0.75, 1.05)
    assert 0.05 < glare.max() / float(apparent_rise(700.0, 295.0)) < 0.06 + 0.02 * angle


def test_the_papers_tilt_keeps_lamps_upstream_out_of_sight_and_too_much_tilt_backwards_does_not() -> None:
    scene = parse_scene({**PLAIN, "surroundings": {}, "lamps": {}})
    straight = WaterView(scene, build_camera(Mounting())).temperature(0.0, 0)
    assert np.ptp(straight) < 1.5
    behind = {"x_m": 0.6, "azimuth_deg": 180.0}
    upright = WaterView(scene, build_camera(Mounting(tilt_deg=5.0, **behind))).temperature(0.0, 0)
    tilted = WaterView(scene, build_camera(Mounting(tilt_deg=28.0, **behind))).temperature(0.0, 0)
    assert np.ptp(upright) < 1.5
    assert np.ptp(tilted) > 30


def test_water_that_is_black_shows_no_reflections() -> None:
    scene = parse_scene({**BLACK, "lamps": {"x_m": 0.75, "rise_k": 0.0}})
    # Emissivity 1 at normal incidence; farther out it is less, but there the surroundings are as warm.
    seen = WaterView(scene, build_camera(Mounting(**FLAT))).temperature(0.0, 0)
    dark = WaterView(parse_scene(BLACK), build_camera(Mounting(**FLAT))).temperature(0.0, 0)
    np.testing.assert_allclose(dark, 295.0, atol=1e-3)
    assert (seen - dark).max() < 15


def test_cold_surroundings_make_the_water_look_colder_at_flat_angles() -> None:
    scene = parse_scene({**PLAIN, "surroundings": {"emissivity": 0.95, "ambient_k": 285.0}})
    camera = build_camera(Mounting(**FLAT))
    seen = WaterView(scene, camera).temperature(0.0, 0)
    ray = camera.rays(np.array([320.0, 10.0]))
    cosine = -ray[2] / np.linalg.norm(ray)
    from thermacq_drivers.simflume.radiance import WaterSkin

    emissivity = WaterSkin(0.95).emissivity(np.array(cosine))
    assert seen[10, 320] == pytest.approx(295 + (1 - emissivity) * apparent_rise(285.0, 295.0), abs=1e-3)
    assert seen[10, 320] < seen[500, 320]
