"""Joint least squares of two cameras, their relative pose, and the pose of the board in every view.

Bundle adjustment with the poses of the board eliminated (Schur complement; Triggs et al., "Bundle adjustment:
a modern synthesis", 1999): what remains is a system of the 30 parameters that all views share, of which the
distortion model says which are free. The contribution of each view to that system is kept, so that weighted
fits (bootstrap), fits of parts (cross-validation) and the covariance all come from the same few arrays.

Order of the shared parameters: fx, fy, cx, cy, then k1, k2, p1, p2, k3, k4, k5, k6 of the left camera; the same
of the right camera; rotation (vector, applied after the present one) and translation from left to right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.record import StereoCalibration
from thermacq_calibration.models import CameraModel, Float

Flags: TypeAlias = NDArray[np.bool_]

CAMERA_PARAMETERS = 12
PARAMETERS = 2 * CAMERA_PARAMETERS + 6
_CONVERGED = 1e-10
_MAX_DAMPING = 1e8
# Condition number of the normed system up to which parameters count as determined. Simulated: 1e3 to 2e5 for models
# without k4, 4e9 for the rational model of a wide-angle lens that needs it, 5e11 and more where it is not needed.
_MAX_CONDITION = 1e10


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of all views behind each other.

    Parameters
    ----------
    points_m
        (n, 3) float64, on the board.
    left, right
        (n, 2) float64 pixels.
    starts
        (views + 1,) where the corners of each view begin; the last entry is n.
    """

    points_m: Float
    left: Float
    right: Float
    starts: NDArray[np.intp]

    @classmethod
    def join(cls, views: Sequence[tuple[NDArray[Any], Float, Float]]) -> Corners:
        """From (points_m, left, right) of each view."""
        points, left, right = (
            np.vstack([np.asarray(view[k], np.float64) for view in views]) for k in range(3)
        )
        return cls(points, left, right, np.cumsum([0, *(len(view[0]) for view in views)]))

    @property
    def views(self) -> int:
        """How many views."""
        return self.starts.size - 1

    @property
    def view_of(self) -> NDArray[np.intp]:
        """(n,) index of the view that each corner belongs to."""
        return np.repeat(np.arange(self.views), np.diff(self.starts))

    def select(self, chosen: NDArray[np.intp]) -> Corners:
        """Some of the views, in this order."""
        parts = [slice(self.starts[index], self.starts[index + 1]) for index in chosen]
        return Corners.join([(self.points_m[part], self.left[part], self.right[part]) for part in parts])


@dataclass(frozen=True, eq=False)
class Geometry:
    """Two cameras, (12,) parameters each, and ``x_right = rotation @ x_left + translation_m``."""

    left: Float
    right: Float
    rotation: Float
    translation_m: Float

    @classmethod
    def of(cls, calibration: StereoCalibration) -> Geometry:
        """Geometry of a record.

        Raises
        ------
        CalibrationError
            Its distortion has more than the eight coefficients of the rational model.
        """
        left, right = (_parameters(camera) for camera in (calibration.left, calibration.right))
        return cls(left, right, calibration.rotation, calibration.translation_m)

    def moved(self, step: Float) -> Geometry:
        """After a (30,) change of the shared parameters."""
        return Geometry(
            self.left + step[:CAMERA_PARAMETERS],
            self.right + step[CAMERA_PARAMETERS : 2 * CAMERA_PARAMETERS],
            _turn(step[-6:-3]) @ self.rotation,
            self.translation_m + step[-3:],
        )

    def calibration(self, image_size: tuple[int, int]) -> StereoCalibration:
        """As a record without any report."""
        return StereoCalibration(
            image_size, _camera(self.left), _camera(self.right), self.rotation, self.translation_m
        )


@dataclass(frozen=True, eq=False)
class Poses:
    """Board to left camera, view by view: (views, 3, 3) rotations and (views, 3) metres."""

    rotations: Float
    translations_m: Float

    def select(self, chosen: NDArray[np.intp]) -> Poses:
        """Some of the views, in this order."""
        return Poses(self.rotations[chosen], self.translations_m[chosen])


@dataclass(frozen=True, eq=False)
class System:
    """Normal equations about a geometry, by view.

    Parameters
    ----------
    errors_px
        (n, 4) float64: u, v in the left, u, v in the right picture, projected minus found.
    matrix, gradient
        (views, p, p) and (views, p): share of each view in the system of the p free shared parameters.
    pose_gain, pose_step
        (views, 6, p) and (views, 6): change of a pose is ``-(pose_step + pose_gain @ change)``.
    """

    errors_px: Float
    matrix: Float
    gradient: Float
    pose_gain: Float
    pose_step: Float


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares solution and the system about it."""

    geometry: Geometry
    poses: Poses
    system: System
    free: Flags

    @property
    def errors_px(self) -> Float:
        """(n, 4) projected minus found."""
        return self.system.errors_px


def project(geometry: Geometry, points_m: Float) -> tuple[Float, Float]:
    """Pixels (n, 2) in the left and the right picture of (n, 3) points in the left camera's frame."""
    right_points = points_m @ geometry.rotation.T + geometry.translation_m
    return _project(geometry.left, points_m)[0], _project(geometry.right, right_points)[0]


def linearise(geometry: Geometry, poses: Poses, corners: Corners, free: Flags) -> System:
    """Errors and normal equations of all views, poses eliminated."""
    errors, shared, of_pose = _jacobians(geometry, poses, corners)
    error = _by_view(errors, corners)[..., None]
    by_shared, by_pose = _by_view(shared[:, :, free], corners), _by_view(of_pose, corners)
    shared_t, pose_t = by_shared.transpose(0, 2, 1), by_pose.transpose(0, 2, 1)
    mixed = pose_t @ by_shared
    solved = np.linalg.solve(pose_t @ by_pose, np.concatenate([mixed, pose_t @ error], axis=2))
    gain, step = solved[:, :, :-1], solved[:, :, -1:]
    mixed_t = mixed.transpose(0, 2, 1)
    matrix = shared_t @ by_shared - mixed_t @ gain
    gradient = shared_t @ error - mixed_t @ step
    return System(errors, matrix, gradient[..., 0], gain, step[..., 0])


def fit(
    geometry: Geometry,
    poses: Poses,
    corners: Corners,
    free: Flags,
    weights: Float | None = None,
    iterations: int = 30,
) -> Fit:
    """Weighted least squares by damped Gauss-Newton steps.

    Parameters
    ----------
    geometry, poses
        Where to start.
    corners
        What was found.
    free
        (30,) bool: which shared parameters may change; the others stay as they are.
    weights
        (views,) not negative; None weighs all alike.
    iterations
        At most so many steps; fewer when the sum of squares no longer falls.

    Raises
    ------
    numpy.linalg.LinAlgError
        A view does not determine its pose.
    """
    weight = np.ones(corners.views) if weights is None else weights
    by_corner = weight[corners.view_of]
    system = linearise(geometry, poses, corners, free)
    cost, damping = _cost(system.errors_px, by_corner), 0.0
    for _ in range(iterations):
        change = _solve(system, weight, damping)
        step = np.zeros(PARAMETERS)
        step[free] = change
        further = geometry.moved(step)
        further_poses = _moved(poses, -(system.pose_step + system.pose_gain @ change))
        tried = _attempt(further, further_poses, corners, free)
        new_cost = np.inf if tried is None else _cost(tried.errors_px, by_corner)
        if tried is not None and new_cost <= cost:
            done = cost - new_cost <= _CONVERGED * cost
            geometry, poses, system, cost = further, further_poses, tried, new_cost
            damping = 0.0 if damping < 1e-6 else damping / 10
            if done:
                break
        else:
            damping = max(10 * damping, 1e-4)
            if damping > _MAX_DAMPING:
                break
    return Fit(geometry, poses, system, free)


def fit_poses(
    geometry: Geometry, poses: Poses, corners: Corners, iterations: int = 10
) -> tuple[Poses, Float]:
    """Best poses under a fixed geometry, and their (n, 4) errors in pixels."""
    nothing = np.zeros(PARAMETERS, bool)
    found = fit(geometry, poses, corners, nothing, iterations=iterations)
    return found.poses, found.errors_px


def degrees_of_freedom(corners: Corners, free: Flags) -> int:
    """Measured coordinates less fitted parameters."""
    return 4 * len(corners.left) - int(free.sum()) - 6 * corners.views


def covariance(found: Fit, corners: Corners) -> Float | None:
    """Covariance (p, p) of the free shared parameters for independent errors of corners.

    The usual ``s^2 (J^T J)^-1`` with the variance s^2 of the residuals; None when the views leave a parameter
    undetermined.
    """
    matrix = found.system.matrix.sum(axis=0)
    scale = np.sqrt(np.diag(matrix))
    if not (scale > 0).all():
        return None
    normed = matrix / np.outer(scale, scale)
    if np.linalg.cond(normed) > _MAX_CONDITION:
        return None
    variance = np.sum(found.errors_px**2) / max(1, degrees_of_freedom(corners, found.free))
    return np.asarray(variance * np.linalg.inv(normed) / np.outer(scale, scale))


def _attempt(geometry: Geometry, poses: Poses, corners: Corners, free: Flags) -> System | None:
    """The system after a step; None when the step leads where nothing can be projected."""
    try:
        system = linearise(geometry, poses, corners, free)
    except np.linalg.LinAlgError:
        return None
    return system if np.isfinite(system.matrix).all() and np.isfinite(system.gradient).all() else None


def _solve(system: System, weight: Float, damping: float) -> Float:
    matrix = np.einsum("v,vij->ij", weight, system.matrix)
    gradient = np.einsum("v,vi->i", weight, system.gradient)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    normed = matrix / np.outer(scale, scale) + damping * np.eye(scale.size)
    # Least squares, not a plain solution: few views may leave a direction open, which then stays as it is.
    return np.asarray(-np.linalg.lstsq(normed, gradient / scale, rcond=1e-13)[0] / scale)


def _by_view(values: Float, corners: Corners) -> Float:
    """From (n, 4, ...) by corner to (views, 4 m, ...) by view, m the largest number of corners; zeros fill up."""
    counts = np.diff(corners.starts)
    view = corners.view_of
    filled = np.zeros((corners.views, int(counts.max()), *values.shape[1:]))
    filled[view, np.arange(len(values)) - corners.starts[view]] = values
    return filled.reshape(corners.views, filled.shape[1] * filled.shape[2], *values.shape[2:])


def _cost(errors: Float, by_corner: Float) -> float:
    return float(np.sum(by_corner[:, None] * errors**2))


def _jacobians(geometry: Geometry, poses: Poses, corners: Corners) -> tuple[Float, Float, Float]:
    """Errors (n, 4), their derivatives by the shared parameters (n, 4, 30) and by the pose (n, 4, 6)."""
    view = corners.view_of
    turned = np.einsum("nij,nj->ni", poses.rotations[view], corners.points_m)
    in_left = turned + poses.translations_m[view]
    turned_right = in_left @ geometry.rotation.T
    left, by_left, by_left_camera = _project(geometry.left, in_left)
    right, by_right, by_right_camera = _project(geometry.right, turned_right + geometry.translation_m)
    errors = np.hstack([left - corners.left, right - corners.right])
    count = len(errors)
    shared = np.zeros((count, 4, PARAMETERS))
    shared[:, :2, :CAMERA_PARAMETERS] = by_left_camera
    shared[:, 2:, CAMERA_PARAMETERS : 2 * CAMERA_PARAMETERS] = by_right_camera
    shared[:, 2:, -6:-3] = -by_right @ _cross(turned_right)
    shared[:, 2:, -3:] = by_right
    of_pose = np.empty((count, 4, 6))
    by_right_of_left = by_right @ geometry.rotation
    for rows, by_point in ((slice(0, 2), by_left), (slice(2, 4), by_right_of_left)):
        of_pose[:, rows, :3] = -by_point @ _cross(turned)
        of_pose[:, rows, 3:] = by_point
    return errors, shared, of_pose


def _project(camera: Float, points_m: Float) -> tuple[Float, Float, Float]:
    """Pixels (n, 2), their derivatives by the point (n, 2, 3) and by the camera's parameters (n, 2, 12)."""
    import cv2

    matrix = np.array([[camera[0], 0, camera[2]], [0, camera[1], camera[3]], [0, 0, 1]])
    still = np.zeros(3)
    pixels, jacobian = cv2.projectPoints(points_m.reshape(-1, 1, 3), still, still, matrix, camera[4:])
    # OpenCV's columns: rotation, translation (here that of the point), fx, fy, cx, cy, distortion.
    by = np.asarray(jacobian, np.float64).reshape(-1, 2, 10 + 8)
    return np.asarray(pixels, np.float64).reshape(-1, 2), by[:, :, 3:6], by[:, :, 6:]


def _cross(vectors: Float) -> Float:
    """(n, 3, 3) matrices of the cross product with (n, 3) vectors."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _moved(poses: Poses, steps: Float) -> Poses:
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
    return Poses(turns @ poses.rotations, poses.translations_m + steps[:, 3:])


def _turn(vector: Float) -> Float:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _parameters(camera: CameraModel) -> Float:
    matrix = camera.matrix
    if camera.distortion[8:].any():
        raise CalibrationError("distortion with prism or tilt coefficients cannot be judged here")
    distortion = np.zeros(8)
    distortion[: min(8, camera.distortion.size)] = camera.distortion[:8]
    return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion])


def _camera(parameters: Float) -> CameraModel:
    fx, fy, cx, cy = parameters[:4]
    distortion = parameters[4:] if parameters[9:].any() else parameters[4:9]
    return CameraModel(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), distortion)
