from __future__ import annotations

import dataclasses
import tomllib

import numpy as np
import pytest

from thermacq_drivers.simflume import validation_geometry
from thermacq_drivers.simflume.correspondence import correspondence
from thermacq_drivers.simflume.ready_made import scene_toml
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.validation_geometry import (
    left_and_right,
    occlusion_checks,
    projection_checks,
    ray_check,
    sight_pairs,
    warp_checks,
    warped_deviations,
    water_scenes,
)
from thermacq_drivers.simflume.validation_water import failed


def test_points_are_projected_as_opencv_does() -> None:
    checks = projection_checks()
    assert len(checks) == 2
    assert failed(checks) == []


@pytest.mark.slow
def test_rays_meet_the_water_of_every_scene() -> None:
    names = water_scenes()
    assert {"still", "two-pairs", "irregular-sea", "T1.186-H1/16"} < set(names)
    assert not {"chessboard", "blackbody"} & set(names)
    assert failed([ray_check(name) for name in names]) == []


def test_a_ray_that_ends_beside_the_water_would_be_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    level = validation_geometry._water_level
    monkeypatch.setattr(validation_geometry, "_water_level", lambda *given: level(*given) + 1e-5)
    assert ray_check("still").found > 0.001


@pytest.mark.slow
def test_true_disparity_warps_one_picture_into_the_other() -> None:
    checks = warp_checks()
    assert len(checks) == 4
    assert failed(checks) == []
    assert warped_deviations({}, [0.1])[0] > 5 * checks[0].tolerance


@pytest.mark.slow
def test_occlusion_agrees_between_left_and_right() -> None:
    checks = occlusion_checks()
    assert len(checks) == 4
    assert failed(checks) == []


@pytest.mark.slow
def test_wrong_occlusion_would_be_noticed() -> None:
    settings = parse_scene(tomllib.loads(scene_toml("two-pairs")))
    left, right = next(sight_pairs(settings, "two-pairs"))
    there, back = correspondence(left, right.camera, 0.0), correspondence(right, left.camera, 0.0)
    blind = dataclasses.replace(there, occluded=np.zeros_like(there.occluded))
    assert left_and_right(there, back, left, right)[1] < 0.5
    assert left_and_right(blind, back, left, right)[1] > 50
