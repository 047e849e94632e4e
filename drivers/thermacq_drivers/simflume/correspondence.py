"""True correspondence between the pictures of two cameras: depth, place in the other picture, occlusion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.heat_settings import CylinderSettings
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.sight import Sight
from thermacq_drivers.simflume.solids import faces, wall_depth
from thermacq_drivers.simflume.surfaces import Floats

WATER, CYLINDER = 1, 2
"""Values of `Correspondence.seen`."""


@dataclass(frozen=True, eq=False)
class Correspondence:
    """What the middle of each pixel of one picture sees, and where it is in the other picture.

    Parameters
    ----------
    depth_m
        (rows, columns) float64, depth along the optical axis of the camera.
    column_px, row_px
        (rows, columns) float64, place in the other picture, as that camera delivers it (distorted).
    seen
        (rows, columns) uint8, `WATER` or `CYLINDER`.
    occluded
        (rows, columns) bool, within the other camera's field of view but hidden from it.
    outside
        (rows, columns) bool, not within the other camera's field of view.
    """

    depth_m: Floats
    column_px: Floats
    row_px: Floats
    seen: NDArray[np.uint8]
    occluded: NDArray[np.bool_]
    outside: NDArray[np.bool_]

    @property
    def disparity_px(self) -> Floats:
        """Column in this picture minus column in the other one, both as delivered."""
        columns: NDArray[np.float64] = np.arange(self.depth_m.shape[1], dtype=np.float64)
        return columns - self.column_px


def correspondence(sight: Sight, other: PinholeCamera, time_s: float) -> Correspondence:
    """Truth for every pixel of one camera, exact for water and cylinder.

    Parameters
    ----------
    sight
        The camera whose pixels are asked for, before the scene.
    other
        The camera in whose picture the same things are looked for.
    time_s
        Time of the scene.
    """
    camera = sight.camera
    depth, on_cylinder = sight.depth(time_s)
    pixels = np.stack(np.meshgrid(np.arange(camera.columns), np.arange(camera.rows)), -1).astype(np.float64)
    points = camera.centre_m + depth[..., None] * camera.rays(pixels)
    there = other.project(points)
    outside = np.any((there < -0.5) | (there > np.array([other.columns, other.rows]) - 0.5), axis=-1)
    outside |= (points - other.centre_m) @ other.rotation[2] <= 0
    occluded = np.zeros(depth.shape, bool)
    if sight.cylinder is not None:
        occluded = hidden(sight.cylinder, other, points, on_cylinder) & ~outside
    return Correspondence(
        depth_m=depth,
        column_px=there[..., 0],
        row_px=there[..., 1],
        seen=np.where(on_cylinder, CYLINDER, WATER).astype(np.uint8),
        occluded=occluded,
        outside=outside,
    )


def hidden(
    cylinder: CylinderSettings, camera: PinholeCamera, points_m: Floats, on_cylinder: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Whether the cylinder hides points (..., 3) from a camera.

    Of the water, whatever the way to the camera crosses the cylinder; of the cylinder, what is turned away.
    Water hides nothing: `projection.check_view` sees to it that rays cut it once.
    """
    behind = wall_depth(cylinder, camera.centre_m, points_m - camera.centre_m) < 1.0
    turned: NDArray[np.bool_] = np.where(on_cylinder, ~faces(cylinder, points_m, camera), behind)
    return turned
