"""Writes the truth of a simulated run into a NetCDF-4 file beside it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermacq.devices import FrameFlag
from thermacq.errors import StoreError, ThermacqError
from thermacq.timing import NS_PER_S
from thermacq_drivers.simflume import truth
from thermacq_drivers.simflume.camera import CameraSettings, in_condition
from thermacq_drivers.simflume.camera_truth import Exposures, append_camera_truth
from thermacq_drivers.simflume.correspondence import correspondence
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.scene import WaterView, build_surface
from thermacq_drivers.simflume.settings import SceneSettings, parse_scene
from thermacq_drivers.simflume.sight import build_sight
from thermacq_drivers.simflume.surfaces import Floats, Surface
from thermacq_drivers.simflume.water_facts import surface_facts

if TYPE_CHECKING:
    from thermacq.store import FrameTable, RunFile

_BLOCK_FRAMES = 64


def write_truth(
    run_path: Path, output: Path, spacing_m: float, dense_frames: Sequence[int], pair: str | None = None
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
        Frames of the left camera for which depth and correspondence of every pixel of either camera are written.
    pair
        Name of the pair of cameras, where the rig has several; None: the first.

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
        scene = parse_scene(rig.get("scene", {}))
        cameras = {
            name: in_condition(camera, scene.camera) for name, camera in truth.simulated_cameras(rig).items()
        }
        cameras = _chosen_pair(run_path, cameras, pair)
        if scene.view != "water" and dense_frames:
            raise ThermacqError(f"'{run_path}' shows the {scene.view}, not the water")
        name = next(name for name, camera in cameras.items() if camera.side == "left")
        frames = run.frames(name)
        time_s = exposure_times(frames, name, cameras[name], rig)
        wrong = [frame for frame in dense_frames if not 0 <= frame < len(frames)]
        if wrong:
            raise ThermacqError(f"camera '{name}' has no frame {wrong[0]}: it has {len(frames)}")
        surface = build_surface(scene)
        left, right = truth.stereo_pair(cameras)
        facts = {
            "surface": surface_facts(surface) if scene.view == "water" else {"kind": scene.view},
            "calibration": truth.calibration_facts(left, right),
            "clocks": truth.clock_facts(rig),
        }
        attributes = _attributes(run, name, facts)
        exposures = {each: _exposures(run.frames(each), each, cameras[each], rig) for each in cameras}
        recording_s = (frames.host_ns - run.header.host_anchor_ns) / NS_PER_S
    grid = common_view(left, right, spacing_m) if scene.view == "water" else None
    _write(output, attributes, surface, (time_s, recording_s), grid)
    append_camera_truth(output, scene, cameras, exposures)
    lines_s = {camera.side: camera.bolometer.line_time_s for camera in cameras.values()}
    _append_dense(output, scene, (left, right), (lines_s["left"], lines_s["right"]), time_s, dense_frames)
    return facts


def _chosen_pair(
    run_path: Path, cameras: dict[str, CameraSettings], pair: str | None
) -> dict[str, CameraSettings]:
    """Cameras of the pair asked for, or of the first one."""
    names = truth.pair_names(cameras)
    if not names:
        raise ThermacqError(
            f"'{run_path}' was not recorded with a left and a right camera of the simulated flume",
            remedy="Truth exists only for runs whose cameras have the driver 'sim-camera'.",
        )
    if pair is not None and pair not in names:
        raise ThermacqError(f"'{run_path}' has no pair '{pair}'", remedy=f"It has: {', '.join(names)}.")
    return truth.of_pair(cameras, names[0] if pair is None else pair)


def exposure_times(frames: FrameTable, name: str, camera: CameraSettings, rig: dict[str, Any]) -> Floats:
    """Time of the scene at each exposure, from the camera's own clock less its jitter: (frames,) seconds."""
    number = frames.sequence_number - camera.counter_start
    if camera.cached_loop_frames:
        return np.asarray(number % camera.cached_loop_frames / rig["trigger"]["frame_rate_hz"], np.float64)
    clock, seed = camera.clock, parse_scene(rig.get("scene", {})).seed
    jitter_s = [float(clock.drawn_jitter_s(seed, name, int(each))[0]) for each in number]
    return np.asarray(clock.scene_s(frames.ticks / clock.tick_rate_hz - np.array(jitter_s)), np.float64)


def _exposures(frames: FrameTable, name: str, camera: CameraSettings, rig: dict[str, Any]) -> Exposures:
    number = frames.sequence_number - camera.counter_start
    if camera.cached_loop_frames:
        index = number % camera.cached_loop_frames
    else:
        index = np.where(frames.trigger_index >= 0, frames.trigger_index, number)
    time_s = exposure_times(frames, name, camera, rig)
    frozen = (frames.flags & int(FrameFlag.SHUTTER)) != 0
    return Exposures(index, np.where(frozen, np.nan, time_s))


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
    output: Path,
    attributes: dict[str, str],
    surface: Surface,
    times: tuple[Floats, Floats],
    grid: tuple[Floats, Floats] | None,
) -> None:
    """Make the file; elevation only on a grid, that is where water is in view."""
    import h5netcdf

    time_s, recording_s = times
    described = [
        ("time", "time", time_s, "s", "time of the scene at the exposure"),
        ("recording_time", "time", recording_s, "s", "time of the recording when the frame arrived"),
    ]
    if grid is not None:
        described.append(("x", "x", grid[0], "m", "along the flume"))
        described.append(("y", "y", grid[1], "m", "across the flume"))
    try:
        with h5netcdf.File(output, "w") as file:
            file.attrs.update(attributes)
            for name, dimension, values, unit, meaning in described:
                if dimension not in file.dimensions:
                    file.dimensions[dimension] = len(values)
                variable = file.create_variable(name, (dimension,), data=values)
                variable.attrs.update({"units": unit, "long_name": meaning})
            if grid is not None:
                _write_elevation(file, surface, time_s, *grid)
    except OSError as error:
        raise StoreError(f"'{output}' cannot be written: {error}") from None


def _write_elevation(file: Any, surface: Surface, time_s: Floats, x_m: Floats, y_m: Floats) -> None:
    chunks = (1, len(y_m), len(x_m))
    eta = file.create_variable("eta", ("time", "y", "x"), np.float64, chunks=chunks, compression="gzip")
    eta.attrs.update({"units": "m", "long_name": "true elevation above still water"})
    for start in range(0, len(time_s), _BLOCK_FRAMES):
        block = slice(start, start + _BLOCK_FRAMES)
        eta[block] = truth.elevation_on_grid(surface, time_s[block], x_m, y_m)


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
    cameras: tuple[PinholeCamera, PinholeCamera],
    line_times_s: tuple[float, float],
    time_s: Floats,
    dense_frames: Sequence[int],
) -> None:
    """Append variables ``left_...`` and ``right_...`` of `_DENSE`: truth of each pixel of either picture."""
    import h5netcdf

    if not dense_frames:
        return
    surface = build_surface(scene)
    left, right = cameras
    with h5netcdf.File(output, "a") as file:
        file.dimensions["dense_frame"] = len(dense_frames)
        file.dimensions["row"], file.dimensions["column"] = left.rows, left.columns
        file.create_variable("dense_frame", ("dense_frame",), data=np.array(dense_frames))
        sides = ("left", left, right, line_times_s[0]), ("right", right, left, line_times_s[1])
        for side, camera, other, line_time_s in sides:
            sight = build_sight(scene, surface, camera, line_time_s)
            view = WaterView(scene, camera, line_time_s)
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
