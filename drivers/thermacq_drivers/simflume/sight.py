"""What each pixel of a camera meets: the water, or the cylinder that stands in it.

The water is met at nodes of the picture (see `projection`); what follows is smooth between them. At the
cylinder three things are not smooth, and are found pixel by pixel in the part of the picture that shows it:

- whether the ray meets wall or water first: the nearer of the two exact depths;
- the meniscus, h exp(-(r - a)/l) with the capillary length l = 2.7 mm of water, which raises the water
  at the wall by h; the ray is cut with water plus meniscus by Newton's method;
- the ring of water up to 30 mm from the wall, where nodes inside the cylinder would be felt: each of its
  pixels is cut with the water by two more steps of Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.cylinder import Pierced
from thermacq_drivers.simflume.heat_settings import CylinderSettings, SurroundingsSettings
from thermacq_drivers.simflume.local_grid import LocalGrid
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.projection import PixelGrid, intersect, row_delay_s
from thermacq_drivers.simflume.settings import SceneSettings
from thermacq_drivers.simflume.solids import CylinderPicture, cylinder_picture
from thermacq_drivers.simflume.surfaces import Floats, Surface

CAPILLARY_LENGTH_M = 0.0027
RING_M = 0.03
_MENISCUS_M = 0.024
# Beyond this the meniscus of 1 mm is lower than 0.2 µm.
_HIDDEN_M = 0.01
_LEVELS = 13
_STEPS = 8
_HALVINGS = 30
_NEWTON_STEPS = 3
_TOLERANCE_M = 1e-9
_INSIDE_TOLERANCE_M = 1e-6
_DEEP_INSIDE = 0.6
# Nodes that far inside the cylinder, in radii, do not touch any pixel that shows water.


@dataclass(frozen=True, eq=False)
class Water:
    """Where rays meet the water; arrays of the shape (...) of the rays.

    Parameters
    ----------
    points_m
        (..., 3) in flume coordinates.
    depth_m
        Depth in the camera.
    slope_x, slope_y
        Slope of the water there.
    """

    points_m: Floats
    depth_m: Floats
    slope_x: Floats
    slope_y: Floats


@dataclass(frozen=True, eq=False)
class Front:
    """The part of a picture that shows the cylinder, at one moment.

    Parameters
    ----------
    water_depth_m
        (rows, columns) depth at which each pixel meets the water, meniscus included.
    ring
        (rows, columns) bool, pixels whose water is close to the wall.
    ring_water
        Where they meet it, (ring pixels, ...) each, meniscus included.
    ring_read_s
        When they are read out, (ring pixels,) or a number.
    """

    water_depth_m: Floats
    ring: NDArray[np.bool_]
    ring_water: Water
    ring_read_s: Floats | float


class Continued:
    """Water around a cylinder, continued into it: even in the distance from the wall.

    No water passes the wall, so the elevation's slope across it is zero, and the continued surface is as
    smooth as nodes beside the wall need it. Labels are continued by their displacement.

    Parameters
    ----------
    surface
        The water outside the cylinder.
    cylinder
        The cylinder.
    """

    def __init__(self, surface: Surface, cylinder: CylinderSettings) -> None:
        self.surface = surface
        self._cylinder = cylinder
        self.highest_m = surface.highest_m
        self.steepest = surface.steepest

    def elevation(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> Floats:
        """Elevation above still water, metres."""
        x, y, _, _ = self._outside(x_m, y_m)
        return self.surface.elevation(x, y, time_s)

    def slope(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Slope along x and along y."""
        x, y, inside, (bend_xx, bend_xy, bend_yy) = self._outside(x_m, y_m)
        along, across = self.surface.slope(x, y, time_s)
        there_x, there_y = along[inside], across[inside]
        along[inside] = bend_xx * there_x + bend_xy * there_y
        across[inside] = bend_xy * there_x + bend_yy * there_y
        return along, across

    def velocity(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Horizontal velocity (x, y) of the water at the surface, m/s."""
        x, y, _, _ = self._outside(x_m, y_m)
        return self.surface.velocity(x, y, time_s)

    def label(self, x_m: Floats, y_m: Floats, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Material coordinates (along x, along y) of the particle now at (x, y), metres."""
        x, y, _, _ = self._outside(x_m, y_m)
        along, across = self.surface.label(x, y, time_s)
        return along + (x_m - x), across + (y_m - y)

    def _outside(
        self, x_m: Floats, y_m: Floats
    ) -> tuple[Floats, Floats, NDArray[np.bool_], tuple[Floats, Floats, Floats]]:
        """Places, those inside the cylinder mirrored at its wall; which those are; derivatives xx, xy, yy of that."""
        wall_m = self._cylinder.radius_m
        x, y = x_m - self._cylinder.x_m, y_m - self._cylinder.y_m
        within = x * x + y * y < wall_m**2
        x, y = x[within], y[within]
        # Deep inside, only finite: places there shrink towards the middle.
        radius = np.maximum(np.hypot(x, y), 0.5 * wall_m)
        inside = wall_m - radius
        # Near the wall as far outside as the place is inside; less, deep inside.
        fading = np.exp(-((2 * inside / wall_m) ** 2))
        around = (wall_m + inside * fading) / radius
        outwards = -fading * (1 - 8 * (inside / wall_m) ** 2)
        cosine, sine = x / radius, y / radius
        bend = (
            outwards * cosine**2 + around * sine**2,
            (outwards - around) * cosine * sine,
            outwards * sine**2 + around * cosine**2,
        )
        mirrored_x, mirrored_y = np.array(x_m), np.array(y_m)
        mirrored_x[within] = self._cylinder.x_m + around * x
        mirrored_y[within] = self._cylinder.y_m + around * y
        return mirrored_x, mirrored_y, within, bend


class Sight:
    """One camera before one scene.

    Parameters
    ----------
    surface
        The water.
    camera
        The camera; `projection.check_view` has found it fit.
    cylinder, picture
        The cylinder, and how this camera sees it; None where there is none or none in view.
    line_time_s
        From the read-out of one row to that of the next.
    """

    def __init__(
        self,
        surface: Surface,
        camera: PinholeCamera,
        cylinder: CylinderSettings | None = None,
        picture: CylinderPicture | None = None,
        line_time_s: float = 0.0,
    ) -> None:
        self.camera = camera
        self.cylinder = cylinder
        self.picture = picture
        self.surface: Surface | Continued = surface if cylinder is None else Continued(surface, cylinder)
        self.grid: PixelGrid | LocalGrid
        if cylinder is None:
            self.grid = PixelGrid(camera.rows, camera.columns)
        else:
            self.grid = LocalGrid(camera.rows, camera.columns)
        self.rays = camera.rays(self.grid.nodes_px)
        self._levels_m = self.surface.highest_m, -2 * self.surface.highest_m  # no water is higher or lower
        self._line_time_s = line_time_s
        self._delay_s = row_delay_s(self.grid.nodes_px, line_time_s)

        if picture is not None and cylinder is not None:
            self._ring_candidates = self._find_candidates(picture, cylinder)
            self._candidate_rays = np.ascontiguousarray(picture.rays.reshape(-1, 3)[self._ring_candidates].T)

    def _find_candidates(self, picture: CylinderPicture, cylinder: CylinderSettings) -> NDArray[np.intp]:
        """Pixels of the part (flat indices) that see water close to the wall at some height of the water."""
        centre, rays = self.camera.centre_m, picture.rays
        highest_m = self.surface.highest_m + cylinder.meniscus_m
        near = np.zeros(rays.shape[:2], bool)
        for level_m in np.linspace(-1.5 * highest_m, highest_m, _LEVELS):
            depth = (level_m - centre[2]) / rays[..., 2]
            distance = np.hypot(
                centre[0] - cylinder.x_m + depth * rays[..., 0],
                centre[1] - cylinder.y_m + depth * rays[..., 1],
            )
            near |= np.abs(distance - cylinder.radius_m) < RING_M
        return np.flatnonzero(near)

    def read_s(self, time_s: float) -> Floats | float:
        """When each node is read out, (node rows, 1) or a number, if the first row is read at a time."""
        return time_s + self._delay_s

    def water(self, time_s: float) -> Water:
        """Where the rays of the nodes meet the water; `time_s` as for `read_s`."""
        read_s = self.read_s(time_s)
        if self.cylinder is None:
            depth = intersect(self.surface, self.camera, self.rays, read_s)
        else:
            depth = self._intersect_outside(self.cylinder, read_s)
        points = self.camera.centre_m + depth[..., None] * self.rays
        slope_x, slope_y = self.surface.slope(points[..., 0], points[..., 1], read_s)
        return Water(points, depth, slope_x, slope_y)

    def _intersect_outside(self, cylinder: CylinderSettings, time_s: Floats | float) -> Floats:
        """Like `intersect`, but deep inside the cylinder any depth will do."""
        along, across, down = (np.ascontiguousarray(part) for part in np.moveaxis(self.rays, -1, 0))
        x0, y0, z0 = self.camera.centre_m
        depth: Floats = -z0 / down
        nearest, farthest = ((level_m - z0) / down for level_m in self._levels_m)
        for step in range(_STEPS):
            x, y = x0 + depth * along, y0 + depth * across
            gap = z0 + depth * down - self.surface.elevation(x, y, time_s)
            radius = np.hypot(x - cylinder.x_m, y - cylinder.y_m) / cylinder.radius_m
            tolerance = np.where(radius > 1, _TOLERANCE_M, _INSIDE_TOLERANCE_M)
            open_ = (np.abs(gap) > tolerance) & (radius > _DEEP_INSIDE)
            if not open_.any():
                return depth
            # After some steps of Newton's method the slope is good enough to be kept.
            if step < _NEWTON_STEPS:
                slope_x, slope_y = self.surface.slope(x, y, time_s)
                descent = down - slope_x * along - slope_y * across
            depth = np.clip(depth - gap / descent, nearest, farthest)
        self._bisect(depth, open_, time_s)
        return depth

    def _bisect(self, depth: Floats, which: NDArray[np.bool_], time_s: Floats | float) -> None:
        """Set depths of rays that Newton's method throws to and fro where the water inside the cylinder is folded."""
        rays, (x0, y0, z0) = self.rays[which], self.camera.centre_m
        read_s = time_s if np.ndim(time_s) == 0 else np.broadcast_to(time_s, which.shape)[which]
        high, low = ((level_m - z0) / rays[:, 2] for level_m in self._levels_m)
        for _ in range(_HALVINGS):
            middle = (high + low) / 2
            x, y = x0 + middle * rays[:, 0], y0 + middle * rays[:, 1]
            above = z0 + middle * rays[:, 2] > self.surface.elevation(x, y, read_s)
            high, low = np.where(above, middle, high), np.where(above, low, middle)
        depth[which] = (high + low) / 2

    def front(self, water: Water, time_s: float) -> Front | None:
        """What the part of the picture shows that has the cylinder in it; `time_s` as for `read_s`."""
        picture, cylinder = self.picture, self.cylinder
        if picture is None or cylinder is None:
            return None
        depth, slope_x, slope_y = (
            self.grid.spread(values, picture.rows, picture.columns)
            for values in (water.depth_m, water.slope_x, water.slope_y)
        )
        near, (along, across, down) = self._ring_candidates, self._candidate_rays
        found = depth.ravel()[near]
        centre_x, centre_y, centre_z = self.camera.centre_m
        distance = np.hypot(centre_x - cylinder.x_m + found * along, centre_y - cylinder.y_m + found * across)
        kept = np.abs(distance - cylinder.radius_m) < RING_M
        kept &= found < picture.depth_m.ravel()[near] + _HIDDEN_M
        near, found = near[kept], found[kept]
        along, across, down = along[kept], across[kept], down[kept]
        slope_x, slope_y = slope_x.ravel()[near], slope_y.ravel()[near]
        read_s: Floats | float = time_s
        if self._line_time_s:
            read_s = time_s + self._line_time_s * (picture.rows.start + near // depth.shape[1])
        descent = down - slope_x * along - slope_y * across
        for _ in range(2):
            x, y = centre_x + found * along, centre_y + found * across
            gap = centre_z + found * down - self.surface.elevation(x, y, read_s)
            found = found + _change_of_depth(cylinder, (x, y), (along, across), gap, descent)
        depth.ravel()[near] = found
        points = np.stack([centre_x + found * along, centre_y + found * across, centre_z + found * down], -1)
        _, growth, cosine, sine = _meniscus(cylinder, points[:, 0], points[:, 1])
        ring = np.zeros(depth.shape, bool)
        ring.ravel()[near] = True
        return Front(
            depth, ring, Water(points, found, slope_x + growth * cosine, slope_y + growth * sine), read_s
        )

    def depth(self, time_s: float) -> tuple[Floats, NDArray[np.bool_]]:
        """Depth of what the middle of each pixel sees, and whether that is the cylinder: (rows, columns)."""
        water = self.water(time_s)
        depth = self.grid.spread(water.depth_m)
        on_cylinder = np.zeros(depth.shape, bool)
        front = self.front(water, time_s)
        if front is not None and self.picture is not None:
            part = self.picture.rows, self.picture.columns
            depth[part] = np.minimum(front.water_depth_m, self.picture.depth_m)
            on_cylinder[part] = self.picture.depth_m < front.water_depth_m
        return depth, on_cylinder


def build_sight(
    settings: SceneSettings, surface: Surface, camera: PinholeCamera, line_time_s: float = 0.0
) -> Sight:
    """A camera before a scene whose water is `surface`."""
    cylinder = settings.cylinder
    if isinstance(surface, Pierced):
        # It has a hole; rays need the water that it was made from.
        surface = surface.surface
    if cylinder is None:
        return Sight(surface, camera, line_time_s=line_time_s)
    surroundings = settings.surroundings or SurroundingsSettings()
    picture = cylinder_picture(
        cylinder, surroundings, settings.lamps, camera, RING_M, settings.water_temperature_k, settings.seed
    )
    return Sight(surface, camera, cylinder, picture, line_time_s)


def cylinder_share(picture: CylinderPicture, front: Front) -> NDArray[np.float32]:
    """Part of each pixel that shows the cylinder, with the waterline drawn through pixels."""
    with np.errstate(invalid="ignore"):
        nearer = (front.water_depth_m - picture.near_depth_m).astype(np.float32)
    nearer[picture.share == 0] = 0.0
    down, right = np.gradient(nearer)
    steepness = np.maximum(np.hypot(down, right), np.float32(1e-6))
    share: NDArray[np.float32] = np.clip(nearer / steepness + np.float32(0.5), 0, 1) * picture.share
    return share


def _meniscus(cylinder: CylinderSettings, x_m: Floats, y_m: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Meniscus at places (places,): height, slope outwards, and cosine and sine of the outward direction."""
    x, y = x_m - cylinder.x_m, y_m - cylinder.y_m
    radius = np.hypot(x, y)
    beyond = np.maximum(radius - cylinder.radius_m, 0.0)
    height = cylinder.meniscus_m * np.exp(beyond * (-1 / CAPILLARY_LENGTH_M))
    return height, height * (-1 / CAPILLARY_LENGTH_M), x / radius, y / radius


def _change_of_depth(
    cylinder: CylinderSettings,
    place_m: tuple[Floats, Floats],
    rays: tuple[Floats, Floats],
    gap_m: Floats,
    descent: Floats,
) -> Floats:
    """Change of depth that brings rays to the water and its meniscus.

    Within so short a way the water without meniscus is a plane: `gap_m` is how high each ray is above it at
    `place_m`, `descent` how fast the gap changes with depth. `rays` are the rays' horizontal parts.
    """
    change: Floats = -gap_m / descent
    close = np.hypot(place_m[0] - cylinder.x_m, place_m[1] - cylinder.y_m) < cylinder.radius_m + _MENISCUS_M
    x, y, along, across, gap, falling = (values[close] for values in (*place_m, *rays, gap_m, descent))
    raised = change[close]
    for _ in range(_STEPS):
        height, growth, cosine, sine = _meniscus(cylinder, x + raised * along, y + raised * across)
        step = (gap + raised * falling - height) / (falling - growth * (along * cosine + across * sine))
        raised -= step
        if np.abs(step).max(initial=0.0) < _TOLERANCE_M:
            break
    change[close] = raised
    return change
