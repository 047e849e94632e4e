"""Disparity to points in the left rectified camera (paper, eqs. 1 and 2), and what one pixel is worth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def triangulate(
    disparity: NDArray[np.float32],
    *,
    focal_px: float,
    principal_point_px: tuple[float, float],
    baseline_m: float,
    doffs_px: float = 0.0,
) -> NDArray[np.float64]:
    """Points of a disparity map.

    z = B f / (d + doffs), x = z (u - u0) / f, y = z (v - v0) / f  (paper, eqs. 1 and 2; doffs is the
    difference of the two principal points, 0 for a rig that is rectified to parallel axes).

    Parameters
    ----------
    disparity
        (rows, columns) float32, pixels, NaN where unknown.
    focal_px, principal_point_px, baseline_m, doffs_px
        Geometry of the rectified pair; the principal point (u0, v0) is that of the left picture.

    Returns
    -------
    numpy.ndarray
        (rows, columns, 3) float64, metres, x right, y down, z forward; NaN where the disparity is NaN or
        lies at or beyond infinity.
    """
    rows, columns = disparity.shape
    parallax = disparity.astype(np.float64) + doffs_px
    z = baseline_m * focal_px / np.where(parallax > 0, parallax, np.nan)
    u = np.arange(columns) - principal_point_px[0]
    v = np.arange(rows) - principal_point_px[1]
    return np.stack([z * u / focal_px, z * v[:, None] / focal_px, z], axis=-1)


def depth_per_pixel(z_m: float, focal_px: float, baseline_m: float) -> float:
    """Change of depth for one pixel of disparity, dz/dd = z² / (B f), metres."""
    return z_m * z_m / (baseline_m * focal_px)


def plane_disparity(
    shape: tuple[int, int],
    normal: NDArray[np.float64],
    distance_m: float,
    *,
    focal_px: float,
    principal_point_px: tuple[float, float],
    baseline_m: float,
    doffs_px: float = 0.0,
) -> NDArray[np.float64]:
    """Disparity of the plane ``normal · X + distance_m = 0``; it is linear in u and v.

    Returns
    -------
    numpy.ndarray
        (rows, columns) float64, pixels; NaN where a ray does not meet the plane in front of the camera.
    """
    rows, columns = shape
    u = (np.arange(columns) - principal_point_px[0]) / focal_px
    v = (np.arange(rows)[:, None] - principal_point_px[1]) / focal_px
    inverse_z = -(normal[0] * u + normal[1] * v + normal[2]) / distance_m
    return np.where(inverse_z > 0, baseline_m * focal_px * inverse_z - doffs_px, np.nan)
