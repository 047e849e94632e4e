"""What the simulation knows about a recording: elevation, geometry of the cameras, clocks.

Answers the hook `thermacq_truth`, and writes a truth file beside a run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from thermacq.devices import Settings
from thermacq.hooks import Truth, TruthRequest
from thermacq_drivers.simflume.camera import CameraSettings
from thermacq_drivers.simflume.mounting import build_camera
from thermacq_drivers.simflume.optics import PinholeCamera, stereo_pose
from thermacq_drivers.simflume.probe import ProbeSettings
from thermacq_drivers.simflume.scene import build_surface
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.surfaces import Floats, Surface
from thermacq_drivers.simflume.water_facts import surface_facts


def is_simulated(scene: Settings, rig: Settings) -> bool:
    """Whether this plugin simulated a recording with such a scene and rig."""
    cameras = rig.get("cameras", {}).values()
    ours = any(camera.get("driver") == "sim-camera" for camera in cameras)
    return scene.get("simulator", "simflume") == "simflume" and (ours or bool(scene))


def truth(request: TruthRequest) -> Truth | None:
    """Answer the hook: elevation on the grid, and facts about scene and devices.

    The recording's time is taken as the scene's time. That is exact in virtual time; in real time it holds
    to the latency of the first exposure, and not at all for cameras that play a loop.
    """
    if not is_simulated(request.scene, request.rig):
        return None
    surface = build_surface(parse_scene(request.scene))
    facts: dict[str, Any] = {"surface": surface_facts(surface)}
    cameras = simulated_cameras(request.rig)
    facts["clocks"] = clock_facts(request.rig)
    pairs = {pair: calibration_facts(*stereo_pair(of_pair(cameras, pair))) for pair in pair_names(cameras)}
    if pairs:
        facts["calibration"] = next(iter(pairs.values()))
    if len(pairs) > 1:
        facts["pairs"] = pairs
    return Truth(elevation_on_grid(surface, request.time_s, request.x_m, request.y_m), facts)


def elevation_on_grid(surface: Surface, time_s: Floats, x_m: Floats, y_m: Floats) -> Floats:
    """Elevation (times, y, x) in metres."""
    return surface.elevation(x_m[None, None, :], y_m[None, :, None], time_s[:, None, None])


def simulated_cameras(rig: Settings) -> dict[str, CameraSettings]:
    """Settings of the simulated cameras of a resolved rig, by name."""
    return {
        name: CameraSettings.model_validate(table.get("settings", {}))
        for name, table in rig.get("cameras", {}).items()
        if table.get("driver") == "sim-camera"
    }


def pair_names(cameras: Mapping[str, CameraSettings]) -> list[str]:
    """Names of the pairs that have a left and a right camera, in the order of the rig."""
    names = dict.fromkeys(camera.pair for camera in cameras.values())
    both = {"left", "right"}
    return [name for name in names if {camera.side for camera in of_pair(cameras, name).values()} == both]


def of_pair(cameras: Mapping[str, CameraSettings], pair: str) -> dict[str, CameraSettings]:
    """The cameras of one pair."""
    return {name: camera for name, camera in cameras.items() if camera.pair == pair}


def stereo_pair(cameras: Mapping[str, CameraSettings]) -> tuple[PinholeCamera, PinholeCamera]:
    """The left and the right camera as they really stand."""
    by_side = {camera.side: camera for camera in cameras.values()}
    return build_camera(by_side["left"]), build_camera(by_side["right"])


def calibration_facts(left: PinholeCamera, right: PinholeCamera) -> dict[str, Any]:
    """True stereo calibration in OpenCV's conventions (x_right = R x_left + T), and the left camera's pose."""
    rotation, translation = stereo_pose(left, right)
    models = {
        side: {"matrix": camera.matrix.tolist(), "distortion": camera.distortion.tolist()}
        for side, camera in (("left", left), ("right", right))
    }
    return {
        "image_size": [left.columns, left.rows],
        **models,
        "rotation": rotation.tolist(),
        "translation_m": translation.tolist(),
        "baseline_m": float(np.linalg.norm(translation)),
        "left_camera_to_world": {
            "rotation": left.rotation.T.tolist(),
            "translation_m": left.centre_m.tolist(),
        },
    }


def clock_facts(rig: Settings) -> dict[str, Any]:
    """Offset and drift of each simulated device's clock against the time of the scene."""
    clocks = {name: settings.clock for name, settings in simulated_cameras(rig).items()}
    for name, table in rig.get("probes", {}).items():
        if table.get("driver") == "sim-probe":
            clocks[name] = ProbeSettings.model_validate(table.get("settings", {})).clock
    return {name: clock.model_dump() for name, clock in clocks.items()}
