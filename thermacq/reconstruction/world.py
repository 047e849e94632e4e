"""The world frame: origin on the still water, Z up, X along the flume, right-handed.

``X_world = rotation @ X_camera + translation_m``, where the camera is the left rectified one.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.plane import Plane, plane_covariance
from thermacq.rig import WorldTable

_KIND = "thermacq world frame"
_PICTURE_DIRECTIONS = {
    "right": (1.0, 0.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "up": (0.0, -1.0, 0.0),
    "down": (0.0, 1.0, 0.0),
}


@dataclass(frozen=True)
class WorldFrame:
    """Where the left rectified camera stands above the still water.

    Parameters
    ----------
    rotation
        (3, 3) float64, camera to world.
    translation_m
        (3,) float64: world coordinates of the camera.
    sigma_m
        Standard deviation of single-frame points from the plane, the figure of the paper's Fig. 11.
    sigma_mean_m
        Standard deviation of the time-averaged surface from the plane: what averaging cannot remove.
    covariance
        (3, 3) float64: of height at the foot of the camera (m), and slopes along X and Y.
    points
        Number of points that the plane was fitted to.
    frames
        Number of pairs that were averaged.
    source
        Where it came from: run and calibration hashes, matcher, and how (``still water`` or ``mean surface``);
        how the direction of X was found, or to which other frame this one was joined.
    x_axis_u_deg
        Standard uncertainty of the direction of X; None where the rig's ``[world]`` table set it.
    """

    rotation: NDArray[np.float64]
    translation_m: NDArray[np.float64]
    sigma_m: float
    sigma_mean_m: float
    covariance: NDArray[np.float64]
    points: int
    frames: int
    source: dict[str, Any] = field(default_factory=dict)
    x_axis_u_deg: float | None = None

    @property
    def camera_height_m(self) -> float:
        """Height of the left camera above the still water."""
        return float(self.translation_m[2])

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis of the rectified camera and the downward vertical."""
        return float(np.degrees(np.arccos(np.clip(-self.rotation[2, 2], -1.0, 1.0))))

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """World coordinates of camera points (..., 3), metres."""
        world: NDArray[np.float64] = points @ self.rotation.T + self.translation_m
        return world

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        values = asdict(self)
        for name in ("rotation", "translation_m", "covariance"):
            values[name] = values[name].tolist()
        return {"kind": _KIND, "version": 1, **values}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> WorldFrame:
        """Inverse of `to_dict`; raises `ReconstructionError` for anything that is no rigid world frame."""
        try:
            if values["kind"] != _KIND:
                message = f"its kind is '{values['kind']}'"
                raise ValueError(message)
            frame = cls(
                rotation=np.array(values["rotation"], np.float64).reshape(3, 3),
                translation_m=np.array(values["translation_m"], np.float64).reshape(3),
                sigma_m=float(values["sigma_m"]),
                sigma_mean_m=float(values["sigma_mean_m"]),
                covariance=np.array(values["covariance"], np.float64).reshape(3, 3),
                points=int(values["points"]),
                frames=int(values["frames"]),
                source=dict(values["source"]),
                x_axis_u_deg=None if values.get("x_axis_u_deg") is None else float(values["x_axis_u_deg"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ReconstructionError(
                f"this is no world frame: {type(error).__name__}: {error}",
                remedy="Make one with `thermacq still-water`.",
            ) from None
        rigid = np.allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-6)
        if not (rigid and np.linalg.det(frame.rotation) > 0 and np.isfinite(frame.translation_m).all()):
            raise ReconstructionError("this is no world frame: its rotation is not a rotation")
        return frame

    def save(self, path: Path) -> None:
        """Write the frame as JSON; raises `ReconstructionError` when the path exists or cannot be written."""
        try:
            with path.open("x", encoding="utf-8") as file:
                json.dump(self.to_dict(), file, indent=2)
                file.write("\n")
        except FileExistsError:
            raise ReconstructionError(f"'{path}' exists", remedy="Choose another name.") from None
        except OSError as error:
            raise ReconstructionError(f"'{path}' cannot be written: {error.strerror}") from None


def load_world_frame(path: Path) -> WorldFrame:
    """Read a world frame; raises `ReconstructionError` for a missing, foreign or malformed file."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ReconstructionError(
            f"there is no file '{path}'", remedy="Make it with `thermacq still-water`."
        ) from None
    except (OSError, ValueError) as error:
        raise ReconstructionError(f"'{path}' cannot be read as a world frame: {error}") from None
    if not isinstance(values, dict):
        raise ReconstructionError(f"'{path}' is no world frame: it holds a {type(values).__name__}")
    return WorldFrame.from_dict(values)


def world_frame(
    plane: Plane,
    table: WorldTable,
    *,
    rotation_left: NDArray[np.float64],
    points: NDArray[np.float64],
    sigma_m: float,
    frames: int,
    source: dict[str, Any],
) -> WorldFrame:
    """Put the world frame on a plane as the rig's ``[world]`` table says.

    Parameters
    ----------
    plane
        Still water in the left rectified camera.
    table
        Direction of X in the left picture and coordinates of the foot of the left camera.
    rotation_left
        (3, 3): left camera to left rectified camera; directions are those of the picture as recorded.
    points
        (rows, columns, 3) averaged points, for the covariance.
    sigma_m, frames, source
        Kept in the record.

    Raises
    ------
    ReconstructionError
        The chosen direction of the picture points straight at the water.
    """
    up = plane.normal
    ahead = rotation_left @ np.array(_PICTURE_DIRECTIONS[table.x_axis])
    ahead = ahead - (ahead @ up) * up
    length = float(np.linalg.norm(ahead))
    if length < 0.05:
        raise ReconstructionError(
            f"direction '{table.x_axis}' of the left picture points straight at the water",
            remedy="Choose another world.x_axis in the rig.",
        )
    ahead = ahead / length
    aside = np.cross(up, ahead)
    angle = np.radians(table.x_axis_rotation_deg)
    x_axis = np.cos(angle) * ahead + np.sin(angle) * aside
    y_axis = np.cross(up, x_axis)
    rotation = np.stack([x_axis, y_axis, up])
    return WorldFrame(
        rotation=rotation,
        translation_m=np.array([table.left_camera_x_m, table.left_camera_y_m, plane.distance_m]),
        sigma_m=sigma_m,
        sigma_mean_m=plane.sigma_m,
        covariance=plane_covariance(plane, points, rotation[:2]),
        points=plane.points,
        frames=frames,
        source=source,
    )
