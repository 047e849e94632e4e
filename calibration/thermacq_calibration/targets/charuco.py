"""Corners of a ChArUco board: a chessboard with an ArUco marker in every light square.

The markers say which corners are seen, so a part of the board is enough. OpenCV interpolates corners from
the markers that it can read; they are refined on the counts, and predict those whose markers it cannot read.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Board, Float, frozen_array
from thermacq_calibration.targets.boards import marker_dictionary
from thermacq_calibration.targets.detection import Detection, NoBoard
from thermacq_calibration.targets.growing import grow
from thermacq_calibration.targets.pictures import Bytes
from thermacq_calibration.targets.saddles import edge_profile

MIN_CORNERS = 12
# The picture as it is, then larger and smoother ones for small and noisy markers.
_SEARCHES = ((1, 0.0), (1, 1.0), (2, 1.5))
# Part of the margin between a square and its marker that edges and corners are looked at in.
_MARGIN_PART = 0.9
_MIN_SEEDS = 4


def find_charuco(picture: NDArray[Any], grey: Bytes, board: Board) -> Detection | NoBoard:
    """Find the corners of a ChArUco board that are in the picture.

    Parameters
    ----------
    picture
        (rows, columns) counts.
    grey
        The same stretched to 8 bit.
    board
        A board of kind ``charuco``.
    """
    pixels, ids = _find_most(grey, board)
    corners, found = np.empty((0, 2)), np.zeros((board.rows, board.columns), bool)
    plain = _MARGIN_PART * (1 - board.marker_m / board.square_m) / 2
    if len(ids) >= _MIN_SEEDS:
        places = np.stack([ids % board.columns, ids // board.columns], axis=-1).astype(float)
        corners, found = grow(picture, board, places, pixels, ~found, plain)
    if found.sum() < MIN_CORNERS:
        return NoBoard(
            f"{found.sum()} corners of the ChArUco board of {board.columns} x {board.rows} inner corners found "
            f"(markers: {board.dictionary}); {MIN_CORNERS} are needed"
        )
    sharpness, contrast = edge_profile(picture, corners, found, plain)
    return Detection(frozen_array(corners[found]), sharpness, contrast, np.flatnonzero(found))


def _find_most(grey: Bytes, board: Board) -> tuple[Float, NDArray[np.intp]]:
    """Corners (n, 2) and their numbers (n,), of the search that finds most of them."""
    best = np.empty((0, 2)), np.empty(0, np.intp)
    for scale, sigma in _SEARCHES:
        for image in (grey, 255 - grey):
            for legacy in (False, True):
                found = _search(image, board, scale, sigma, legacy)
                best = max(best, found, key=lambda pair: len(pair[1]))
        if len(best[1]) >= board.rows * board.columns // 2:
            break
    return best


def _search(
    image: Bytes, board: Board, scale: int, sigma: float, legacy: bool
) -> tuple[Float, NDArray[np.intp]]:
    import cv2

    squares = (board.columns + 1, board.rows + 1)
    layout = cv2.aruco.CharucoBoard(
        squares, board.square_m, board.marker_m, marker_dictionary(board.dictionary)
    )
    # Boards drawn before OpenCV 4.6 begin with the other colour when they have an even number of rows.
    layout.setLegacyPattern(legacy)
    if scale > 1:
        image = np.asarray(
            cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8
        )
    if sigma:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.uint8)
    detected: Any = cv2.aruco.CharucoDetector(layout).detectBoard(image)
    corners, ids = detected[:2]
    if ids is None:
        return np.empty((0, 2)), np.empty(0, np.intp)
    # Centres of pixels: pixel i of the small picture lies at scale * (i + 0.5) - 0.5 of the large one.
    small = (np.asarray(corners, np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
    return small, np.asarray(ids, np.intp).ravel()
