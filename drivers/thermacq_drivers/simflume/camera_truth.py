"""Truth about the cameras of a run: bad pixels by reason, fixed patterns, and corners of the chessboard."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermacq_drivers.simflume.bad_pixels import KINDS
from thermacq_drivers.simflume.camera import CameraSettings, make_sensor
from thermacq_drivers.simflume.chessboard import BoardPose, board_pose, hand_shake, true_corners
from thermacq_drivers.simflume.mounting import build_camera, nominal_pair
from thermacq_drivers.simflume.settings import SceneSettings
from thermacq_drivers.simflume.surfaces import Floats

_ROW_STEPS = 3


@dataclass(frozen=True, eq=False)
class Exposures:
    """The frames of one camera: numbers by which the scene was drawn, and times; NaN where it was frozen."""

    index: np.ndarray
    time_s: Floats


def corners_seen(scene: SceneSettings, camera: CameraSettings, index: int, time_s: float) -> Floats:
    """Corners of the board in a frame, each when its row is read out: (corners, 2) pixels (column, row).

    The time constant is left out: the picture of a moving board is late by it.
    """
    board, eye = scene.chessboard, build_camera(camera)
    view = index // board.frames_per_view
    pose = board_pose(board, scene.seed, view, nominal_pair(camera))
    read_s = np.full((board.rows * board.columns,), time_s)
    for _ in range(_ROW_STEPS):
        moved_m = hand_shake(board, scene.seed, view, read_s)
        corners = true_corners(board, BoardPose(pose.rotation, pose.origin_m + moved_m), eye)
        read_s = time_s + camera.bolometer.line_time_s * corners[:, 1]
    return corners


def append_camera_truth(
    output: Path, scene: SceneSettings, cameras: dict[str, CameraSettings], frames: dict[str, Exposures]
) -> None:
    """Append what is known of each camera to a truth file.

    Variables of camera NAME: ``NAME_bad_pixels`` (bits as its attribute ``flag_meanings`` says),
    ``NAME_gain``, ``NAME_offset``, and for views of the chessboard ``NAME_corners``.
    """
    import h5netcdf

    with h5netcdf.File(output, "a") as file:
        for name, camera in cameras.items():
            sensor = make_sensor(camera, scene, name)
            rows, columns = f"{name}_row", f"{name}_column"
            file.dimensions[rows], file.dimensions[columns] = camera.rows, camera.columns
            bad = sensor.bad.map(camera.rows, camera.columns)
            variable = file.create_variable(
                f"{name}_bad_pixels", (rows, columns), data=bad, compression="gzip"
            )
            variable.attrs["flag_masks"] = np.array(KINDS, np.uint8)
            variable.attrs["flag_meanings"] = " ".join(str(kind.name).lower() for kind in KINDS)
            for what, unit, values in (
                ("gain", "counts K-1", sensor.gain),
                ("offset", "counts", sensor.offset),
            ):
                variable = file.create_variable(
                    f"{name}_{what}", (rows, columns), data=values, compression="gzip"
                )
                variable.attrs.update({"units": unit, "long_name": f"true {what} of each pixel"})
            if scene.view == "chessboard":
                _write_corners(file, name, scene, camera, frames[name])


def _write_corners(
    file: object, name: str, scene: SceneSettings, camera: CameraSettings, frames: Exposures
) -> None:
    import h5netcdf

    assert isinstance(file, h5netcdf.File)
    count = scene.chessboard.rows * scene.chessboard.columns
    corners = np.full((len(frames.index), count, 2), np.nan)
    for frame, (index, time_s) in enumerate(zip(frames.index, frames.time_s, strict=True)):
        if np.isfinite(time_s):
            corners[frame] = corners_seen(scene, camera, int(index), float(time_s))
    file.dimensions[f"{name}_frame"] = len(corners)
    for dimension, size in (("corner", count), ("axis", 2)):
        if dimension not in file.dimensions:
            file.dimensions[dimension] = size
    variable = file.create_variable(f"{name}_corners", (f"{name}_frame", "corner", "axis"), data=corners)
    variable.attrs.update({"units": "px", "long_name": "column and row of the inner corners, as delivered"})
