"""Points that no surface supports: outside the range of depth, or far from their surroundings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MAD_TO_SIGMA = 1.4826
_LEAST_SUPPORT = 0.25
_SPECKLE_STEPS, _SPECKLE_NONE = 8, -32768


def reject_outliers(
    disparity: NDArray[np.float32],
    *,
    tile_px: int = 16,
    deviations: float = 5.0,
    floor_px: float = 0.5,
    least_share: float = 0.005,
) -> NDArray[np.float32]:
    """Set disparities to NaN that lie far from the local median.

    The picture is cut into tiles; each tile's median and median absolute deviation (MAD), robust against
    up to half of false matches, are smoothed over 3x3 tiles by another median and interpolated between
    the tile centres, so that a slope inside a tile is no outlier.

    Parameters
    ----------
    disparity
        (rows, columns) float32, pixels.
    tile_px
        Side of a tile.
    deviations
        Limit in robust standard deviations.
    floor_px
        Least limit, so that a very smooth surface does not lose its own noise.

    least_share
        Connected patches smaller than this share of the picture are no surface.

    Returns
    -------
    numpy.ndarray
        A copy with outliers NaN.
    """
    median, spread = _tile_statistics(disparity, tile_px)
    centre = _between_tiles(_median_of_neighbours(median), disparity.shape, tile_px)
    limit = np.fmax(
        floor_px,
        deviations * _MAD_TO_SIGMA * _between_tiles(_median_of_neighbours(spread), disparity.shape, tile_px),
    )
    far = ~(np.abs(disparity - centre) <= limit)
    return _without_islands(np.where(far, np.float32(np.nan), disparity), least_share)


def _without_islands(disparity: NDArray[np.float32], least_share: float) -> NDArray[np.float32]:
    """Set connected patches (steps of at most 1 px) smaller than a share of the picture to NaN."""
    import cv2

    known = np.isfinite(disparity)
    steps = np.where(known, np.rint(disparity * _SPECKLE_STEPS), _SPECKLE_NONE).astype(np.int16)
    cv2.filterSpeckles(steps, _SPECKLE_NONE, int(least_share * disparity.size), _SPECKLE_STEPS)
    return np.where(steps == _SPECKLE_NONE, np.float32(np.nan), disparity)


def _tile_statistics(
    values: NDArray[np.float32], tile_px: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Median and MAD of each tile, NaN for tiles less than a quarter full."""
    rows, columns = values.shape
    padded = np.pad(values, ((0, -rows % tile_px), (0, -columns % tile_px)), constant_values=np.nan)
    tiles = padded.reshape(padded.shape[0] // tile_px, tile_px, padded.shape[1] // tile_px, tile_px)
    flat = tiles.transpose(0, 2, 1, 3).reshape(tiles.shape[0], tiles.shape[2], tile_px * tile_px)
    # A few matches at the edge of the common view may all be false: such a tile follows its neighbours.
    sparse = np.isfinite(flat).mean(axis=-1) < _LEAST_SUPPORT
    median = np.where(sparse, np.float32(np.nan), _nan_median(flat))
    return median, _nan_median(np.abs(flat - median[..., None]))


def _nan_median(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Median over the last axis without NaN; NaN where there is nothing.

    `numpy.nanmedian` does the same twenty times slower and warns of empty slices.
    """
    ordered = np.sort(values, axis=-1)
    count = np.isfinite(ordered).sum(axis=-1)
    middle = np.stack([np.maximum(count - 1, 0) // 2, count // 2 * (count > 0)], axis=-1)
    picked = np.take_along_axis(ordered, middle, axis=-1).mean(axis=-1)
    return np.asarray(np.where(count > 0, picked, np.float32(np.nan)), np.float32)


def _median_of_neighbours(tiles: NDArray[np.float32]) -> NDArray[np.float32]:
    # Mirrored about the values at the edge, so that a slope goes on and its median is not pulled inwards.
    if min(tiles.shape) < 2:
        return tiles
    padded = np.pad(tiles, 1, mode="reflect", reflect_type="odd")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return _nan_median(windows.reshape(*tiles.shape, 9))


def _between_tiles(tiles: NDArray[np.float32], shape: tuple[int, ...], tile_px: int) -> NDArray[np.float32]:
    """Linear between tile centres, extended linearly to the edge; empty tiles take their nearest one."""
    filled = _fill_empty(tiles)
    for axis in (0, 1):
        position = (np.arange(shape[axis]) + 0.5) / tile_px - 0.5
        last = filled.shape[axis] - 1
        lower = np.clip(np.floor(position), 0, max(last - 1, 0)).astype(np.intp)
        weight = (position - lower).astype(np.float32)
        weight = weight[:, None] if axis == 0 else weight[None, :]
        below = filled.take(lower, axis)
        filled = below + weight * (filled.take(np.minimum(lower + 1, last), axis) - below)
    return filled


def _fill_empty(tiles: NDArray[np.float32]) -> NDArray[np.float32]:
    from scipy.ndimage import distance_transform_edt

    empty = np.isnan(tiles)
    if empty.all() or not empty.any():
        return tiles
    nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return np.asarray(tiles[tuple(nearest)], np.float32)
