"""The targets of calibration as geometry: where their points are, and which boards are refused."""

from __future__ import annotations

import math
import re
from typing import Any

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
            remedy="Count inner corners, not squares; use a board with one even and one odd count. A chessboard with "
            "a marker in its middle may have any counts: it is of the kind `marked`.",
        )
    if board.kind in (BoardKind.CHARUCO, BoardKind.MARKED):
        _check_markers(board)


def marker_dictionary(name: str) -> Any:
    """OpenCV's dictionary of a name such as ``DICT_4X4_50``, or of one marker's own bits.

    Parameters
    ----------
    name
        Name, or rows of bits of the one marker as one reads them, e.g. ``011/110/010``; 1 is light.

    Raises
    ------
    CalibrationError
        It is neither.
    """
    import cv2

    if re.fullmatch(r"DICT_\w+", name) and hasattr(cv2.aruco, name):
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    rows = name.split("/")
    if not 3 <= len(rows) <= 8 or not all(re.fullmatch(f"[01]{{{len(rows)}}}", row) for row in rows):
        raise CalibrationError(
            f"there is no dictionary of markers '{name}'",
            remedy="Give the name of an OpenCV dictionary, such as DICT_4X4_50, or the rows of bits of the "
            "one marker, such as 011/110/010.",
        )
    bits = np.array([[int(bit) for bit in row] for row in rows], np.uint8)
    if any(np.array_equal(np.rot90(bits, turns), bits) for turns in (1, 2)):
        raise CalibrationError(f"the marker {name} looks the same after a turn", remedy="Use another marker.")
    return cv2.aruco.Dictionary(cv2.aruco.Dictionary.getByteListFromBits(bits), len(rows), 0)


def hidden_by_marker(board: Board) -> NDArray[np.bool_]:
    """Inner corners of a ``marked`` board that its marker replaces: (rows, columns) bool.

    The marker stands in the middle of the smallest block of whole squares that holds it; neither the
    corners inside that block nor those on its border are crossings of squares.
    """
    hidden = np.zeros((board.rows, board.columns), bool)
    slices = []
    for count in (board.rows, board.columns):
        block = math.ceil(board.marker_m / board.square_m)
        block += (count + 1 - block) % 2
        first = (count + 1 - block) // 2 - 1
        slices.append(slice(first, first + block + 1))
    hidden[tuple(slices)] = True
    return hidden


def _check_markers(board: Board) -> None:
    marker_dictionary(board.dictionary)
    limit_m = board.square_m * (1 if board.kind is BoardKind.CHARUCO else min(board.columns, board.rows) - 3)
    if not (np.isfinite(board.marker_m) and 0 < board.marker_m < limit_m):
        raise CalibrationError(
            f"a marker of {board.marker_m:g} m does not fit: it must be smaller than {limit_m:g} m",
            remedy="Give the side of the marker's black border, metres.",
        )
