"""Where and how a board was held in a picture, from its corners alone, before any camera is calibrated.

The first four figures are those of ROS' camera_calibration (Bowman and Mihelich): position, size and skew.
Tilt and its direction come from the homography of the board: its scale varies over the board as 1/depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermacq_calibration.models import Board, Float
from thermacq_calibration.targets.boards import board_points
from thermacq_calibration.targets.detection import Detection
from thermacq_calibration.targets.sampling import fit_homography, project


@dataclass(frozen=True)
class Sample:
    """A board in a picture.

    Parameters
    ----------
    x, y
        Position of the middle, 0 to 1: where the board touches the left or upper border, and the opposite one.
    size
        Root of the part of the picture that the board covers.
    skew
        How far a corner of the board is from a right angle, 0 to 1 (at 30 degrees).
    tilt_deg
        Tilt against the line of sight, without its sign.
    away
        Direction in the picture, (u, v) of length 1, in which the board recedes; (0, 0) when it does not.
    """

    x: float
    y: float
    size: float
    skew: float
    tilt_deg: float
    away: tuple[float, float]

    def distance(self, other: Sample) -> float:
        """Sum of the differences of position, size and skew."""
        return (
            abs(self.x - other.x)
            + abs(self.y - other.y)
            + abs(self.size - other.size)
            + abs(self.skew - other.skew)
        )


def sample_of(found: Detection, board: Board, image_size: tuple[int, int]) -> Sample | None:
    """How a board was held; None when its corners do not lie on a plane.

    Parameters
    ----------
    found
        The board in one picture; a part of it is enough.
    board
        The board.
    image_size
        (columns, rows) of the picture.
    """
    points = board_points(board)[:, :2].astype(np.float64)
    homography = fit_homography(points[found.indices], found.corners)
    if homography is None:
        return None
    (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
    outline = project(homography, np.array([[left, top], [right, top], [right, bottom], [left, bottom]]))
    size_px = np.array(image_size, float)
    root = float(np.sqrt(_area(outline)))
    x, y = np.clip((outline.mean(axis=0) - root / 2) / np.maximum(size_px - root, 1.0), 0, 1)
    tilt_deg, away = _tilt(homography, (points.min(axis=0) + points.max(axis=0)) / 2)
    return Sample(float(x), float(y), root / float(np.sqrt(size_px.prod())), _skew(outline), tilt_deg, away)


def _area(outline: Float) -> float:
    u, v = outline.T
    return float(abs(np.dot(u, np.roll(v, 1)) - np.dot(v, np.roll(u, 1))) / 2)


def _skew(outline: Float) -> float:
    one, other = outline[0] - outline[1], outline[2] - outline[1]
    cosine = np.dot(one, other) / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(min(1.0, 2 * abs(np.pi / 2 - np.arccos(np.clip(cosine, -1, 1)))))


def _tilt(homography: Float, middle: Float) -> tuple[float, tuple[float, float]]:
    """Tilt in degrees and the direction in the picture in which the board recedes.

    At the middle of the board the scale along the axis of the tilt is focal length / depth, and across it
    less by the cosine of the tilt (exactly so on the optical axis).
    """
    pixel = project(homography, middle)
    scale = homography[2, :2] @ middle + homography[2, 2]
    jacobian = (homography[:2, :2] - np.outer(pixel, homography[2, :2])) / scale
    large, small = np.linalg.svd(jacobian, compute_uv=False)
    tilt_deg = float(np.degrees(np.arccos(np.clip(small / large, 0, 1))))
    # Depth is proportional to the last coordinate, so it grows along this direction on the board.
    recedes = jacobian @ (homography[2, :2] / scale)
    length = float(np.linalg.norm(recedes))
    return tilt_deg, (0.0, 0.0) if length == 0 else (float(recedes[0] / length), float(recedes[1] / length))
