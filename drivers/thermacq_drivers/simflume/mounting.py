"""Where the simulated cameras stand, and what their lenses are like: the paper's arrangement by default.

Table I: 640 x 512 pixels of 17 µm behind a lens of 12 mm (f = 705.9 px). Two cameras 6 cm apart, 0.6 m
above the water, tilted 22.8° towards +X. A second pair may look the other way. No two cameras are alike:
each side has its own principal point, focal length, distortion, and the right one is slightly misaligned.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from thermacq_drivers.simflume.optics import PinholeCamera, looking_down, rotation_vector
from thermacq_drivers.simflume.settings import Table

Side = Literal["left", "right"]
Triple = tuple[float, float, float]

# Deviations of the two lenses and mounts from their nominal values.
_FOCAL_FACTOR = {"left": 1.0, "right": 1.0017}
_PRINCIPAL_POINT_SHIFT = {"left": (3.2, -2.1), "right": (-2.4, 1.7)}  # pixels of 17 µm
_DISTORTION = {"left": (-0.210, 0.090, 6e-4, -4e-4, 0.0), "right": (-0.204, 0.082, -3e-4, 5e-4, 0.0)}
_MISALIGNMENT_DEG = {"left": (0.0, 0.0, 0.0), "right": (0.21, -0.34, 0.17)}
_DISPLACEMENT_M = {"left": (0.0, 0.0, 0.0), "right": (0.0004, 0.0, -0.0003)}


class Mounting(Table):
    """Geometry of one simulated camera; `None` takes the value of its side."""

    side: Side = "left"
    pair: str = Field("", pattern=r"^[\w-]*$", description="name of its stereo pair, where there are several")
    rows: int = Field(512, ge=16, le=4096)
    columns: int = Field(640, ge=16, le=4096)
    pixel_pitch_um: float = Field(17.0, gt=0)
    focal_length_mm: float = Field(12.0, gt=0)
    baseline_m: float = Field(0.06, gt=0, lt=2, description="from the left camera to the right one")
    height_m: float = Field(0.6, gt=0, description="of the left camera above still water")
    tilt_deg: float = Field(22.8, ge=0, lt=90, description="of the optical axis from the vertical")
    azimuth_deg: float = Field(0.0, ge=-180, le=180, description="direction of the tilt, from +X towards +Y")
    x_m: float = Field(0.0, description="of the left camera")
    y_m: float = Field(0.0, description="of the left camera")
    misalignment_deg: Triple | None = Field(None, description="rotation vector in camera axes")
    displacement_m: Triple | None = Field(None, description="of the optical centre, in camera axes")
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] | None = Field(None, description="k1 k2 p1 p2 k3")

    @model_validator(mode="after")
    def _possible_lens(self) -> Mounting:
        camera = build_camera(self)
        right, bottom = camera.columns - 0.5, camera.rows - 0.5
        camera.rays(np.array([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]]))
        return self


def build_camera(mounting: Mounting) -> PinholeCamera:
    """The camera as it really stands, misalignment and all."""
    side = mounting.side
    focal_px = mounting.focal_length_mm / mounting.pixel_pitch_um * 1e3 * _FOCAL_FACTOR[side]
    middle = np.array([mounting.columns - 1, mounting.rows - 1]) / 2
    shift = np.array(_PRINCIPAL_POINT_SHIFT[side]) * 17.0 / mounting.pixel_pitch_um
    point = middle + shift if mounting.principal_point_px is None else np.asarray(mounting.principal_point_px)
    distortion = _DISTORTION[side] if mounting.distortion is None else mounting.distortion
    angles = _MISALIGNMENT_DEG[side] if mounting.misalignment_deg is None else mounting.misalignment_deg
    moved = _DISPLACEMENT_M[side] if mounting.displacement_m is None else mounting.displacement_m
    return _place(mounting, focal_px, point, distortion, rotation_vector(angles), np.array(moved))


def nominal_pair(mounting: Mounting) -> tuple[PinholeCamera, PinholeCamera]:
    """Left and right camera of the rig as it was meant: no distortion, no misalignment."""
    focal_px = mounting.focal_length_mm / mounting.pixel_pitch_um * 1e3
    middle = np.array([mounting.columns - 1, mounting.rows - 1]) / 2
    sides: tuple[Side, Side] = ("left", "right")
    left, right = (
        _place(
            mounting.model_copy(update={"side": side}), focal_px, middle, (0.0,) * 5, np.eye(3), np.zeros(3)
        )
        for side in sides
    )
    return left, right


def _place(
    mounting: Mounting,
    focal_px: float,
    principal_point_px: np.ndarray,
    distortion: tuple[float, ...],
    misalignment: np.ndarray,
    displacement_m: np.ndarray,
) -> PinholeCamera:
    axes = looking_down(mounting.tilt_deg, mounting.azimuth_deg)
    across_m = mounting.baseline_m if mounting.side == "right" else 0.0
    centre = np.array([mounting.x_m, mounting.y_m, mounting.height_m])
    centre += axes.T @ (np.array([across_m, 0.0, 0.0]) + displacement_m)
    matrix = np.diag([focal_px, focal_px, 1.0])
    matrix[:2, 2] = principal_point_px
    return PinholeCamera(
        rows=mounting.rows,
        columns=mounting.columns,
        matrix=matrix,
        distortion=np.array(distortion, np.float64),
        rotation=misalignment @ axes,
        centre_m=centre,
    )
