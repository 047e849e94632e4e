"""From corners to the first joint solution: each camera alone, then both together.

Each camera is calibrated alone with OpenCV (Zhang's method); the relative pose of the cameras is the median over
the views; from there `thermacq_calibration.geometry.bundle` refines everything together. On real pairs this halves the
influence of single views against calibrating each camera and then only the relative pose.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.bundle import Corners, Fit, Geometry, Poses, fit
from thermacq_calibration.geometry.distortion import CANDIDATES, FIRST, free_parameters
from thermacq_calibration.models import Float

_Mono: TypeAlias = tuple[float, Float, Float, Float]


def first_solution(corners: Corners, image_size: tuple[int, int]) -> Fit:
    """Joint solution with the first distortion model.

    Raises
    ------
    CalibrationError
        The views do not determine a geometry.
    """
    left, right = (_calibrate(corners, side, image_size, FIRST) for side in (corners.left, corners.right))
    (_, left_camera, left_turns, left_shifts), (_, right_camera, right_turns, right_shifts) = left, right
    turns = right_turns @ left_turns.transpose(0, 2, 1)
    shifts = right_shifts - np.einsum("nij,nj->ni", turns, left_shifts)
    u, _, vt = np.linalg.svd(np.median(turns, axis=0))
    start = Geometry(left_camera, right_camera, u @ vt, np.median(shifts, axis=0))
    try:
        found = fit(start, Poses(left_turns, left_shifts), corners, free_parameters(FIRST))
    except np.linalg.LinAlgError:
        raise undetermined("a view does not determine the pose of the board") from None
    if not np.isfinite(found.errors_px).all():
        raise undetermined("the fit did not converge")
    return found


def rms_alone(corners: Corners, image_size: tuple[int, int], model: str) -> tuple[float, float]:
    """Reprojection error of the left and the right camera, each calibrated alone."""
    left, right = (_calibrate(corners, side, image_size, model)[0] for side in (corners.left, corners.right))
    return left, right


def undetermined(detail: str) -> CalibrationError:
    """The error for views that leave the geometry open."""
    return CalibrationError(
        f"the views do not determine the geometry of the cameras ({detail})",
        remedy="Tilt the board by 20 to 40 degrees about both axes, and show it all over the picture.",
    )


def _calibrate(corners: Corners, pixels: Float, image_size: tuple[int, int], model: str) -> _Mono:
    """RMS, the camera's 12 parameters, rotations (views, 3, 3) and translations (views, 3)."""
    import cv2

    parts = [slice(*corners.starts[view : view + 2]) for view in range(corners.views)]
    points = [corners.points_m[part].astype(np.float32) for part in parts]
    found = [pixels[part].astype(np.float32) for part in parts]
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9)
    try:
        guess = cv2.initCameraMatrix2D(points, found, image_size)
        rms, matrix, distortion, rvecs, tvecs = cv2.calibrateCamera(
            points, found, image_size, guess, np.zeros(8), flags=_flags(model), criteria=stop
        )
    except cv2.error as error:
        raise undetermined(str(error.err)) from None
    values = np.asarray(matrix, np.float64)
    camera = [values[0, 0], values[1, 1], values[0, 2], values[1, 2], *_eight(distortion)]
    turns = np.array([cv2.Rodrigues(vector)[0] for vector in rvecs], np.float64)
    return float(rms), np.array(camera), turns, np.array([np.ravel(vector) for vector in tvecs], np.float64)


def _flags(model: str) -> int:
    """OpenCV's flags for a candidate."""
    import cv2

    free = CANDIDATES[model]
    flags = int(cv2.CALIB_USE_INTRINSIC_GUESS)
    if "p1" not in free:
        flags |= cv2.CALIB_ZERO_TANGENT_DIST
    if "k4" in free:
        return flags | cv2.CALIB_RATIONAL_MODEL
    for name, fixed in (("k1", cv2.CALIB_FIX_K1), ("k2", cv2.CALIB_FIX_K2), ("k3", cv2.CALIB_FIX_K3)):
        flags |= 0 if name in free else fixed
    return flags


def _eight(distortion: NDArray[Any]) -> Float:
    values = np.zeros(8)
    given = np.ravel(distortion)[:8]
    values[: given.size] = given
    return values
