"""The still water as a plane: random sample consensus, then least squares (paper, V.B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError

_HYPOTHESES = 300
_SAMPLE = 20_000
_LEAST_POINTS = 50
_BLOCKS_PX = (48, 96)
"""Sides of the blocks of pixels whose errors are taken as one; see `plane_covariance`."""


@dataclass(frozen=True)
class Plane:
    """Plane ``normal · X + distance_m = 0`` in the left rectified camera.

    Parameters
    ----------
    normal
        (3,) float64 unit vector towards the camera.
    distance_m
        Distance of the camera from the plane.
    sigma_m
        Standard deviation of the inliers' distances.
    points
        Number of inliers.
    """

    normal: NDArray[np.float64]
    distance_m: float
    sigma_m: float
    points: int

    def height_m(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distance of points (..., 3) from the plane, positive towards the camera."""
        height: NDArray[np.float64] = points @ self.normal + self.distance_m
        return height


def fit_plane(points: NDArray[np.float64], threshold_m: float, seed: int = 0) -> Plane:
    """Fit a plane by RANSAC, then by least squares of the distances of its inliers.

    Parameters
    ----------
    points
        (..., 3) float64, metres; points with NaN are left out.
    threshold_m
        A point closer than this to a plane supports it.
    seed
        Seed of the random samples; the same seed gives the same plane.

    Raises
    ------
    ReconstructionError
        There are fewer than 50 points, or no plane is supported by half of them.
    """
    flat = points.reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    if len(flat) < _LEAST_POINTS:
        raise ReconstructionError(
            f"a plane needs at least {_LEAST_POINTS} points, and only {len(flat)} were matched",
            remedy="Look at a frame with `thermacq disparity`; widen the disparity range or add texture.",
        )
    rng = np.random.default_rng(seed)
    sample = flat[rng.choice(len(flat), _SAMPLE, replace=False)] if len(flat) > _SAMPLE else flat
    normal, distance = _consensus(sample, threshold_m, rng)
    for _ in range(3):
        inliers = np.abs(flat @ normal + distance) < threshold_m
        if inliers.sum() < 0.5 * len(flat):
            raise ReconstructionError(
                f"no plane is supported by half of the {len(flat)} points (the best one by "
                f"{100 * inliers.mean():.0f} %): this is not a flat water surface",
                remedy="Record still water that fills most of the view, or check the calibration.",
            )
        normal, distance = _least_squares(flat[inliers])
    if distance < 0:
        normal, distance = -normal, -distance
    heights = flat[inliers] @ normal + distance
    return Plane(normal, float(distance), float(heights.std()), int(inliers.sum()))


def plane_covariance(
    plane: Plane, points: NDArray[np.float64], axes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Covariance of the plane's height (m) and slopes along two axes, from its residuals.

    Errors of neighbouring pixels are far from independent: they share matching windows, and what calibration
    and shading bend is smooth. So the plane is fitted again without each block of pixels in turn,
    and the covariance follows from how it moves: the jackknife by blocks (the cluster-robust estimator CR3 of
    Bell & McCaffrey 2002). Errors that reach across the edges
    of blocks make every block size fall short by about the correlation length over its side; two sizes show by
    how much, and the larger one is scaled up accordingly. What is the same all over the picture, such as a wrong baseline, no residual shows.

    Parameters
    ----------
    plane
        The fitted plane.
    points
        (rows, columns, 3) float64, metres, in picture order.
    axes
        (2, 3) float64, unit vectors in the plane: directions of the slopes.

    Returns
    -------
    numpy.ndarray
        (3, 3) float64: height at the foot of the camera (m), slope along each axis; NaN from fewer than four
        blocks.
    """
    known = np.isfinite(points).all(axis=-1)
    rows, columns = np.nonzero(known)
    flat = points[known]
    residuals = plane.height_m(flat)
    inliers = np.abs(residuals) < 5.0 * max(plane.sigma_m, 1e-12)
    design = np.column_stack([np.ones(len(flat)), flat @ axes.T])[inliers]
    blocks = [(rows[inliers] // side) * points.shape[1] + columns[inliers] // side for side in _BLOCKS_PX]
    fine, coarse = (_jackknife(design, residuals[inliers], block) for block in blocks)
    if not np.isfinite(coarse).all():
        return fine
    growth = float(np.mean(np.diag(coarse) / np.maximum(np.diag(fine), 1e-30)))
    # Bias of -c / side: V = 2 V(coarse) - V(fine) for sides in the ratio 2, as a factor so that it stays positive.
    return (coarse if growth > 1 else fine) * max(1.0, 2.0 - 1.0 / max(growth, 0.5))


def _jackknife(
    design: NDArray[np.float64], residuals: NDArray[np.float64], block: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Covariance of a linear fit from leaving out one block after the other."""
    order = np.argsort(block, kind="stable")
    edges = np.flatnonzero(np.diff(block[order])) + 1
    members = np.split(order, edges)
    if len(members) <= design.shape[1]:
        return np.full((3, 3), np.nan)
    normal = design.T @ design
    moved = np.stack(
        [
            -np.linalg.pinv(normal - design[one].T @ design[one]) @ (design[one].T @ residuals[one])
            for one in members
        ]
    )
    covariance: NDArray[np.float64] = (len(moved) - 1) / len(moved) * moved.T @ moved
    return covariance


def _consensus(
    points: NDArray[np.float64], threshold_m: float, rng: np.random.Generator
) -> tuple[NDArray[np.float64], float]:
    """The best of many planes through three random points each."""
    corners = points[rng.integers(0, len(points), (_HYPOTHESES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    usable = length[:, 0] > 1e-12
    if not usable.any():
        raise ReconstructionError("the matched points lie on one line: there is no plane through them")
    normals, corners = normals[usable] / length[usable], corners[usable]
    distances = -np.einsum("ij,ij->i", normals, corners[:, 0])
    support = [
        np.count_nonzero(np.abs(points @ normal + distance) < threshold_m)
        for normal, distance in zip(normals, distances, strict=True)
    ]
    best = int(np.argmax(support))
    return normals[best], float(distances[best])


def _least_squares(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Plane with the least squared distances: through the centroid, across the thinnest direction."""
    centroid = points.mean(axis=0)
    centred = points - centroid
    _, vectors = np.linalg.eigh(centred.T @ centred)
    normal = vectors[:, 0]
    return normal, float(-normal @ centroid)
