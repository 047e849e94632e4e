from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.ndimage import map_coordinates

from thermacq.errors import RigError
from thermacq_drivers.simflume.correspondence import correspondence
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.scene import WaterView, build_surface
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.sight import build_sight

LASTING = {"texture": {"lifetime_s": 1e9}}


def at(picture: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Quintic interpolation of a picture at (..., 2) (column, row)."""
    return map_coordinates(
        picture.astype(np.float64), [pixels[..., 1], pixels[..., 0]], order=5, mode="mirror"
    )


@pytest.mark.parametrize("case", ["T0.553-H1/10", "T0.791-H2/25", "still"])
def test_true_disparity_warps_the_right_picture_onto_the_left(case: str) -> None:
    surface = {"kind": "still"} if case == "still" else {"kind": "regular", "case": case}
    scene = parse_scene({"surface": surface})
    left, right = (build_camera(Mounting(side=side)) for side in ("left", "right"))
    time_s = 0.313
    seen_left = WaterView(scene, left).temperature(time_s, 0)
    seen_right = WaterView(scene, right).temperature(time_s, 0)
    truth = correspondence(build_sight(scene, build_surface(scene), left), right, time_s)
    columns, rows = truth.column_px, truth.row_px
    inside = (columns > 5) & (columns < 634) & (rows > 5) & (rows < 506)
    assert inside.mean() > 0.85
    warped = at(seen_right, np.stack([columns, rows], axis=-1))
    slope = at(seen_right, np.stack([columns + 0.5, rows], axis=-1)) - at(
        seen_right, np.stack([columns - 0.5, rows], axis=-1)
    )
    residual = (seen_left - warped)[inside]
    assert residual.std() < 0.003  # of 0.3 K
    shift_px = (residual @ slope[inside]) / (slope[inside] @ slope[inside])
    assert abs(shift_px) < 0.001
    assert 60 < truth.disparity_px.mean() < 75


def test_the_texture_moves_with_the_water() -> None:
    scene = parse_scene({"surface": {"kind": "regular", "case": "T0.791-H2/25"}, **LASTING})
    surface = build_surface(scene)
    camera = build_camera(Mounting(side="left"))
    view = WaterView(scene, camera)
    random = np.random.default_rng(4)
    x, y = random.uniform(0.15, 0.4, 300), random.uniform(-0.2, 0.2, 300)
    path = solve_ivp(lambda t, x: surface.velocity(x, y, t)[0], (0, 0.5), x, rtol=1e-9, atol=1e-11)

    def temperature(x: np.ndarray, time_s: float) -> np.ndarray:
        pixels = camera.project(np.stack([x, y, surface.elevation(x, y, time_s)], axis=-1))
        return at(view.temperature(time_s, 0), pixels)

    begun, ended = temperature(x, 0.0), temperature(path.y[:, -1], 0.5)
    np.testing.assert_allclose(ended, begun, atol=0.01)
    # Were it painted on the picture or on the still water, the water would have moved from under it.
    assert np.std(temperature(x, 0.5) - begun) > 0.1


def test_still_water_keeps_its_texture_in_place() -> None:
    view = WaterView(parse_scene(LASTING), build_camera(Mounting()))
    np.testing.assert_allclose(view.temperature(0.0, 0), view.temperature(7.0, 350), atol=1e-4)


def test_two_cameras_see_the_same_water_at_the_same_temperature() -> None:
    scene = parse_scene({"surface": {"kind": "regular", "case": "T0.949-H2/25"}})
    surface = build_surface(scene)
    place = np.array([[0.2, -0.03], [0.3, 0.05], [0.42, -0.1]])
    z = surface.elevation(place[:, 0], place[:, 1], 1.7)
    seen = []
    for side in ("left", "right"):
        camera = build_camera(Mounting(side=side))
        seen.append(
            at(WaterView(scene, camera).temperature(1.7, 0), camera.project(np.column_stack([place, z])))
        )
    np.testing.assert_allclose(seen[0], seen[1], atol=0.003)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sead": 1}, "unknown key 'sead'; did you mean 'seed'?"),
        ({"texture": {"rms": 1}}, "did you mean 'rms_k'?"),
        ({"texture": {"rms_k": 0}}, "has no texture"),
        ({"surface": {"kind": "regular", "case": "T9"}}, "no case 'T9' in Table II"),
        ({"surface": {"kind": "regular", "period_s": 0.8, "steepness": 0.2}}, "too high"),
        ({"surface": {"kind": "regular", "period_s": 0.8}}, "period_s and steepness"),
        ({"surface": {"kind": "regular", "case": "T0.791-H2/25", "period_s": 1.0}}, "not both"),
        ({"surface": {"kind": "tsunami"}}, "tsunami"),
        ({"seed": -1}, "greater than or equal to 0"),
        ({"simulator": "other"}, "simflume"),
        ({"texture": {"lengths_m": [0.0001]}}, "2 mm"),
        ({"chessboard": {"nearest_m": 0.9, "farthest_m": 0.5}}, "nearest_m"),
    ],
)
def test_impossible_scenes_are_explained(values: dict[str, Any], message: str) -> None:
    with pytest.raises(RigError) as caught:
        parse_scene(values)
    assert message in str(caught.value)


def test_an_empty_scene_is_still_water() -> None:
    assert parse_scene({}).surface.kind == "still"


def test_a_wave_can_be_given_by_period_and_steepness() -> None:
    scene = parse_scene({"surface": {"kind": "regular", "period_s": 0.7, "steepness": 0.05, "phase_deg": 90}})
    surface = build_surface(scene)
    zero = np.zeros(1)
    # A quarter period before the crest the water stands near still level at the origin.
    assert abs(surface.elevation(zero, zero, 0.0)[0]) < 0.3 * surface.highest_m
    assert surface.elevation(zero, zero, 0.7 / 4)[0] == pytest.approx(surface.highest_m, rel=1e-6)
    assert surface.phase_rad == pytest.approx(math.pi / 2)
