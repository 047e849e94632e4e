"""Crossings of light and dark squares to a fraction of a pixel, and the edges between them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Float
from thermacq_calibration.targets.sampling import sample

_ITERATIONS = 6
_MIN_RADIUS_PX = 2.0
_PROFILE_STEPS = 21
# For a Gaussian blur the width from 10 % to 90 % is 2.563 sigma, and the steepest slope 1 / (sigma sqrt(2 pi)).
_WIDTH_TIMES_SLOPE = 2.563 / np.sqrt(2 * np.pi)


def refine_saddles(picture: NDArray[Any], points: Float, radius_px: Float | float) -> Float:
    """Move points to the saddles of the picture near them.

    A second-order surface is fitted to the counts around each point, weighted by a Gaussian; its stationary
    point is the next estimate. Symmetric blur does not move it.

    Parameters
    ----------
    picture
        (rows, columns) counts.
    points
        (n, 2) float64 pixels (u, v).
    radius_px
        Radius of the surroundings that count: one for all, or (n,).

    Returns
    -------
    numpy.ndarray
        (n, 2) float64; NaN where there is no saddle, or too near to the border.
    """
    refined = np.array(points, np.float64)
    values = np.asarray(picture, np.float64)
    radii = np.broadcast_to(np.maximum(radius_px, _MIN_RADIUS_PX), len(refined))
    for index, radius in enumerate(radii):
        for _ in range(_ITERATIONS):
            refined[index] += _step_to_saddle(values, refined[index], float(radius))
    return refined


def _step_to_saddle(values: Float, point: Float, radius: float) -> Float:
    """Step (2,) from a point to the saddle of the surface fitted around it; NaN when there is none."""
    nowhere = np.full(2, np.nan)
    if not np.isfinite(point).all():
        return nowhere
    reach = int(np.ceil(2 * radius))
    u, v = np.rint(point).astype(int)
    if u < reach or v < reach or u + reach >= values.shape[1] or v + reach >= values.shape[0]:
        return nowhere
    patch = values[v - reach : v + reach + 1, u - reach : u + reach + 1].ravel()
    y, x = (grid.ravel() for grid in np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(float))
    x, y = x - (point[0] - u), y - (point[1] - v)
    weight = np.exp(-(x**2 + y**2) / (2 * (0.6 * radius) ** 2))
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    # Normal equations by einsum: threads of BLAS would cost more than they gain on such small sums.
    normal = np.einsum("ik,jk,k->ij", terms, terms, weight**2, optimize=False)
    _, gx, gy, xx, xy, yy = np.linalg.solve(normal, np.einsum("ik,k,k->i", terms, weight**2, patch))
    curvature = 4 * xx * yy - xy * xy
    if curvature >= 0:
        return nowhere
    step: Float = np.array([xy * gy - 2 * yy * gx, xy * gx - 2 * xx * gy]) / curvature
    return step if np.abs(step).max() <= radius else nowhere


def edge_profile(
    picture: NDArray[Any], corners: Float, found: NDArray[np.bool_], reach: float
) -> tuple[float, float]:
    """Width and height of the edges between neighbouring corners.

    Parameters
    ----------
    picture
        (rows, columns) counts.
    corners
        (rows, columns, 2) pixels of the corners of squares.
    found
        (rows, columns) which corners are known.
    reach
        How far from an edge, in squares, the squares are plain.

    Returns
    -------
    width_px : float
        From 10 % to 90 %, the worse of the two directions.
    contrast : float
        Difference between light and dark squares, counts.
    """
    profiles = [
        _mean_profile(picture, np.swapaxes(corners, 0, axis), np.swapaxes(found, 0, axis), reach)
        for axis in (0, 1)
    ]
    contrasts = [profile[-4:].mean() - profile[:4].mean() for profile, _ in profiles]
    return max(edge_width_px(*profile) for profile in profiles), float(np.mean(contrasts))


def edge_width_px(profile: Float, step_px: float) -> float:
    """Width from 10 % to 90 % of an edge in a profile that begins and ends on either side of it."""
    height = abs(profile[-4:].mean() - profile[:4].mean())
    slope = np.abs(np.gradient(profile, step_px)).max()
    return float(_WIDTH_TIMES_SLOPE * height / max(slope, 1e-12))


def _mean_profile(
    picture: NDArray[Any], corners: Float, found: NDArray[np.bool_], reach: float
) -> tuple[Float, float]:
    """Mean rise of counts over the edges between neighbours along the first axis, and its step in pixels."""
    both = found[1:] & found[:-1]
    first, second = corners[:-1][both], corners[1:][both]
    along = second - first
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    offsets = np.linspace(-reach, reach, _PROFILE_STEPS)
    samples = ((first + second) / 2)[:, None] + offsets[:, None] * across[:, None]
    values = sample(picture, samples)
    falling = values[:, -4:].mean(axis=1) < values[:, :4].mean(axis=1)
    values[falling] = values[falling, ::-1]
    step = float(np.median(np.linalg.norm(along, axis=1))) * (offsets[1] - offsets[0])
    return values.mean(axis=0), step
