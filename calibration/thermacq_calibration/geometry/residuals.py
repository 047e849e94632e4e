"""What a record leaves unexplained: found less projected corners, view by view, from the record alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermacq_calibration.geometry.bundle import Corners, Geometry, Poses, fit_poses
from thermacq_calibration.geometry.record import StereoCalibration
from thermacq_calibration.models import Float
from thermacq_calibration.targets.boards import board_points


@dataclass(frozen=True, eq=False)
class Residuals:
    """Corners of one view and what is left of them.

    Parameters
    ----------
    name
        The view.
    used
        Whether it took part in the calibration.
    left, right
        (n, 2) float64 pixels, found corners.
    left_error_px, right_error_px
        (n, 2) found less projected, with the pose of the board that fits both pictures best.
    """

    name: str
    used: bool
    left: Float
    right: Float
    left_error_px: Float
    right_error_px: Float


def residuals(calibration: StereoCalibration) -> list[Residuals]:
    """Residuals of all views in which both cameras saw the board; empty for a record without corners."""
    if calibration.board is None or not calibration.corners:
        return []
    points = board_points(calibration.board).astype(np.float64)
    geometry = Geometry.of(calibration)
    used = {view.name for view in calibration.views if view.used}
    found = []
    for name, seen in calibration.corners.items():
        left, right = (np.array(seen[side], np.float64) for side in ("left", "right"))
        corners = Corners.join([(points[seen["points"]], left, right)])
        _, errors = fit_poses(geometry, _start(calibration, corners), corners)
        found.append(Residuals(name, name in used, left, right, -errors[:, :2], -errors[:, 2:]))
    return found


def _start(calibration: StereoCalibration, corners: Corners) -> Poses:
    """Pose of the board from the left picture alone."""
    import cv2

    camera = calibration.left
    _, turn, shift = cv2.solvePnP(corners.points_m, corners.left, camera.matrix, camera.distortion)
    return Poses(
        np.asarray(cv2.Rodrigues(turn)[0], np.float64)[None], np.reshape(shift, (1, 3)).astype(float)
    )
