"""Centres of an asymmetric grid of circles, dark on light or light on dark.

OpenCV finds blobs at several thresholds and arranges them to the grid. The middle of the picture of a circle
is not the picture of its middle when the board is tilted: with circles of 12 mm radius at 0.6 m and 35 degrees
they are 0.1 px apart. That is put right with the homography of the grid: the picture of a circle of known
radius is a known ellipse (Hartley and Zisserman, Multiple View Geometry, 2nd ed., result 2.13: conics map by
``H^-T C H^-1``), and the radius is measured in the picture.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Board, Float, frozen_array
from thermacq_calibration.targets.boards import board_points
from thermacq_calibration.targets.detection import Detection, NoBoard
from thermacq_calibration.targets.pictures import Bytes
from thermacq_calibration.targets.saddles import edge_width_px
from thermacq_calibration.targets.sampling import fit_homography, project, sample

_SMOOTHING_PX = 1.0
_ANGLES = 24
_RADII = 36
# Half the distance of neighbours, in steps of the grid: farther out the next circle may begin.
_FARTHEST = np.sqrt(2) / 2
_LEVELS = 4


def find_circles(picture: NDArray[Any], grey: Bytes, board: Board) -> Detection | NoBoard:
    """Find all centres of an asymmetric grid of circles.

    Parameters
    ----------
    picture
        (rows, columns) counts.
    grey
        The same stretched to 8 bit.
    board
        A board of kind ``circles``.
    """
    import cv2

    smooth = cv2.GaussianBlur(grey, (0, 0), _SMOOTHING_PX)
    size, flags = (board.columns, board.rows), cv2.CALIB_CB_ASYMMETRIC_GRID
    for method in (flags, flags | cv2.CALIB_CB_CLUSTERING):
        found, blobs = cv2.findCirclesGrid(smooth, size, flags=method, blobDetector=_blob_detector())
        if found:
            break
    else:
        return NoBoard(f"no asymmetric grid of {board.columns} x {board.rows} circles found")
    places = board_points(board)[:, :2].astype(np.float64) / board.square_m
    centres = np.asarray(blobs, np.float64).reshape(-1, 2)
    homography = fit_homography(places, centres)
    if homography is None:
        return NoBoard("circles were found, but they do not lie on a flat grid")
    profile, step_px = _radial_profile(picture, homography, places)
    inside, outside = profile[:_LEVELS].mean(), profile[-_LEVELS:].mean()
    within = np.abs(profile - inside) <= np.abs(outside - inside) / 2
    radius = _FARTHEST * int(np.argmin(within)) / (_RADII - 1)
    centres = centres - _eccentricity_px(homography, places, radius)
    return Detection(frozen_array(centres), edge_width_px(profile, step_px), float(abs(outside - inside)))


def _blob_detector() -> Any:
    import cv2

    wanted = cv2.SimpleBlobDetector.Params()
    wanted.filterByColor = False
    wanted.minArea, wanted.maxArea, wanted.minDistBetweenBlobs = 20, 20_000, 4
    wanted.minThreshold, wanted.maxThreshold, wanted.thresholdStep = 20, 236, 12
    wanted.filterByCircularity, wanted.minCircularity = True, 0.6
    wanted.filterByConvexity, wanted.minConvexity = True, 0.8
    wanted.filterByInertia, wanted.minInertiaRatio = True, 0.2
    return cv2.SimpleBlobDetector.create(wanted)


def _radial_profile(picture: NDArray[Any], homography: Float, places: Float) -> tuple[Float, float]:
    """Mean counts (radii,) outwards from the centres, and the mean step between radii in pixels."""
    radii = np.linspace(0, _FARTHEST, _RADII)
    angles = np.linspace(0, 2 * np.pi, _ANGLES, endpoint=False)
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    pixels = project(homography, places[:, None, None] + radii[:, None] * rays[:, None])
    steps = np.linalg.norm(np.diff(pixels, axis=2), axis=-1)
    values = sample(picture, pixels.reshape(-1, _RADII, 2))
    return values.mean(axis=0), float(steps.mean())


def _eccentricity_px(homography: Float, places: Float, radius: float) -> Float:
    """Centre of the picture of each circle, from the picture of its centre: (n, 2) pixels."""
    x, y = places.T
    nil, one = np.zeros_like(x), np.ones_like(x)
    # The dual conic of a circle of radius r at (x, y); it maps by H C* H^T, and its pole of the line at
    # infinity is the centre of the ellipse.
    dual = np.array([[x * x - radius**2, x * y, x], [x * y, y * y - radius**2, y], [x, y, one]])
    ellipses = np.einsum("ij,jkn,lk->nil", homography, dual + nil, homography)
    middles = ellipses[:, :2, 2] / ellipses[:, 2:, 2]
    shift: Float = middles - project(homography, places)
    return shift
