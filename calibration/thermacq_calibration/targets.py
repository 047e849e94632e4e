"""Find the corners of a chessboard in thermal pictures, or say in words why there are none.

The recipe was chosen on synthetic thermal boards: mean of up to 16 frames, stretched between its percentiles
1 and 99 to 8 bit, sector-based detector; then an exhaustive search; then the inverted picture. Where a board
is found, the detector runs again at its finer setting. docs/reference/calibration.md has the figures.

Corners are returned in one order that depends on the board alone, so that both cameras start at the same
physical corner: along the columns, right-handed as seen by the camera, and starting at the end where the
first inner square is the brighter one. This is unique when one corner count is even and the other odd.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Board, Float, frozen_array
from thermacq_calibration.poses import pixel_noise

FRAMES_TO_AVERAGE = 16
# Edges that wide (10 % to 90 %) come from a blur of sigma 4 px, or of 2 px under much noise.
MAX_SHARPNESS_PX = 10.0
# Below this ratio of contrast to pixel noise corners are off by 0.2 px and more.
MIN_CONTRAST_TO_NOISE = 5.0
# A picture with so many pixels at one end of its range is called saturated when no board is found in it.
_SATURATED_PART = 0.2

Bytes: TypeAlias = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Detection:
    """A chessboard found in a picture.

    Parameters
    ----------
    corners
        (n, 2) float64 pixels (u, v), row by row of the board.
    sharpness_px
        Mean width of the edges of squares, 10 % to 90 %.
    contrast
        Mean difference between light and dark squares, counts.
    seen
        (n,) which points of the board the corners are, rising; None: all of them.
    """

    corners: Float
    sharpness_px: float
    contrast: float
    seen: NDArray[np.intp] | None = None

    @property
    def indices(self) -> NDArray[np.intp]:
        """(n,) which points of the board (see `boards.board_points`) the corners are."""
        return np.arange(len(self.corners)) if self.seen is None else self.seen


@dataclass(frozen=True)
class NoBoard:
    """No usable chessboard, and why."""

    reason: str


def average(frames: NDArray[Any]) -> NDArray[np.float32]:
    """Mean over the first axis: (frames, rows, columns) to (rows, columns) float32, counts."""
    return np.asarray(np.mean(frames, axis=0, dtype=np.float64), np.float32)


def detect_board(picture: NDArray[Any], board: Board) -> Detection | NoBoard:
    """Look for the chessboard in one picture.

    Parameters
    ----------
    picture
        (rows, columns) real numbers, counts: one frame or the `average` of several.
    board
        Which board to look for.

    Returns
    -------
    Detection or NoBoard
        The corners in the order of this module's docstring, or the reason why there are none.
    """
    if reason := _unusable(picture):
        return NoBoard(reason)
    grey = _stretch(picture)
    corners = _find_corners(grey, board)
    if corners is None:
        return NoBoard(_why_nothing_found(picture, board))
    sharpness = _sharpness_px(grey, board, corners)
    grid, contrast = _order(corners.reshape(board.rows, board.columns, 2), picture)
    noise = pixel_noise(picture)
    if contrast < MIN_CONTRAST_TO_NOISE * noise:
        return NoBoard(
            f"contrast too small: {contrast:.3g} counts between squares, pixel noise {noise:.3g} counts"
        )
    if not sharpness <= MAX_SHARPNESS_PX:
        return NoBoard(
            f"too blurred: edges are {sharpness:.1f} px wide, at most {MAX_SHARPNESS_PX:g} px will do"
        )
    return Detection(frozen_array(grid.reshape(-1, 2)), sharpness, contrast)


def _unusable(picture: NDArray[Any]) -> str:
    """Why a picture cannot hold a board at all; empty when it may."""
    if picture.ndim != 2 or min(picture.shape) < 32:
        return f"no picture: its shape is {picture.shape}"
    if not np.isfinite(picture).all():
        return f"{np.mean(~np.isfinite(picture)):.1%} of the pixels are not numbers"
    low, high = np.percentile(picture, (1, 99))
    if low == high:
        same = np.mean(picture == low)
        return f"the picture is constant: {same:.1%} of the pixels have the count {low:g}"
    return ""


def _stretch(picture: NDArray[Any]) -> Bytes:
    """Percentiles 1 and 99 to 0 and 255. Dividing 16 bit by 256 would leave a thermal board 2 grey levels."""
    values = np.asarray(picture, np.float32)
    low, high = np.percentile(values, (1, 99))
    stretched: Bytes = np.rint(np.clip((values - low) / (high - low), 0, 1) * 255).astype(np.uint8)
    return stretched


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


def _why_nothing_found(picture: NDArray[Any], board: Board) -> str:
    reason = f"no board of {board.columns} x {board.rows} inner corners found"
    for name, end in (("largest", picture.max()), ("smallest", picture.min())):
        part = np.mean(picture == end)
        if part > _SATURATED_PART:
            return f"{reason}; saturated: {part:.0%} of the pixels have the {name} count, {end:g}"
    return reason


def similar_boards(picture: NDArray[Any], board: Board) -> list[tuple[int, int]]:
    """Corner counts near those of `board` with which a board is found: the likely miscounts.

    Parameters
    ----------
    picture
        (rows, columns) counts, a picture in which `board` was not found.
    board
        The board that was looked for.

    Returns
    -------
    list of tuple
        (columns, rows), most often empty.
    """
    import cv2

    if _unusable(picture):
        return []
    grey = _stretch(picture)
    steps = ((-1, -1), (1, 1), (-1, 0), (0, -1), (1, 0), (0, 1))
    sizes = [(board.columns + across, board.rows + along) for across, along in steps]
    return [size for size in sizes if min(size) >= 3 and cv2.findChessboardCornersSB(grey, size, flags=0)[0]]
