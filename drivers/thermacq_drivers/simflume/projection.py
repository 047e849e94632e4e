"""Where the rays of a camera meet the water, for all pixels of a picture.

Rays are cut with the surface exactly at the Chebyshev nodes of the picture only; every smooth quantity
(place, label, depth) is then interpolated to the pixels by two small matrix products. The interpolation
converges spectrally: with the default nodes its error is far below the 0.001 px that the tests ask for.
"""

from __future__ import annotations

import itertools
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.surfaces import Floats, Surface

_Real = TypeVar("_Real", np.float32, np.float64)

NODE_ROWS = 64
NODE_COLUMNS = 32
_STEPS = 50
_TOLERANCE_M = 1e-12
_SMALL_PRODUCT = 200_000
# Multiplications up to which OpenBLAS stays in one thread (it splits above 2^18).
_GRAZING = 0.14
# A ray must be at least this much steeper (vertical per horizontal) than the water, or it may cut it twice.


class PixelGrid:
    """Interpolation from Chebyshev nodes of a picture to its pixels.

    Parameters
    ----------
    rows, columns
        Size of the picture in pixels.
    oversample
        Samples per pixel and axis, spread evenly over the pixel.
    node_rows, node_columns
        Number of nodes along each axis.
    """

    def __init__(
        self,
        rows: int,
        columns: int,
        oversample: int = 1,
        node_rows: int = NODE_ROWS,
        node_columns: int = NODE_COLUMNS,
    ) -> None:
        row_nodes, self._to_rows = _interpolation(rows, node_rows, oversample)
        column_nodes, to_columns = _interpolation(columns, node_columns, oversample)
        self._to_columns = np.ascontiguousarray(to_columns.T)
        self._to_rows_single = self._to_rows.astype(np.float32)
        self._to_columns_single = self._to_columns.astype(np.float32)
        self.nodes_px: Floats = np.stack(np.meshgrid(column_nodes, row_nodes), axis=-1)
        """(node rows, node columns, 2) column and row of each node."""

    def spread(self, at_nodes: Floats, rows: slice = slice(None), columns: slice = slice(None)) -> Floats:
        """Values at the nodes to values at the pixels: (node rows, node columns) to (rows, columns)."""
        return _product(self._to_rows[rows], at_nodes, self._to_columns[:, columns])

    def spread_single(self, at_nodes: Floats) -> NDArray[np.float32]:
        """Like `spread`, in single precision: twice as fast, good to about 5e-7 of the values' range."""
        middle = at_nodes.mean()
        centred = (at_nodes - middle).astype(np.float32)
        at_pixels = _product(self._to_rows_single, centred, self._to_columns_single)
        at_pixels += np.float32(middle)
        return at_pixels


def _product(left: NDArray[_Real], middle: NDArray[_Real], right: NDArray[_Real]) -> NDArray[_Real]:
    """Matrix product of three, in blocks of rows too small for BLAS to start threads.

    Threads that wait for each other while both cameras draw on few cores cost a hundred times the product.
    """
    rows, block = len(left), max(1, _SMALL_PRODUCT // right.size)
    whole = rows // block * block
    product = np.empty((rows, right.shape[1]), left.dtype)
    blocks = left[:whole].reshape(-1, block, left.shape[1]) @ middle
    np.matmul(blocks, right, out=product[:whole].reshape(-1, block, right.shape[1]))
    product[whole:] = left[whole:] @ middle @ right
    return product


def _interpolation(size: int, count: int, oversample: int) -> tuple[Floats, Floats]:
    """Chebyshev nodes over pixels -0.5 .. size - 0.5, and the barycentric matrix from them to the pixels."""
    cosines = np.cos(np.pi * np.arange(count) / (count - 1))
    nodes = (size - 1) / 2 - size / 2 * cosines
    weights = np.where(np.arange(count) % 2, -1.0, 1.0)
    weights[[0, -1]] /= 2
    targets = (np.arange(size * oversample) + 0.5) / oversample - 0.5
    distance = targets[:, None] - nodes[None, :]
    hit = distance == 0
    terms = weights / np.where(hit, 1.0, distance)
    matrix: Floats = np.where(hit.any(axis=1, keepdims=True), hit, terms / terms.sum(axis=1, keepdims=True))
    return nodes, matrix


def row_delay_s(nodes_px: Floats, line_time_s: float) -> Floats | float:
    """Time from the read-out of the first row to that of each node, (node rows, 1) seconds; 0: all at once."""
    return line_time_s * nodes_px[:, :1, 1] if line_time_s else 0.0


def check_view(camera: PinholeCamera, surface: Surface) -> None:
    """Refuse a camera that cannot look at this water.

    Raises
    ------
    ValueError
        The camera is below the highest water, or some pixel sees the water at grazing incidence, behind
        another wave, or not at all.
    """
    height = float(camera.centre_m[2])
    if height <= surface.highest_m:
        raise ValueError(
            f"the camera at {height:g} m is under water: the surface rises to {surface.highest_m:.3f} m"
        )
    last = np.array([camera.columns, camera.rows]) - 1.0
    edge = np.linspace(0.0, 1.0, 33)[:, None]
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * last
    border = np.concatenate([a + (b - a) * edge for a, b in itertools.pairwise(corners)])
    rays = camera.rays(border)
    descent = -rays[:, 2] / np.hypot(rays[:, 0], rays[:, 1])
    if descent.min() < surface.steepest + _GRAZING:
        raise ValueError(
            "part of the picture looks along the water or past it: descent of the flattest ray "
            f"{descent.min():.2f}, steepest slope of the water {surface.steepest:.2f}; tilt the camera less"
        )


def intersect(surface: Surface, camera: PinholeCamera, rays: Floats, time_s: Floats | float) -> Floats:
    """Depth at which rays meet the water, by Newton's method from the still water.

    Parameters
    ----------
    surface
        The water.
    camera
        The camera; `check_view` has found it fit.
    rays
        (..., 3) directions in flume axes, of depth 1 in the camera.
    time_s
        Time of the scene, one or broadcast against the rays (each row at its own read-out).

    Returns
    -------
    numpy.ndarray
        (...) float64, depth along the optical axis in metres.

    Raises
    ------
    ValueError
        Some ray does not meet the water.
    """
    centre = camera.centre_m
    depth: Floats = -centre[2] / rays[..., 2]
    for _ in range(_STEPS):
        x, y, z = np.moveaxis(centre + depth[..., None] * rays, -1, 0)
        slope_x, slope_y = surface.slope(x, y, time_s)
        gap = z - surface.elevation(x, y, time_s)
        depth -= gap / (rays[..., 2] - slope_x * rays[..., 0] - slope_y * rays[..., 1])
        if np.abs(gap).max() < _TOLERANCE_M:
            return depth
    raise ValueError("some rays of the camera do not meet the water")


def water_points(surface: Surface, camera: PinholeCamera, rays: Floats, time_s: Floats | float) -> Floats:
    """Points (..., 3) in flume coordinates at which rays (..., 3) meet the water, metres."""
    depth = intersect(surface, camera, rays, time_s)
    points: Floats = camera.centre_m + depth[..., None] * rays
    return points
