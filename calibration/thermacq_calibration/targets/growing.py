"""Corners of squares from a few known ones: each that is found improves the prediction of its neighbours.

A place is accepted only when the picture has a saddle near it that looks like a crossing of two light and
two dark squares of the right polarity.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Board, Float
from thermacq_calibration.targets.saddles import refine_saddles
from thermacq_calibration.targets.sampling import fit_homography, project, sample

# A crossing correlates by at least this much with an ideal one, and lies this near to its prediction (squares).
_MIN_CORRELATION = 0.6
_REACH_SQUARES = 0.25
# Large surroundings find the saddle in noise; squares of unequal size and shading then move it. Real pictures
# with squares of 17 px: a camera fits with an RMS of 0.36 px when it ends at 0.25, 0.24 px when at 0.15.
_RADII_SQUARES = (0.25, 0.15)
_TEMPLATE_STEPS = 9
_ENOUGH = 10


def grow(
    picture: NDArray[Any],
    board: Board,
    places: Float,
    pixels: Float,
    wanted: NDArray[np.bool_],
    plain_squares: float,
) -> tuple[Float, NDArray[np.bool_]]:
    """Find the corners of a board, beginning near those places whose pixels are known.

    Parameters
    ----------
    picture
        (rows, columns) counts.
    board
        The board.
    places, pixels
        (n, 2) at least four places on the board, in squares from its first corner, and where they are seen.
    wanted
        (rows, columns) bool, the corners to look for.
    plain_squares
        How far around a corner the squares are plain.

    Returns
    -------
    corners : numpy.ndarray
        (rows, columns, 2) pixels, NaN where not found.
    found : numpy.ndarray
        (rows, columns) bool.
    """
    counts = np.asarray(picture, np.float32)
    rows, columns = np.mgrid[: board.rows, : board.columns].astype(float)
    grid = np.stack([columns, rows], axis=-1)
    signs = np.where((columns + rows) % 2 == 0, 1.0, -1.0)
    corners, found = np.full(grid.shape, np.nan), np.zeros(wanted.shape, bool)
    away = np.rint(np.max(np.abs(grid - np.median(places, axis=0)), axis=-1))
    polarity = 0.0
    for distance in np.unique(away[wanted]):
        ring = wanted & (away == distance)
        homography = fit_homography(places, pixels)
        if homography is None:
            break
        seen, correlations = _look_around(counts, homography, grid[ring], plain_squares)
        correlations *= signs[ring]
        polarity = polarity or float(np.sign(correlations.sum()))
        good = correlations * polarity > _MIN_CORRELATION
        corners[ring] = np.where(good[:, None], seen, np.nan)
        found[ring] = good
        if found.sum() >= _ENOUGH:
            places, pixels = grid[found], corners[found]
    return corners, found


def _look_around(
    picture: NDArray[np.float32], homography: Float, places: Float, plain_squares: float
) -> tuple[Float, Float]:
    """Refined crossings (n, 2) near predicted places, and their correlation with an ideal one (n,).

    The correlation is 0 where there is no crossing near the place, or the place is outside the picture.
    """
    predicted = project(homography, places)
    steps = np.stack([project(homography, places + step) - predicted for step in np.eye(2)], axis=-1)
    side = np.min(np.linalg.norm(steps, axis=1), axis=-1)
    refined = predicted
    for radius in _RADII_SQUARES:
        refined = refine_saddles(picture, refined, radius * side)
    moved = np.linalg.norm(refined - predicted, axis=-1)
    near = moved < _REACH_SQUARES * side
    return refined, np.where(near, _correlations(picture, refined, plain_squares * steps), 0.0)


def _correlations(picture: NDArray[np.float32], pixels: Float, steps: Float) -> Float:
    """Correlation of the surroundings of each pixel with a crossing along `steps` (n, 2, 2), -1 to 1."""
    along = np.linspace(-1, 1, _TEMPLATE_STEPS + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(along, along))
    template = np.sign(x * y)
    samples = pixels[:, None] + np.einsum("nij,jk->nki", steps, np.stack([x, y]))
    values = sample(picture, samples)
    values -= values.mean(axis=1, keepdims=True)
    norm = np.linalg.norm(values, axis=1) * np.linalg.norm(template)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlations: Float = np.nan_to_num(values @ template / norm)
    return correlations
