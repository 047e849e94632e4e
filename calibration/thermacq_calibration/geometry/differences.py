"""How far two calibrations of the same cameras are apart, in pixels over the picture and in depth.

Two calibrations have no common frame of reference, so parameters say little. As mrcal does
(https://mrcal.secretsauce.net/differencing.html), one is asked where it sees points at the working distance, the
other one's rig is placed so that it sees them as nearly there as it can, and the distance that remains is the
difference. Here the rig of both cameras is placed as a whole: a wrong baseline or relative rotation shows too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.bundle import Corners, Fit, Geometry, Poses, fit, fit_poses, project
from thermacq_calibration.geometry.record import StereoCalibration
from thermacq_calibration.geometry.rectification import rectify_points
from thermacq_calibration.geometry.uncertainty import GRID, WORKING_DISTANCE_M, judge, look
from thermacq_calibration.models import Float


@dataclass(frozen=True, eq=False)
class Difference:
    """What separates two calibrations.

    Parameters
    ----------
    rms_px, worst_px
        Distance of projections over both pictures.
    left_px, right_px
        (12, 16) float64: distance over the left picture, by the points seen there; NaN where the right camera does
        not see the point.
    depth_m
        Mean depth of the second less that of the first, of points at the working distance.
    depth_map_m
        (12, 16) float64: the same over the picture.
    """

    rms_px: float
    worst_px: float
    left_px: Float
    right_px: Float
    depth_m: float
    depth_map_m: Float

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; None where a map has no value."""
        maps = {name: getattr(self, name) for name in ("left_px", "right_px", "depth_map_m")}
        numbers = {"rms_px": self.rms_px, "worst_px": self.worst_px, "depth_m": self.depth_m}
        return numbers | {
            name: [[float(value) if np.isfinite(value) else None for value in row] for row in rows]
            for name, rows in maps.items()
        }


@dataclass(frozen=True)
class Change:
    """One quantity in two calibrations, and the standard uncertainty of its difference where it is known."""

    quantity: str
    first: float
    second: float
    sigma: float | None

    @property
    def in_sigmas(self) -> float | None:
        """Difference in units of its standard uncertainty."""
        return None if not self.sigma else (self.second - self.first) / self.sigma


def projection_difference(
    first: Geometry,
    second: Geometry,
    image_size: tuple[int, int],
    working_distance_m: float = WORKING_DISTANCE_M,
) -> Difference:
    """Difference of two calibrations at the working distance.

    Parameters
    ----------
    first, second
        Two geometries of the same cameras.
    image_size
        (columns, rows) of the pictures.
    working_distance_m
        Distance of the points that are looked at.
    """
    points, seen = _points(first, image_size, working_distance_m)
    left, right = project(first, points[seen])
    corners = Corners.join([(points[seen], left, right)])
    _, errors = fit_poses(second, Poses(np.eye(3)[None], np.zeros((1, 3))), corners)
    distances = np.full((2, seen.size), np.nan)
    distances[:, seen] = np.hypot(errors[:, ::2], errors[:, 1::2]).T
    shape = GRID[::-1]
    scene = look(first, image_size, working_distance_m)
    depth = judge(second, scene, image_size)[1] - judge(first, scene, image_size)[1]
    return Difference(
        rms_px=float(np.sqrt(np.nanmean(distances**2))),
        worst_px=float(np.nanmax(distances)),
        left_px=distances[0].reshape(shape),
        right_px=distances[1].reshape(shape),
        depth_m=float(depth[scene.seen].mean()),
        depth_map_m=depth.reshape(shape),
    )


def compare(first: StereoCalibration, second: StereoCalibration) -> list[Change]:
    """Parameters and depth of two calibrations side by side.

    Raises
    ------
    CalibrationError
        They are for pictures of different sizes, or have distortion that is not known here.
    """
    if first.image_size != second.image_size:
        sizes = [f"{columns} x {rows}" for columns, rows in (first.image_size, second.image_size)]
        raise CalibrationError(
            f"the calibrations are for pictures of different sizes: {sizes[0]} and {sizes[1]}"
        )
    distance = first.working_distance_m or WORKING_DISTANCE_M
    scene = look(Geometry.of(first), first.image_size, distance)
    values = [judge(Geometry.of(one), scene, first.image_size)[0] for one in (first, second)]
    return [
        Change(quantity, values[0][quantity], values[1][quantity], _combined(first, second, quantity))
        for quantity in values[0]
    ]


def _combined(first: StereoCalibration, second: StereoCalibration, quantity: str) -> float | None:
    """Standard uncertainty of the difference, as far as either record knows it."""
    known = [one.standard_uncertainty(quantity) for one in (first, second)]
    squares = [value**2 for value in known if value is not None]
    return float(np.sqrt(sum(squares))) if squares else None


def half_set_difference(
    found: Fit, corners: Corners, image_size: tuple[int, int], working_distance_m: float = WORKING_DISTANCE_M
) -> Difference:
    """Difference of two calibrations, one from the odd and one from the even views."""
    every = np.arange(corners.views)
    halves = [
        fit(found.geometry, found.poses.select(part), corners.select(part), found.free).geometry
        for part in (every[::2], every[1::2])
    ]
    return projection_difference(halves[0], halves[1], image_size, working_distance_m)


def _points(
    geometry: Geometry, image_size: tuple[int, int], working_distance_m: float
) -> tuple[Float, NDArray[np.bool_]]:
    """(n, 3) points at the working distance over the left picture, in its camera's frame; which the right one sees."""
    u, v = np.meshgrid(
        *(np.linspace(0, size - 1, count) for size, count in zip(image_size, GRID, strict=True))
    )
    camera = geometry.calibration(image_size).left
    rays = rectify_points(camera, np.column_stack([u.ravel(), v.ravel()]), np.eye(3), np.eye(3))
    points = np.column_stack([rays, np.ones(len(rays))]) * working_distance_m
    right = project(geometry, points)[1]
    inside = (right >= 0) & (right <= np.array(image_size) - 1)
    return points, inside[:, 0] & inside[:, 1]
