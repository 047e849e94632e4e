"""The targets of calibration as geometry: where their points are, and which boards are refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.models import Board, BoardKind


def board_points(board: Board) -> NDArray[np.float32]:
    """Points of the target in its own frame.

    Parameters
    ----------
    board
        The target.

    Returns
    -------
    numpy.ndarray
        (rows * columns, 3) float32, metres, z = 0, row by row: inner corners of squares, or centres of
        circles of which every other row is shifted by half a step (one ``square_m``) to the right.
    """
    rows, columns = np.mgrid[: board.rows, : board.columns]
    if board.kind is BoardKind.CIRCLES:
        columns = 2 * columns + rows % 2
    points = np.stack([columns, rows, np.zeros_like(rows)], axis=-1).reshape(-1, 3)
    return np.asarray(points * board.square_m, np.float32)


def check_board(board: Board) -> None:
    """Refuse a target whose orientation would not be unique, or which is impossible.

    Raises
    ------
    CalibrationError
        Too few points, a length that is not positive, counts that look the same after half a turn, or
        markers that are unknown or too large for their squares.
    """
    points = "circles" if board.kind is BoardKind.CIRCLES else "inner corners"
    size = f"a board of {board.columns} x {board.rows} {points}"
    if board.columns < 3 or board.rows < 3:
        raise CalibrationError(f"{size} is too small")
    if not (np.isfinite(board.square_m) and board.square_m > 0):
        raise CalibrationError(f"the side of a square must be positive, not {board.square_m} m")
    if board.kind is BoardKind.CIRCLES and board.rows % 2 == 0:
        raise CalibrationError(
            f"{size} looks the same after half a turn",
            remedy="Use an asymmetric grid of circles with an odd number of rows.",
        )
    if board.kind is BoardKind.CHESSBOARD and (board.columns + board.rows) % 2 == 0:
        raise CalibrationError(
            f"{size} looks the same after half a turn",
            remedy="Count inner corners, not squares; use a board with one even and one odd count.",
        )
    if board.kind in (BoardKind.CHARUCO, BoardKind.MARKED):
        _check_markers(board)


def _check_markers(board: Board) -> None:
    import cv2

    if not hasattr(cv2.aruco, board.dictionary) or not board.dictionary.startswith("DICT_"):
        raise CalibrationError(
            f"there is no dictionary of markers '{board.dictionary}'",
            remedy="Give the name of an OpenCV dictionary, such as DICT_4X4_50.",
        )
    limit_m = board.square_m * (1 if board.kind is BoardKind.CHARUCO else min(board.columns, board.rows) - 3)
    if not (np.isfinite(board.marker_m) and 0 < board.marker_m < limit_m):
        raise CalibrationError(
            f"a marker of {board.marker_m:g} m does not fit: it must be smaller than {limit_m:g} m",
            remedy="Give the side of the marker's black border, metres.",
        )
