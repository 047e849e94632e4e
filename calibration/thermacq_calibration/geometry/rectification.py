"""Rectification: make the rows of both pictures correspond, without losing hundredths of a pixel.

`rectify` turns a calibration into maps; `apply` resamples a pair with them. Rectified pictures have the
size of the originals and keep their scale: the common focal length is the mean of the four calibrated
ones, so that one rectified pixel is one camera pixel in the middle of the picture; nothing is zoomed to
hide the invalid border, which is NaN instead. Both principal points get the same pixel coordinates, so
that infinity has disparity 0 and eq. 1 of the paper holds as it stands (``doffs_px`` is 0; only a
calibration made by `StereoCalibration.from_rectified` may have another).

Resampling is by cubic splines (`scipy.ndimage.spline_filter`, then a precomputed sparse gather), because
`cv2.remap` rounds each coordinate to 1/32 pixel: a systematic shift of up to 0.016 px, of a disparity
budget of 0.03 px. Measured on a texture with wavelengths of 8 to 30 px rotated by 1 degree, 640 x 512:

====================================  ================  ==========
method                                position rms, px  ms/picture
====================================  ================  ==========
cv2.remap linear                      0.021             0.6
cv2.remap cubic                       0.031             1.1
cv2.remap Lanczos4                    0.006             4.5
cubic spline, sparse gather (here)    0.0003            12
scipy.ndimage.map_coordinates         0.0003            25
====================================  ================  ==========

At wavelengths of 3 to 8 px the spline's error grows to 0.004 px. Maps are float32: 3e-5 px at column 640.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.record import StereoCalibration
from thermacq_calibration.models import CameraModel, Float

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Picture: TypeAlias = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Resampling:
    """How one camera's pictures are resampled.

    Parameters
    ----------
    map_x, map_y
        (rows, columns) float32: column and row in the camera's picture of each rectified pixel.
    valid
        (rows, columns) bool: whether that place lies inside the camera's picture.
    """

    map_x: Picture
    map_y: Picture
    valid: NDArray[np.bool_]

    @cached_property
    def _gather(self) -> csr_array[Any, tuple[int, int]]:
        """(valid pixels, pixels) float32: cubic B-spline weights of the 4 x 4 coefficients around."""
        from scipy.sparse import csr_array

        rows, columns = self.valid.shape
        index_x, weight_x = _spline_taps(self.map_x[self.valid], columns)
        index_y, weight_y = _spline_taps(self.map_y[self.valid], rows)
        index = (index_y[:, :, None] * np.int32(columns) + index_x[:, None, :]).ravel()
        weight = (weight_y[:, :, None] * weight_x[:, None, :]).ravel()
        starts = np.arange(0, index.size + 1, 16, dtype=np.int32)
        return csr_array((weight, index, starts), shape=(len(index_x), rows * columns))

    def resample(self, counts: NDArray[Any]) -> Picture:
        """Resample one picture, (rows, columns) any real type, to float32 with NaN outside."""
        from scipy.ndimage import spline_filter

        picture = np.asarray(counts, dtype=np.float32)
        bad = ~np.isfinite(picture)
        has_bad = bool(bad.any())
        if has_bad:
            picture = np.where(bad, np.median(picture[~bad]) if not bad.all() else np.float32(0), picture)
        coefficients = spline_filter(picture, order=3, output=np.float32, mode="mirror")
        values = self._gather @ coefficients.ravel()
        if has_bad:
            values[bad.ravel()[self._gather.indices].reshape(-1, 16).any(axis=1)] = np.nan
        rectified = np.full(self.valid.shape, np.nan, np.float32)
        rectified[self.valid] = values
        return rectified


@dataclass(frozen=True, eq=False)
class Rectification:
    """Rectified geometry of a calibration, and how to get there.

    Depth in metres of disparity d: ``baseline_m * focal_px / (d + doffs_px)``. The rectified left camera
    frame has x to the right, y down, z forward; (u, v) at depth z is the point
    ``z * ((u - u0) / focal_px, (v - v0) / focal_px, 1)`` with ``(u0, v0) = principal_point_px`` (eq. 2).

    Parameters
    ----------
    image_size
        (columns, rows).
    focal_px
        Common focal length.
    principal_point_px
        (u0, v0) of the left picture; the right one has (u0 + doffs_px, v0).
    baseline_m
        Distance between the optical centres.
    doffs_px
        Column of the right principal point minus that of the left one.
    rotation_left, rotation_right
        (3, 3) float64: camera frame to rectified frame.
    projection_left, projection_right
        (3, 4) float64: rectified left camera frame (metres) to rectified pixels.
    left, right
        Resampling of each camera; None when the pictures are rectified already.
    """

    image_size: tuple[int, int]
    focal_px: float
    principal_point_px: tuple[float, float]
    baseline_m: float
    doffs_px: float
    rotation_left: Float
    rotation_right: Float
    left: Resampling | None
    right: Resampling | None

    @property
    def projection_left(self) -> Float:
        """(3, 4) float64, rectified left camera frame to rectified left pixels."""
        u0, v0 = self.principal_point_px
        return np.array([[self.focal_px, 0, u0, 0], [0, self.focal_px, v0, 0], [0, 0, 1, 0]])

    @property
    def projection_right(self) -> Float:
        """(3, 4) float64, rectified left camera frame to rectified right pixels."""
        projection = self.projection_left
        projection[0, 2] += self.doffs_px
        projection[0, 3] = -self.focal_px * self.baseline_m
        return projection

    @property
    def valid(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(rows, columns) bool of the left and the right picture: where rectified pixels have counts."""
        everywhere = np.ones(self.image_size[::-1], bool)
        return (
            everywhere if self.left is None else self.left.valid,
            everywhere if self.right is None else self.right.valid,
        )


def rectify(calibration: StereoCalibration) -> Rectification:
    """Rectified geometry and resampling maps of a calibration.

    Pictures whose calibration is rectified already (no rotation, no distortion, same focal length and
    rows, translation along columns only) are not resampled.

    Raises
    ------
    CalibrationError
        The cameras stand above each other, or left and right are exchanged.
    """
    if calibration.translation_m[0] >= 0:
        raise CalibrationError(
            "left and right are exchanged: the right camera stands to the left of the left one",
            remedy="Calibrate again with the two sides exchanged.",
        )
    if _is_rectified(calibration):
        return _as_given(calibration)
    rotation_left, rotation_right = rectifying_rotations(calibration)
    matrices = (calibration.left.matrix, calibration.right.matrix)
    focal = float(np.mean([(matrix[0, 0], matrix[1, 1]) for matrix in matrices]))
    centre = _principal_point(calibration, focal, rotation_left, rotation_right)
    return Rectification(
        image_size=calibration.image_size,
        focal_px=focal,
        principal_point_px=centre,
        baseline_m=calibration.baseline_m,
        doffs_px=0.0,
        rotation_left=rotation_left,
        rotation_right=rotation_right,
        left=_resampling(calibration.left, rotation_left, focal, centre, calibration.image_size),
        right=_resampling(calibration.right, rotation_right, focal, centre, calibration.image_size),
    )


def apply(rectification: Rectification, left: NDArray[Any], right: NDArray[Any]) -> tuple[Picture, Picture]:
    """Rectify a pair of pictures.

    Parameters
    ----------
    rectification
        Made by `rectify`; keep it, its first use precomputes 40 MB of weights per camera.
    left, right
        (rows, columns) real numbers, counts; non-finite pixels stay so, with their neighbours.

    Returns
    -------
    tuple of numpy.ndarray
        Two (rows, columns) float32 pictures, NaN outside.

    Raises
    ------
    CalibrationError
        A picture has another size than the calibration.
    """
    columns, rows = rectification.image_size
    for name, picture in (("left", left), ("right", right)):
        if picture.shape != (rows, columns):
            size = " x ".join(str(length) for length in picture.shape[::-1])
            raise CalibrationError(
                f"the {name} picture has {size} pixels, the calibration is for {columns} x {rows}",
                remedy="Use the calibration of these cameras.",
            )
    sides = ((rectification.left, left), (rectification.right, right))
    first, second = (
        np.asarray(picture, np.float32) if side is None else side.resample(picture) for side, picture in sides
    )
    return first, second


def rectify_points(camera: CameraModel, points: NDArray[Any], rotation: Float, projection: Float) -> Float:
    """Where image points of a camera lie in its rectified picture.

    Parameters
    ----------
    camera
        Camera model.
    points
        (n, 2) pixels (u, v).
    rotation
        (3, 3) camera frame to rectified frame.
    projection
        (3, 3) or (3, 4) rectified camera matrix; only its first three columns matter.

    Returns
    -------
    numpy.ndarray
        (n, 2) float64, rectified pixels.
    """
    import cv2

    source = np.asarray(points, np.float64).reshape(-1, 1, 2)
    # OpenCV's default is 5 iterations, which leaves hundredths of a pixel at the corners.
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    rectified = cv2.undistortPoints(
        source, camera.matrix, camera.distortion, R=rotation, P=projection[:, :3], criteria=criteria
    )
    return np.asarray(rectified, np.float64).reshape(-1, 2)


def rectifying_rotations(calibration: StereoCalibration) -> tuple[Float, Float]:
    """Rotations (3, 3) from each camera frame to the rectified frame, each camera turned by half.

    Raises
    ------
    CalibrationError
        The cameras stand above each other rather than side by side.
    """
    import cv2

    left, right = calibration.left, calibration.right
    rotation_left, rotation_right, _, projection, *_ = cv2.stereoRectify(
        left.matrix,
        left.distortion,
        right.matrix,
        right.distortion,
        calibration.image_size,
        calibration.rotation,
        calibration.translation_m.reshape(3, 1),
    )
    if projection[1, 3] != 0:
        raise CalibrationError(
            "the cameras stand above each other; thermacq needs them side by side along the columns",
            remedy="Turn both pictures by 90 degrees, or mount the cameras side by side.",
        )
    return np.asarray(rotation_left, np.float64), np.asarray(rotation_right, np.float64)


def vertical_differences_px(calibration: StereoCalibration, left: NDArray[Any], right: NDArray[Any]) -> Float:
    """Row in the left minus row in the right rectified picture of corresponding points.

    Zero for perfect points and a perfect calibration, whatever the depth. Works for exchanged sides too.

    Parameters
    ----------
    calibration
        The calibration to judge.
    left, right
        (n, 2) pixels (u, v), the same points in both pictures.

    Returns
    -------
    numpy.ndarray
        (n,) float64, pixels.
    """
    rotation_left, rotation_right = rectifying_rotations(calibration)
    focal = float(np.mean([calibration.left.matrix[1, 1], calibration.right.matrix[1, 1]]))
    projection = np.diag([focal, focal, 1.0])
    rows_left = rectify_points(calibration.left, left, rotation_left, projection)[:, 1]
    rows_right = rectify_points(calibration.right, right, rotation_right, projection)[:, 1]
    return rows_left - rows_right


def _is_rectified(calibration: StereoCalibration) -> bool:
    left, right = calibration.left, calibration.right
    same = left.matrix.copy()
    same[0, 2] = right.matrix[0, 2]
    return (
        np.array_equal(calibration.rotation, np.eye(3))
        and not calibration.translation_m[1:].any()
        and not left.distortion.any()
        and not right.distortion.any()
        and np.array_equal(same, right.matrix)
        and left.matrix[0, 0] == left.matrix[1, 1]
        and left.matrix[0, 1] == 0
    )


def _as_given(calibration: StereoCalibration) -> Rectification:
    left, right = calibration.left.matrix, calibration.right.matrix
    return Rectification(
        image_size=calibration.image_size,
        focal_px=float(left[0, 0]),
        principal_point_px=(float(left[0, 2]), float(left[1, 2])),
        baseline_m=calibration.baseline_m,
        doffs_px=float(right[0, 2] - left[0, 2]),
        rotation_left=np.eye(3),
        rotation_right=np.eye(3),
        left=None,
        right=None,
    )


def _principal_point(
    calibration: StereoCalibration, focal: float, rotation_left: Float, rotation_right: Float
) -> tuple[float, float]:
    """Principal point that centres what both cameras see: mean over the corners of both pictures."""
    columns, rows = calibration.image_size
    corners = np.array([(u, v) for u in (0, columns - 1) for v in (0, rows - 1)], np.float64)
    projection = np.diag([focal, focal, 1.0])
    seen = np.vstack(
        [
            rectify_points(calibration.left, corners, rotation_left, projection),
            rectify_points(calibration.right, corners, rotation_right, projection),
        ]
    )
    u0, v0 = np.array([(columns - 1) / 2, (rows - 1) / 2]) - seen.mean(axis=0)
    return float(u0), float(v0)


def _resampling(
    camera: CameraModel, rotation: Float, focal: float, centre: tuple[float, float], size: tuple[int, int]
) -> Resampling:
    import cv2

    projection = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    maps = cv2.initUndistortRectifyMap(
        camera.matrix, camera.distortion, rotation, projection, size, cv2.CV_32FC1
    )
    map_x, map_y = (np.asarray(one, np.float32) for one in maps)
    inside_x = (map_x >= 0) & (map_x <= size[0] - 1)
    inside_y = (map_y >= 0) & (map_y <= size[1] - 1)
    return Resampling(map_x, map_y, inside_x & inside_y)


def _spline_taps(places: Picture, length: int) -> tuple[NDArray[np.int32], Picture]:
    """Indices and cubic B-spline weights, both (n, 4), of the coefficients around each place."""
    first = np.floor(places).astype(np.int32)
    t = (places - first).astype(np.float64)
    weights = np.stack(
        [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, 3 * (1 - t) ** 3 - 6 * (1 - t) ** 2 + 4, t**3], axis=1
    )
    index = np.abs(first[:, None] + np.arange(-1, 3, dtype=np.int32))
    last = length - 1
    mirrored = np.where(index > last, 2 * last - index, index)
    return mirrored.astype(np.int32), (weights / 6).astype(np.float32)
