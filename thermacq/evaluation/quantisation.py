"""Quantisation error of a stereo pair: what one pixel is worth in metres (paper, eqs. 5-8, Fig. 16).

With ``z = B f / d`` and a disparity error ``e / sqrt(2)`` for a positioning error of e pixels. In eqs. 6 and 7
the coordinates under the root are those of the point in the camera frame, in metres: only so do the
dimensions agree, and so it follows from ``x = z u / f`` with independent errors of u and z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Values: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class QuantisationCurve:
    """The curves of Fig. 16: largest errors in the picture against distance.

    Parameters
    ----------
    distance_m
        (distances,) depth along the optical axis of the rectified left camera.
    depth_error_m
        e_z in the camera frame (eq. 5).
    vertical_error_m
        e_Z in the world frame (eq. 8), for the least favourable signs and the corner of the picture.
    pixel_error_px
        The positioning error assumed.
    """

    distance_m: Values
    depth_error_m: Values
    vertical_error_m: Values
    pixel_error_px: float


def depth_error_m(
    distance_m: ArrayLike, baseline_m: float, focal_px: float, pixel_error_px: float = 1.0
) -> Values:
    """e_z of eq. 5, metres.

    Parameters
    ----------
    distance_m
        Depth z, metres, any shape.
    baseline_m, focal_px
        Of the rectified pair.
    pixel_error_px
        Positioning error e.
    """
    distance = np.asarray(distance_m, np.float64)
    return np.asarray(distance**2 / (np.sqrt(2) * baseline_m * focal_px) * pixel_error_px)


def lateral_error_m(
    distance_m: ArrayLike,
    coordinate_m: ArrayLike,
    baseline_m: float,
    focal_px: float,
    pixel_error_px: float = 1.0,
) -> Values:
    """e_x or e_y of eqs. 6 and 7, metres.

    Parameters
    ----------
    distance_m
        Depth z, metres.
    coordinate_m
        Coordinate x or y of the point in the camera frame, metres.
    baseline_m, focal_px, pixel_error_px
        As in `depth_error_m`.
    """
    ratio = np.asarray(coordinate_m, np.float64) / (np.sqrt(2) * baseline_m)
    return np.asarray(np.sqrt(1 + ratio**2) * np.asarray(distance_m, np.float64) / focal_px * pixel_error_px)


def world_errors_m(rotation: ArrayLike, errors_m: ArrayLike) -> Values:
    """Eq. 8 for the least favourable signs: |R| (e_x, e_y, e_z).

    Parameters
    ----------
    rotation
        (3, 3) camera to world.
    errors_m
        (3,) or (3, points) errors in the camera frame; they have no sign, so none may cancel another.
    """
    return np.asarray(np.abs(np.asarray(rotation, np.float64)) @ np.asarray(errors_m, np.float64))


def quantisation_curve(
    distance_m: ArrayLike,
    baseline_m: float,
    focal_px: float,
    half_picture_px: tuple[float, float],
    rotation: ArrayLike,
    pixel_error_px: float = 1.0,
) -> QuantisationCurve:
    """Fig. 16 for one rig.

    Parameters
    ----------
    distance_m
        (distances,) metres.
    baseline_m, focal_px
        Of the rectified pair.
    half_picture_px
        Largest distance of a pixel from the principal point along columns and rows.
    rotation
        (3, 3) camera to world.
    pixel_error_px
        Positioning error e; the paper takes one pixel.
    """
    distance = np.asarray(distance_m, np.float64)
    depth = depth_error_m(distance, baseline_m, focal_px, pixel_error_px)
    lateral = [
        lateral_error_m(distance, distance * half / focal_px, baseline_m, focal_px, pixel_error_px)
        for half in half_picture_px
    ]
    vertical = world_errors_m(rotation, np.stack([*lateral, depth]))[2]
    return QuantisationCurve(distance, depth, vertical, pixel_error_px)
