"""The rig with two pairs of cameras around a cylinder, and the scenes of heat and radiance."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thermacq.hooks import TruthRequest
from thermacq.plugins import plugins
from thermacq.rig import parse_rig
from thermacq_drivers.simflume import truth
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.ready_made import scene_toml
from thermacq_drivers.simflume.scene import build_view, check_scene
from thermacq_drivers.simflume.settings import parse_scene

ROOT = Path(__file__).resolve().parents[3]
SCENES = ("paper-wave", "paper-cylinder", "poor-texture", "lamp-reflection", "two-pairs")


def scene(name: str) -> dict[str, Any]:
    return tomllib.loads(scene_toml(name))


def rig_text() -> str:
    return resources.files("thermacq_drivers.simflume").joinpath("two_pairs.toml").read_text()


def test_the_example_is_the_ready_rig() -> None:
    assert (ROOT / "examples" / "two_pairs.toml").read_text() == rig_text()


def test_rig_checks_look_at_each_pair() -> None:
    def findings(old: str, new: str) -> str:
        text = rig_text()
        assert old in text
        return "; ".join(f.message for f in plugins().rig_checks(parse_rig(text.replace(old, new))))

    assert findings("[clock]", "[clock]") == ""
    assert "there are 4 simulated cameras of pair 'upstream'" in findings('"downstream"', '"upstream"')
    behind = '[cameras.right_behind.settings]\npair = "downstream"\nside = '
    assert "both simulated cameras of pair 'downstream' are on the left side" in findings(
        f'{behind}"right"', f'{behind}"left"'
    )


def test_truth_knows_both_pairs() -> None:
    rig = parse_rig(rig_text()).model_dump(mode="json")
    cameras = truth.simulated_cameras(rig)
    assert truth.pair_names(cameras) == ["upstream", "downstream"]
    nothing = np.zeros(1)
    found = plugins().truth(TruthRequest({}, nothing, nothing, nothing, rig))
    assert found is not None
    pairs = found.facts["pairs"]
    assert found.facts["calibration"] == pairs["upstream"]
    # Cameras of both pairs give one point of the world the same coordinates.
    point = np.array([0.42, -0.03, 0.05])
    for name in pairs:
        left, _ = truth.stereo_pair(truth.of_pair(cameras, name))
        pose = pairs[name]["left_camera_to_world"]
        in_camera = left.rotation @ (point - left.centre_m)
        assert in_camera[2] > 0
        np.testing.assert_allclose(np.array(pose["rotation"]) @ in_camera + pose["translation_m"], point)


@pytest.mark.parametrize("name", SCENES)
def test_ready_scenes_can_be_seen(name: str, small: dict[str, Any]) -> None:
    settings = parse_scene(scene(name))
    mountings = [Mounting(**small)]
    if name == "two-pairs":
        mountings.append(Mounting(x_m=0.84, y_m=-0.06, azimuth_deg=180.0, **small))
    for mounting in mountings:
        check_scene(settings, mounting)
        seen = build_view(settings, mounting).temperature(0.4, 0)
        assert np.isfinite(seen).all()
        # The lamps are mirrored where they are meant to be; elsewhere there are a few glints at most.
        assert (np.mean(seen > 310) > 0.001) == (name == "lamp-reflection")


def test_textures_are_rich_and_poor_as_their_scenes_say(small: dict[str, Any]) -> None:
    def fine_contrast(name: str) -> float:
        seen = build_view(parse_scene(scene(name)), Mounting(**small)).temperature(0.4, 0)[40:120, 20:140]
        return float(np.std(np.diff(seen, axis=1)))

    rich, poor = fine_contrast("paper-wave"), fine_contrast("poor-texture")
    netd_k = 0.035
    assert rich > 3 * netd_k
    assert poor < netd_k


def test_images_of_the_second_pair_run_along_y() -> None:
    left, right = (build_camera(Mounting(azimuth_deg=180.0, side=side)) for side in ("left", "right"))
    point = np.array([-0.2, 0.05, 0.0])
    disparity = left.project(point)[0] - right.project(point)[0]
    assert 50 < disparity < 90
