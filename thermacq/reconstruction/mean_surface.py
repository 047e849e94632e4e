"""The mean disparity of many frames and its variance, from parts that add up in any order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq.reconstruction.plane import Plane
from thermacq.reconstruction.triangulation import triangulate
from thermacq_calibration import Rectification


@dataclass(frozen=True)
class DisparityMean:
    """Mean and variance over frames of every pixel's disparity; three (rows, columns) float64 arrays.

    Parameters
    ----------
    count
        Frames in which the pixel was matched.
    mean_px
        Mean disparity, 0 where it never was.
    square_px2
        Sum of squared deviations from the mean.
    """

    count: NDArray[np.float64]
    mean_px: NDArray[np.float64]
    square_px2: NDArray[np.float64]

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> DisparityMean:
        """Nothing yet."""
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape))

    def add(self, disparity: NDArray[np.float32]) -> DisparityMean:
        """With one more frame, (rows, columns) float32, NaN where it was not matched."""
        matched = np.isfinite(disparity)
        one = DisparityMean(
            matched.astype(np.float64), np.where(matched, disparity, 0.0), np.zeros(disparity.shape)
        )
        return self.merge(one)

    def merge(self, other: DisparityMean) -> DisparityMean:
        """Both together (Chan, Golub & LeVeque 1983, updating formulae for variances)."""
        count = self.count + other.count
        difference = other.mean_px - self.mean_px
        weight = other.count / np.maximum(count, 1)
        return DisparityMean(
            count,
            self.mean_px + weight * difference,
            self.square_px2 + other.square_px2 + difference**2 * self.count * weight,
        )

    def often_matched(self) -> NDArray[np.float32]:
        """Mean disparity where at least half as many frames as at the best pixel were matched, else NaN."""
        often = (self.count > 0) & (self.count >= 0.5 * self.count.max(initial=0.0))
        return np.where(often, self.mean_px, np.nan).astype(np.float32)

    def variance_px2(self) -> NDArray[np.float64]:
        """Variance over frames; NaN for pixels matched less than twice."""
        return np.where(self.count > 1, self.square_px2 / np.maximum(self.count - 1, 1), np.nan)


def points_of(disparity: NDArray[np.float32], rectification: Rectification) -> NDArray[np.float64]:
    """Points (rows, columns, 3) of a disparity map in the rectified left camera, metres."""
    return triangulate(
        disparity,
        focal_px=rectification.focal_px,
        principal_point_px=rectification.principal_point_px,
        baseline_m=rectification.baseline_m,
        doffs_px=rectification.doffs_px,
    )


def single_frame_sigma_m(mean: DisparityMean, plane: Plane, rectification: Rectification) -> float:
    """Standard deviation of the points of single frames from the plane, without keeping the frames.

    The variance over frames of a pixel, carried to its distance from the plane, plus the square of the
    distance of its mean. A point moves along its ray, so its height changes by
    ``(height of the camera / z) dz`` near the plane, with dz = z² / (B f) dd.
    """
    disparity = mean.often_matched()
    points = points_of(disparity, rectification)
    z = points[..., 2]
    per_pixel_m = plane.distance_m * z / (rectification.baseline_m * rectification.focal_px)
    variance = np.nan_to_num(mean.variance_px2()) * per_pixel_m**2
    height = plane.height_m(points)
    known = np.isfinite(height)
    # The same robustness as the fit: what RANSAC left out is not still water.
    inliers = known & (np.abs(np.where(known, height, 0.0)) < 5.0 * max(plane.sigma_m, 1e-9))
    return float(np.sqrt((height[inliers] ** 2 + variance[inliers]).mean()))
