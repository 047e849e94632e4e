"""Interpolation from an even grid of nodes to the pixels, by local polynomials.

For waters that are smooth only in pieces, as around a cylinder: what the water is inside the cylinder does
not spread over the picture, as it would with `projection.PixelGrid`. The interface is the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from thermacq_drivers.simflume.surfaces import Floats

SPACING_PX = 6
_POINTS = 6
_WHOLE = slice(None)


class LocalGrid:
    """Interpolation with polynomials of fifth degree through the six nearest nodes along each axis.

    Parameters
    ----------
    rows, columns
        Size of the picture in pixels.
    spacing_px
        Distance of the nodes, pixels.
    """

    def __init__(self, rows: int, columns: int, spacing_px: int = SPACING_PX) -> None:
        row_nodes, self._to_rows = _interpolation(rows, spacing_px)
        column_nodes, self._to_columns = _interpolation(columns, spacing_px)
        self._to_rows_single = self._to_rows.astype(np.float32)
        self._to_columns_single = self._to_columns.astype(np.float32)
        self.nodes_px: Floats = np.stack(np.meshgrid(column_nodes, row_nodes), axis=-1)
        """(node rows, node columns, 2) column and row of each node."""

    def spread(self, at_nodes: Floats, rows: slice = _WHOLE, columns: slice = _WHOLE) -> Floats:
        """Values at the nodes to values at the pixels: (node rows, node columns) to (rows, columns)."""
        across = self._to_columns[columns] @ np.ascontiguousarray(at_nodes.T)
        at_pixels: Floats = self._to_rows[rows] @ np.ascontiguousarray(across.T)
        return at_pixels

    def spread_single(self, at_nodes: Floats) -> NDArray[np.float32]:
        """Like `spread`, in single precision."""
        middle = at_nodes.mean()
        across = self._to_columns_single @ np.ascontiguousarray((at_nodes - middle).T, np.float32)
        at_pixels: NDArray[np.float32] = self._to_rows_single @ np.ascontiguousarray(across.T)
        at_pixels += np.float32(middle)
        return at_pixels


def _interpolation(size: int, spacing: int) -> tuple[Floats, csr_array]:
    """Nodes over pixels -0.5 .. size - 0.5 with two beyond each end, and the matrix from them to the pixels."""
    intervals = -(-size // spacing)
    nodes = -0.5 + spacing * np.arange(-2, intervals + 3.0)
    place = (np.arange(size) - nodes[0]) / spacing
    first = np.floor(place).astype(np.intp) - _POINTS // 2 + 1
    from_first = (place - first)[:, None]
    weights = np.ones((size, _POINTS))
    for point in range(_POINTS):
        others = np.delete(np.arange(_POINTS), point)
        weights[:, point] = np.prod((from_first - others) / (point - others), axis=1)
    node = first[:, None] + np.arange(_POINTS)
    starts = _POINTS * np.arange(size + 1)
    return nodes, csr_array((weights.ravel(), node.ravel(), starts), shape=(size, len(nodes)))
