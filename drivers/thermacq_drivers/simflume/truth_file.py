"""Writes the truth of a simulated run into a NetCDF-4 file beside it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermacq.errors import StoreError, ThermacqError
from thermacq.timing import NS_PER_S
from thermacq_drivers.simflume import truth
from thermacq_drivers.simflume.correspondence import correspondence
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.scene import WaterView, build_surface
from thermacq_drivers.simflume.settings import SceneSettings, parse_scene
from thermacq_drivers.simflume.sight import build_sight
from thermacq_drivers.simflume.surfaces import Floats, Surface
from thermacq_drivers.simflume.water_facts import surface_facts

if TYPE_CHECKING:
    from thermacq.store import FrameTable, RunFile
    from thermacq_drivers.simflume.camera import CameraSettings

_BLOCK_FRAMES = 64


def write_truth(
    run_path: Path, output: Path, spacing_m: float, dense_frames: Sequence[int]
) -> dict[str, Any]:
    """Write elevation at every exposure of the left camera, and dense truth for some frames.

    Parameters
    ----------
    run_path
        A run of the simulated flume.
    output
        NetCDF-4 file to make.
    spacing_m
        Spacing of the elevation grid, which covers what both cameras see of the still water.
    dense_frames
        Frames of the left camera for which depth and correspondence of every pixel are written, for either camera.

    Returns
    -------
    dict
        The facts that stand in the file's attribute ``facts``.

    Raises
    ------
    ThermacqError
        The run is not one of the simulated flume, has no such frame, or the output cannot be written.
    """
    from thermacq.store import open_run

    if output.exists():
        raise StoreError(f"'{output}' exists", remedy="Choose another name, or remove it first.")
    with open_run(run_path) as run:
        rig = run.header.rig
        cameras = truth.simulated_cameras(rig)
        if {camera.side for camera in cameras.values()} != {"left", "right"}:
            raise ThermacqError(
                f"'{run_path}' was not recorded with a left and a right camera of the simulated flume",
                remedy="Truth exists only for runs whose cameras have the driver 'sim-camera'.",
            )
        scene = parse_scene(rig.get("scene", {}))
        if scene.view != "water":
            raise ThermacqError(f"'{run_path}' shows the {scene.view}, not the water")
        name = next(name for name, camera in cameras.items() if camera.side == "left")
        frames = run.frames(name)
        time_s = exposure_times(frames, cameras[name], rig["trigger"]["frame_rate_hz"])
        wrong = [frame for frame in dense_frames if not 0 <= frame < len(frames)]
        if wrong:
            raise ThermacqError(f"camera '{name}' has no frame {wrong[0]}: it has {len(frames)}")
        surface = build_surface(scene)
        left, right = truth.stereo_pair(cameras)
        facts = {
            "surface": surface_facts(surface),
            "calibration": truth.calibration_facts(left, right),
            "clocks": truth.clock_facts(rig),
        }
        attributes = _attributes(run, name, facts)
        recording_s = (frames.host_ns - run.header.host_anchor_ns) / NS_PER_S
    x_m, y_m = common_view(left, right, spacing_m)
    _write(output, attributes, surface, (time_s, recording_s, x_m, y_m))
    _append_dense(output, scene, left, right, time_s, dense_frames)
    return facts


def exposure_times(frames: FrameTable, camera: CameraSettings, frame_rate_hz: float) -> Floats:
    """Time of the scene at each exposure, from the camera's own clock: (frames,) seconds."""
    if camera.cached_loop_frames:
        number = frames.sequence_number - camera.counter_start
        return (number % camera.cached_loop_frames) / frame_rate_hz
    return np.asarray(camera.clock.scene_s(frames.ticks / camera.clock.tick_rate_hz), np.float64)


def common_view(left: PinholeCamera, right: PinholeCamera, spacing_m: float) -> tuple[Floats, Floats]:
    """Grid axes (x, y) over what both cameras see of the still water, on multiples of the spacing."""
    lowest, highest = np.full(2, -np.inf), np.full(2, np.inf)
    for camera in (left, right):
        rows, columns = camera.rows - 1.0, camera.columns - 1.0
        corners = np.array([[0, 0], [columns, 0], [0, rows], [columns, rows], [columns / 2, 0]])
        rays = camera.rays(corners)
        places = camera.centre_m[:2] - rays[:, :2] * (camera.centre_m[2] / rays[:, 2])[:, None]
        lowest, highest = np.maximum(lowest, places.min(axis=0)), np.minimum(highest, places.max(axis=0))
    first, last = np.ceil(lowest / spacing_m), np.floor(highest / spacing_m)
    x, y = (np.arange(a, b + 1) * spacing_m for a, b in zip(first, last, strict=True))
    return x, y


def _attributes(run: RunFile, camera: str, facts: dict[str, Any]) -> dict[str, str]:
    return {
        "Conventions": "CF-1.11",
        "title": "truth of a simulated run",
        "simulated": "true",
        "run_id": run.header.run_id,
        "run_sha256": run.sha256() if run.complete else "",
        "camera": camera,
        "world_frame": "origin on still water, X along the flume, Y across, Z up",
        "facts": json.dumps(facts),
    }


def _write(
    output: Path, attributes: dict[str, str], surface: Surface, axes: tuple[Floats, Floats, Floats, Floats]
) -> None:
    import h5netcdf

    time_s, recording_s, x_m, y_m = axes
    described = (
        ("time", "time", time_s, "s", "time of the scene at the exposure"),
        ("recording_time", "time", recording_s, "s", "time of the recording when the frame arrived"),
        ("x", "x", x_m, "m", "along the flume"),
        ("y", "y", y_m, "m", "across the flume"),
    )
    try:
        with h5netcdf.File(output, "w") as file:
            file.attrs.update(attributes)
            file.dimensions = {"time": len(time_s), "y": len(y_m), "x": len(x_m)}
            for name, dimension, values, unit, meaning in described:
                variable = file.create_variable(name, (dimension,), data=values)
                variable.attrs.update({"units": unit, "long_name": meaning})
            eta = file.create_variable(
                "eta", ("time", "y", "x"), np.float64, chunks=(1, len(y_m), len(x_m)), compression="gzip"
            )
            eta.attrs.update({"units": "m", "long_name": "true elevation above still water"})
            for start in range(0, len(time_s), _BLOCK_FRAMES):
                block = slice(start, start + _BLOCK_FRAMES)
                eta[block] = truth.elevation_on_grid(surface, time_s[block], x_m, y_m)
    except OSError as error:
        raise StoreError(f"'{output}' cannot be written: {error}") from None


_DENSE = {
    "depth": ("m", "depth along the optical axis of the camera"),
    "column": ("px", "column of the same thing in the other picture, as delivered"),
    "row": ("px", "row of the same thing in the other picture, as delivered"),
    "seen": ("1", "1: water, 2: cylinder"),
    "occluded": ("1", "1: within the other camera's field of view, but hidden from it"),
    "outside": ("1", "1: not within the other camera's field of view"),
    "temperature": ("K", "apparent temperature, linear in radiance, before optics and sensor"),
}


def _append_dense(
    output: Path,
    scene: SceneSettings,
    left: PinholeCamera,
    right: PinholeCamera,
    time_s: Floats,
    dense_frames: Sequence[int],
) -> None:
    """Append variables ``left_...`` and ``right_...`` of `_DENSE`: truth of each pixel of either picture."""
    import h5netcdf

    if not dense_frames:
        return
    surface = build_surface(scene)
    with h5netcdf.File(output, "a") as file:
        file.dimensions["dense_frame"] = len(dense_frames)
        file.dimensions["row"], file.dimensions["column"] = left.rows, left.columns
        file.create_variable("dense_frame", ("dense_frame",), data=np.array(dense_frames))
        for side, camera, other in (("left", left, right), ("right", right, left)):
            sight, view = build_sight(scene, surface, camera), WaterView(scene, camera)
            moments = [float(time_s[frame]) for frame in dense_frames]
            for place, moment in enumerate(moments):
                found = correspondence(sight, other, moment)
                values: dict[str, np.ndarray] = {
                    "depth": found.depth_m,
                    "column": found.column_px,
                    "row": found.row_px,
                    "seen": found.seen,
                    "occluded": found.occluded.astype(np.uint8),
                    "outside": found.outside.astype(np.uint8),
                    "temperature": view.temperature(moment, dense_frames[place]),
                }
                for name, array in values.items():
                    _dense_variable(file, f"{side}_{name}", array)[place] = array


def _dense_variable(file: Any, name: str, like: np.ndarray) -> Any:
    """The variable of this name, made like an array for one frame when it is not there yet."""
    if name not in file.variables:
        dimensions = ("dense_frame", "row", "column")
        chunks = (1, *like.shape)
        made = file.create_variable(name, dimensions, like.dtype, chunks=chunks, compression="gzip")
        unit, meaning = _DENSE[name.split("_", 1)[1]]
        made.attrs.update({"units": unit, "long_name": meaning})
    return file.variables[name]
