"""Corners of a plain chessboard by OpenCV's sector-based detector, in an order that the board alone decides."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Board, Float, frozen_array
from thermacq_calibration.targets.detection import Detection, NoBoard
from thermacq_calibration.targets.pictures import Bytes


def find_chessboard(picture: NDArray[Any], grey: Bytes, board: Board) -> Detection | NoBoard:
    """Find all inner corners: plain search, exhaustive search, search of the inverted picture.

    Parameters
    ----------
    picture
        (rows, columns) counts.
    grey
        The same stretched to 8 bit.
    board
        A plain chessboard.
    """
    corners = _find_corners(grey, board)
    if corners is None:
        return NoBoard(f"no board of {board.columns} x {board.rows} inner corners found")
    sharpness = _sharpness_px(grey, board, corners)
    grid, contrast = _order(corners.reshape(board.rows, board.columns, 2), picture)
    return Detection(frozen_array(grid.reshape(-1, 2)), sharpness, contrast)


def similar_chessboards(grey: Bytes, board: Board) -> list[tuple[int, int]]:
    """Corner counts (columns, rows) near those of `board` with which a board is found."""
    import cv2

    steps = [(-1, -1), (-1, 0), (0, -1), (1, 1), (1, 0), (0, 1), (2, 0), (0, 2), (2, 2), (2, 1), (1, 2)]
    sizes = [(board.columns + across, board.rows + along) for across, along in steps]
    return [size for size in sizes if min(size) >= 3 and cv2.findChessboardCornersSB(grey, size, flags=0)[0]]


def _find_corners(grey: Bytes, board: Board) -> Float | None:
    """Corners (n, 2) as the detector orders them; None when there are none."""
    import cv2

    size = (board.columns, board.rows)
    for image, flags in ((grey, 0), (grey, cv2.CALIB_CB_EXHAUSTIVE), (255 - grey, 0)):
        found, coarse = cv2.findChessboardCornersSB(image, size, flags=flags)
        if found:
            again, fine = cv2.findChessboardCornersSB(image, size, flags=flags | cv2.CALIB_CB_ACCURACY)
            return np.asarray(fine if again else coarse, np.float64).reshape(-1, 2)
    return None


def _sharpness_px(grey: Bytes, board: Board, corners: Float) -> float:
    """Mean edge width, the worse of the two directions."""
    import cv2

    points = corners.astype(np.float32).reshape(-1, 1, 2)
    size = (board.columns, board.rows)
    widths = [
        np.ravel(cv2.estimateChessboardSharpness(grey, size, points, vertical=vertical)[0])[0]
        for vertical in (False, True)
    ]
    return float(np.max(widths))


def _order(grid: Float, picture: NDArray[Any]) -> tuple[Float, float]:
    """Corner grid (rows, columns, 2) in the board's own order, and its contrast in counts."""
    along_columns = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    along_rows = grid[-1].mean(axis=0) - grid[0].mean(axis=0)
    if along_columns[0] * along_rows[1] - along_columns[1] * along_rows[0] < 0:
        grid = grid[::-1]
    difference = _checker_difference(grid, picture)
    return (grid if difference > 0 else grid[::-1, ::-1]), abs(difference)


def _checker_difference(grid: Float, picture: NDArray[Any]) -> float:
    """Mean count of the squares that alternate with the first one, taken from those like the first."""
    import cv2

    smooth = cv2.blur(np.asarray(picture, np.float32), (3, 3))
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    u, v = np.rint(centres).astype(int).transpose(2, 0, 1)
    counts = smooth[v.clip(0, picture.shape[0] - 1), u.clip(0, picture.shape[1] - 1)]
    like_first = np.add.outer(np.arange(counts.shape[0]), np.arange(counts.shape[1])) % 2 == 0
    return float(counts[like_first].mean() - counts[~like_first].mean())
