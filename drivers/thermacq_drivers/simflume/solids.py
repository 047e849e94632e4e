"""A vertical cylinder as one camera sees it: where its pixels meet it, and what it looks like.

Camera and cylinder do not move, so everything here is found once. Rays are cut with wall and top exactly;
the picture is the mean over nine rays of each pixel. Whether water hides the cylinder's lower part is
decided later, frame by frame, in `sight`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.heat_settings import CylinderSettings, LampSettings, SurroundingsSettings
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.radiance import apparent_rise
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.surfaces import Floats

_SUBPIXELS = 3
_LOWEST_M = -0.3
# The coat of paint and foil is drawn from here to the top.
_COAT_SPACING_M = 0.0005


def wall_depth(cylinder: CylinderSettings, centre_m: Floats, rays: Floats) -> Floats:
    """Depth at which rays first meet the cylinder's wall or top, infinite where they miss it.

    Parameters
    ----------
    cylinder
        The cylinder; its lower end is out of sight.
    centre_m
        (3,) or (..., 3) start of the rays in flume coordinates, outside the cylinder.
    rays
        (..., 3) directions in flume axes.

    Returns
    -------
    numpy.ndarray
        (...) float64, in units of the rays' length.
    """
    x, y = centre_m[..., 0] - cylinder.x_m, centre_m[..., 1] - cylinder.y_m
    square = rays[..., 0] ** 2 + rays[..., 1] ** 2
    half = x * rays[..., 0] + y * rays[..., 1]
    root = half**2 - square * (x**2 + y**2 - cylinder.radius_m**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        enters = (-half - np.sqrt(root)) / square
        leaves = (-half + np.sqrt(root)) / square
        top = (cylinder.top_m - centre_m[..., 2]) / rays[..., 2]
        on_wall = (enters > 0) & (centre_m[..., 2] + enters * rays[..., 2] <= cylinder.top_m)
        # Seen from above, a ray over the edge of the wall still meets the top while above the cylinder.
        on_top = (top > 0) & (top > enters) & (top < leaves)
    depth: Floats = np.where(on_wall, enters, np.where(on_top, top, np.inf))
    return depth


def faces(cylinder: CylinderSettings, points_m: Floats, camera: PinholeCamera) -> NDArray[np.bool_]:
    """Whether points (..., 3) of the cylinder's wall or top are turned towards a camera.

    The cylinder is convex: what is turned towards the camera is not hidden by the cylinder.
    """
    outward = points_m[..., :2] - (cylinder.x_m, cylinder.y_m)
    to_camera = camera.centre_m - points_m
    towards = (outward * to_camera[..., :2]).sum(axis=-1) > 0
    above = to_camera[..., 2] > 0
    on_top = points_m[..., 2] >= cylinder.top_m - 1e-9
    turned: NDArray[np.bool_] = np.where(on_top, above, towards)
    return turned


def check_cylinder(cylinder: CylinderSettings, camera: PinholeCamera) -> None:
    """Refuse a camera inside the cylinder; raises `ValueError`."""
    x, y, z = camera.centre_m
    if math.hypot(x - cylinder.x_m, y - cylinder.y_m) <= cylinder.radius_m and z <= cylinder.top_m:
        raise ValueError(f"the camera at ({x:g}, {y:g}, {z:g}) m is inside the cylinder")


@dataclass(frozen=True, eq=False)
class CylinderPicture:
    """The cylinder in the part of one camera's picture that shows it.

    Parameters
    ----------
    rows, columns
        That part of the picture.
    rays
        (rows, columns, 3) directions of its pixels, of depth 1 in the camera.
    depth_m
        Depth at which the middle of each pixel meets the cylinder, infinite where it misses.
    share
        Part of each pixel that the cylinder covers where no water hides it, float32.
    near_depth_m
        Like `depth_m`, but at the edges of the silhouette the mean over the part that meets the cylinder.
    rise_k
        Apparent temperature above the water's, averaged over the part of a pixel that meets it, float32.
    """

    rows: slice
    columns: slice
    rays: Floats
    depth_m: Floats
    share: NDArray[np.float32]
    near_depth_m: Floats
    rise_k: NDArray[np.float32]


def cylinder_picture(
    cylinder: CylinderSettings,
    surroundings: SurroundingsSettings,
    lamps: LampSettings | None,
    camera: PinholeCamera,
    margin_m: float,
    water_k: float,
    seed: int,
) -> CylinderPicture | None:
    """Draw the cylinder for one camera; None where the camera does not see it.

    Parameters
    ----------
    cylinder, surroundings, lamps
        The cylinder, and what its foil reflects.
    camera
        The camera.
    margin_m
        Width of the ring of water around the cylinder that the part of the picture shows too.
    water_k
        Temperature of the water.
    seed
        Seed of the scene.
    """
    part = _part(cylinder, camera, margin_m)
    if part is None:
        return None
    rows, columns = part
    wall_k, top_k = _coat(cylinder, surroundings, lamps, water_k, seed)
    offsets = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
    grid = np.stack(np.meshgrid(np.arange(columns.start, columns.stop), np.arange(rows.start, rows.stop)), -1)
    shape = grid.shape[:2]
    share, depth_sum, rise_sum = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for right in offsets:
        for down in offsets:
            rays = camera.rays(grid + np.array([right, down]))
            depth = wall_depth(cylinder, camera.centre_m, rays)
            hit = np.isfinite(depth)
            points = camera.centre_m + depth[hit][:, None] * rays[hit]
            share += hit
            depth_sum[hit] += depth[hit]
            rise_sum[hit] += _coat_at(cylinder, points, wall_k, top_k)
    rays = camera.rays(grid.astype(np.float64))
    depth = wall_depth(cylinder, camera.centre_m, rays)
    hits = np.maximum(share, 1)
    return CylinderPicture(
        rows=rows,
        columns=columns,
        rays=rays,
        depth_m=depth,
        share=(share / _SUBPIXELS**2).astype(np.float32),
        near_depth_m=np.where(np.isfinite(depth) | (share == 0), depth, depth_sum / hits),
        rise_k=(rise_sum / hits).astype(np.float32),
    )


def _part(cylinder: CylinderSettings, camera: PinholeCamera, margin_m: float) -> tuple[slice, slice] | None:
    """Rows and columns that show the cylinder and the ring of water around it."""
    step = 4
    columns, rows = (
        np.append(np.arange(0, size - 1, step), size - 1) for size in (camera.columns, camera.rows)
    )
    rays = camera.rays(np.stack(np.meshgrid(columns, rows), -1).astype(np.float64))
    around = cylinder.model_copy(update={"radius_m": cylinder.radius_m + margin_m})
    lowest = camera.centre_m[2] + rays[..., 2] * (depth := wall_depth(around, camera.centre_m, rays))
    # What lies deeper under water than any trough is never seen.
    seen = np.isfinite(depth) & (lowest > _LOWEST_M)
    if not seen.any():
        return None
    slices = []
    for axis, places, size in ((1, rows, camera.rows), (0, columns, camera.columns)):
        at = places[np.flatnonzero(seen.any(axis=axis))]
        slices.append(slice(max(0, at[0] - step), min(size, at[-1] + step + 1)))
    return slices[0], slices[1]


def _coat(
    cylinder: CylinderSettings,
    surroundings: SurroundingsSettings,
    lamps: LampSettings | None,
    water_k: float,
    seed: int,
) -> tuple[NDArray[np.float32], float]:
    """Apparent temperature of the coat in kelvin above the water's: (height, circumference) wall, and top.

    What the wall reflects is half water, half surroundings, as for a rough vertical wall. A strip of foil is
    crinkled in its own way: each reflects its own part of surroundings, between 0.2 and 0.8, and those that
    face the lamps their own part of them, up to twice the part that they have of the sky.
    """
    own_k, ambient_k = (
        float(rise) for rise in apparent_rise([cylinder.temperature_k, surroundings.ambient_k], water_k)
    )
    paint = cylinder.paint_emissivity
    painted = paint * own_k + (1 - paint) * 0.5 * ambient_k
    circumference_m = 2 * math.pi * cylinder.radius_m
    size = (
        max(8, round((cylinder.top_m - _LOWEST_M) / _COAT_SPACING_M)),
        max(8, round(circumference_m / _COAT_SPACING_M)),
    )
    wall: NDArray[np.float32] = np.full(size, painted, np.float32)
    random = generator(seed, "foil")
    for _ in range(cylinder.strips):
        emissivity, sky, glint = random.uniform(
            (cylinder.foil_emissivity[0], 0.2, 0.0), (cylinder.foil_emissivity[1], 0.8, 2.0)
        )
        corners = _strip(cylinder, random)
        reflected_k = sky * ambient_k + glint * _lamp_light(cylinder, lamps, corners, water_k)
        value = emissivity * own_k + (1 - emissivity) * reflected_k
        _paste(wall, corners / _COAT_SPACING_M, value)
    return wall, painted


def _lamp_light(
    cylinder: CylinderSettings, lamps: LampSettings | None, corners_m: Floats, water_k: float
) -> float:
    """Apparent rise due to the part of the sky that the tubes take up, for a strip that may face them; kelvin."""
    if lamps is None:
        return 0.0
    away_m = np.array([cylinder.x_m - lamps.x_m, lamps.height_m])
    part = len(lamps.y_m) * lamps.length_m * lamps.width_m / (2 * math.pi * float(away_m @ away_m))
    facing = -math.cos(corners_m[:, 0].mean() / cylinder.radius_m) * math.copysign(1.0, away_m[0])
    return part * max(facing, 0.0) * float(apparent_rise(lamps.tube_k, water_k))


def _strip(cylinder: CylinderSettings, random: np.random.Generator) -> Floats:
    """Corners of a strip at a random place and angle: (4, 2) along the circumference, from the lower end; m."""
    width, length = np.array(cylinder.strip_size_m) * random.uniform(0.5, 1.5, 2)
    angle = random.uniform(0, math.pi)
    axis = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-axis[1], axis[0]])
    middle = random.uniform((0, 0), (2 * math.pi * cylinder.radius_m, cylinder.top_m - _LOWEST_M))
    half = 0.5 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    corners: Floats = middle + half[:, :1] * length * axis + half[:, 1:] * width * across
    return corners


def _paste(wall: NDArray[np.float32], corners: Floats, value: float) -> None:
    """Fill a quadrilateral given in samples, three times so that it goes on around the seam."""
    for turn in (-wall.shape[1], 0, wall.shape[1]):
        polygon = np.rint(corners + np.array([turn, 0])).astype(np.int32)
        cv2.fillConvexPoly(wall, polygon, value)


def _coat_at(
    cylinder: CylinderSettings, points_m: Floats, wall_k: NDArray[np.float32], top_k: float
) -> Floats:
    """Apparent rise of the coat at points (points, 3) of the cylinder."""
    angle = np.arctan2(points_m[:, 1] - cylinder.y_m, points_m[:, 0] - cylinder.x_m)
    column = np.floor(np.mod(angle / (2 * math.pi), 1.0) * wall_k.shape[1]).astype(np.intp)
    row = np.floor((points_m[:, 2] - _LOWEST_M) / _COAT_SPACING_M).astype(np.intp)
    rise = wall_k[np.clip(row, 0, wall_k.shape[0] - 1), np.minimum(column, wall_k.shape[1] - 1)].astype(
        np.float64
    )
    return np.where(points_m[:, 2] >= cylinder.top_m - 1e-9, top_k, rise)
