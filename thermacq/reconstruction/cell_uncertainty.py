"""Standard uncertainty of a cell of an elevation product in one frame, from the geometry of the pair.

A cell holds points of one or two matching windows, so its error is that of a matched point and not smaller by
the root of their number. The still water measured how large that is on the mean; with ``dz = z² / (B f) dd`` a
point moves along its ray, so elevation changes by ``h z / (B f)`` for a pixel of disparity, with h the height
of the camera and z the depth of the cell: farther cells are less certain, in proportion to z.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermacq.reconstruction.gridding import Grid
from thermacq.reconstruction.world import WorldFrame


def cell_uncertainty_m(world: WorldFrame, grid: Grid) -> NDArray[np.float32]:
    """Standard uncertainty of elevation by matching, (ny, nx) float32, metres.

    The standard deviation of single frames from the still water, ``world.sigma_m``, spread over the grid in
    proportion to depth. It includes noise and what calibration and fixed pattern bend; a wrong height of the
    whole plane, see the covariance of the world frame, is not in it.
    """
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    cells = np.stack([x, y, np.zeros_like(x)], axis=-1) - world.translation_m
    depth = cells @ world.rotation[:, 2]
    relative = depth / np.sqrt(np.mean(depth**2))
    uncertainty: NDArray[np.float32] = (world.sigma_m * np.maximum(relative, 0.1)).astype(np.float32)
    return uncertainty
