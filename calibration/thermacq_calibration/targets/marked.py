"""A chessboard with one large ArUco marker in its middle: the marker says where the corners are to be sought.

Detectors of plain chessboards fail on such boards, because the marker interrupts the grid. Here the marker
is found first; its four corners predict the nearest corners of squares, these the next ones, and so on
outwards, up to the border of the board or of the picture.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Board, Float, frozen_array
from thermacq_calibration.targets.boards import hidden_by_marker, marker_dictionary
from thermacq_calibration.targets.detection import Detection, NoBoard
from thermacq_calibration.targets.growing import grow
from thermacq_calibration.targets.pictures import Bytes
from thermacq_calibration.targets.saddles import edge_profile

MIN_CORNERS = 20
# Thermal markers are small and blurred: they are looked for in pictures so many times larger, so smooth.
_SEARCHES = ((2, 1.5), (1, 0.8), (2, 2.5), (3, 2.5))
# How far around a corner squares are looked at.
_PLAIN_SQUARES = 0.4


def find_marked(picture: NDArray[Any], grey: Bytes, board: Board) -> Detection | NoBoard:
    """Find the marker, then the corners around it.

    Parameters
    ----------
    picture
        (rows, columns) counts.
    grey
        The same stretched to 8 bit.
    board
        A board of kind ``marked``.

    Returns
    -------
    Detection or NoBoard
        The corners that were found; those under the marker are never among them.
    """
    marker = _find_marker(grey, board)
    if marker is None:
        return NoBoard(f"the marker in the middle of the board ({board.dictionary}) was not found")
    middle = np.array([board.columns - 1, board.rows - 1]) / 2
    border = board.marker_m / board.square_m / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    wanted = ~hidden_by_marker(board)
    corners, found = grow(picture, board, middle + border, marker, wanted, _PLAIN_SQUARES)
    if found.sum() < MIN_CORNERS:
        return NoBoard(
            f"the marker in the middle of the board was found, but only {found.sum()} corners of squares "
            f"around it; {MIN_CORNERS} are needed"
        )
    sharpness, contrast = edge_profile(picture, corners, found, _PLAIN_SQUARES)
    return Detection(frozen_array(corners[found]), sharpness, contrast, np.flatnonzero(found))


def _find_marker(grey: Bytes, board: Board) -> Float | None:
    """Corners (4, 2) of the marker's border, clockwise from its own upper left; None when there is none."""
    import cv2

    detector = cv2.aruco.ArucoDetector(marker_dictionary(board.dictionary))
    for image in (grey, 255 - grey):
        for scale, sigma in _SEARCHES:
            large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
            found, _, _ = detector.detectMarkers(cv2.GaussianBlur(large, (0, 0), sigma))
            if len(found):
                largest = max(found, key=cv2.contourArea)
                # Centres of pixels: pixel i of the small picture lies at scale * (i + 0.5) - 0.5 of the large.
                return (np.asarray(largest, np.float64).reshape(4, 2) + 0.5) / scale - 0.5
    return None
