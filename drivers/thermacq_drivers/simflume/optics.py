"""Pinhole cameras with Brown-Conrady distortion, and the paper's arrangement of two of them.

Conventions are OpenCV's: x right, y down, z forward; pixel centres at whole numbers; distortion
(k1, k2, p1, p2, k3). A point X of the flume has camera coordinates ``rotation @ (X - centre_m)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from thermacq_drivers.simflume.surfaces import Floats

_INVERSION_TOLERANCE = 1e-13
_INVERSION_STEPS = 30


@dataclass(frozen=True, eq=False)
class PinholeCamera:
    """One camera in the flume.

    Parameters
    ----------
    rows, columns
        Size of the picture in pixels.
    matrix
        (3, 3) camera matrix, pixels.
    distortion
        (5,) k1, k2, p1, p2, k3.
    rotation
        (3, 3) from flume to camera axes.
    centre_m
        (3,) optical centre in flume coordinates.
    """

    rows: int
    columns: int
    matrix: Floats
    distortion: Floats
    rotation: Floats
    centre_m: Floats

    def project(self, points_m: Floats) -> Floats:
        """Picture of points: (..., 3) flume coordinates in metres to (..., 2) pixels (column, row)."""
        in_camera = (points_m - self.centre_m) @ self.rotation.T
        return self.project_camera(in_camera)

    def project_camera(self, points_m: Floats) -> Floats:
        """Picture of points: (..., 3) camera coordinates in metres to (..., 2) pixels (column, row)."""
        plane = points_m[..., :2] / points_m[..., 2:]
        distorted = distort(plane, self.distortion)
        pixels: Floats = distorted * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]
        return pixels

    def rays(self, pixels: Floats) -> Floats:
        """Directions of pixels: (..., 2) (column, row) to (..., 3) flume axes, of depth 1 in the camera."""
        distorted = (pixels - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]
        plane = undistort(distorted, self.distortion)
        directions: Floats = np.concatenate([plane, np.ones_like(plane[..., :1])], axis=-1) @ self.rotation
        return directions


def distort(plane: Floats, distortion: Floats) -> Floats:
    """Brown-Conrady distortion of (..., 2) normalised coordinates."""
    x, y = plane[..., 0], plane[..., 1]
    k1, k2, p1, p2, k3 = distortion
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def undistort(distorted: Floats, distortion: Floats) -> Floats:
    """Inverse of `distort` by Newton's method, to rounding error.

    Raises
    ------
    ValueError
        The distortion folds the picture over, so that some pixel has no ray.
    """
    plane = distorted.copy()
    k1, k2, p1, p2, k3 = distortion
    for _ in range(_INVERSION_STEPS):
        residual = distort(plane, distortion) - distorted
        x, y = plane[..., 0], plane[..., 1]
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        growth = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
        a = radial + growth * x * x + 2 * p1 * y + 6 * p2 * x
        b = growth * x * y + 2 * p1 * x + 2 * p2 * y
        d = radial + growth * y * y + 6 * p1 * y + 2 * p2 * x
        determinant = a * d - b * b
        if not np.all(determinant > 0.05):
            break
        plane[..., 0] -= (d * residual[..., 0] - b * residual[..., 1]) / determinant
        plane[..., 1] -= (a * residual[..., 1] - b * residual[..., 0]) / determinant
        if np.abs(residual).max() < _INVERSION_TOLERANCE:
            return plane
    raise ValueError("the lens distortion is so strong that it folds the picture over")


def rotation_vector(angles_deg: tuple[float, float, float]) -> Floats:
    """Rotation by a vector (axis times angle) given in degrees along x, y, z: (3, 3)."""
    from scipy.spatial.transform import Rotation

    matrix: Floats = Rotation.from_rotvec(angles_deg, degrees=True).as_matrix()
    return matrix


def looking_down(tilt_deg: float, azimuth_deg: float = 0.0) -> Floats:
    """Axes of a camera that looks down, tilted towards +X; picture right is -Y, picture up is +X.

    `azimuth_deg` turns it about the vertical, from +X towards +Y: at 180 degrees it is tilted towards -X.
    Rows of the (3, 3) result are the camera's x, y and z axes in flume coordinates.
    """
    sine, cosine = math.sin(math.radians(tilt_deg)), math.cos(math.radians(tilt_deg))
    axes = np.array([[0.0, -1.0, 0.0], [-cosine, 0.0, -sine], [sine, 0.0, -cosine]])
    turned: Floats = axes @ rotation_vector((0.0, 0.0, azimuth_deg)).T if azimuth_deg else axes
    return turned


def stereo_pose(left: PinholeCamera, right: PinholeCamera) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and translation (3,) in metres with x_right = R x_left + T (OpenCV's convention)."""
    rotation = right.rotation @ left.rotation.T
    translation: Floats = right.rotation @ (left.centre_m - right.centre_m)
    return rotation, translation
