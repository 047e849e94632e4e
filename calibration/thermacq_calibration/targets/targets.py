"""Find a calibration target in thermal pictures, or say in words why there is none.

The recipe was chosen on synthetic thermal boards: mean of up to 16 frames, stretched between its percentiles
1 and 99 to 8 bit, then the detector of the board's kind. docs/reference/calibration.md has the figures.

Corners of chessboards are returned in one order that depends on the board alone, so that both cameras start
at the same physical corner: along the columns, right-handed as seen by the camera, and starting at the end
where the first inner square is the brighter one. This is unique when one corner count is even and the other
odd. On other targets the markers, or the shift of every other row of circles, say where the first point is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Board, BoardKind
from thermacq_calibration.targets.charuco import find_charuco
from thermacq_calibration.targets.chessboard import find_chessboard, similar_chessboards
from thermacq_calibration.targets.circles import find_circles
from thermacq_calibration.targets.detection import Detection, NoBoard
from thermacq_calibration.targets.marked import find_marked
from thermacq_calibration.targets.pictures import saturation, stretch, unusable
from thermacq_calibration.targets.poses import pixel_noise
from thermacq_calibration.targets.seen_markers import seen_markers

FRAMES_TO_AVERAGE = 16
# Edges that wide (10 % to 90 %) come from a blur of sigma 4 px, or of 2 px under much noise.
MAX_SHARPNESS_PX = 10.0
# Below this ratio of contrast to pixel noise corners are off by 0.2 px and more.
MIN_CONTRAST_TO_NOISE = 5.0

_FINDERS = {
    BoardKind.CHESSBOARD: find_chessboard,
    BoardKind.CIRCLES: find_circles,
    BoardKind.CHARUCO: find_charuco,
    BoardKind.MARKED: find_marked,
}


def average(frames: NDArray[Any]) -> NDArray[np.float32]:
    """Mean over the first axis: (frames, rows, columns) to (rows, columns) float32, counts."""
    return np.asarray(np.mean(frames, axis=0, dtype=np.float64), np.float32)


def detect_board(picture: NDArray[Any], board: Board) -> Detection | NoBoard:
    """Look for the board in one picture.

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
    if reason := unusable(picture):
        return NoBoard(reason)
    found = _FINDERS[board.kind](picture, stretch(picture), board)
    if isinstance(found, NoBoard):
        limits = saturation(picture)
        return NoBoard(f"{found.reason}; {limits}" if limits else found.reason)
    noise = pixel_noise(picture)
    if found.contrast < MIN_CONTRAST_TO_NOISE * noise:
        return NoBoard(
            f"contrast too small: {found.contrast:.3g} counts between light and dark, "
            f"pixel noise {noise:.3g} counts"
        )
    if not found.sharpness_px <= MAX_SHARPNESS_PX:
        return NoBoard(
            f"too blurred: edges are {found.sharpness_px:.1f} px wide, at most {MAX_SHARPNESS_PX:g} px will do"
        )
    return found


def similar_boards(picture: NDArray[Any], board: Board) -> list[tuple[int, int]]:
    """Corner counts near those of `board` with which a chessboard is found: the likely miscounts.

    Parameters
    ----------
    picture
        (rows, columns) counts, a picture in which `board` was not found.
    board
        The board that was looked for.

    Returns
    -------
    list of tuple
        (columns, rows), the likeliest first; most often empty, always empty for other targets than plain chessboards.
    """
    if board.kind is not BoardKind.CHESSBOARD or unusable(picture):
        return []
    sizes = similar_chessboards(stretch(picture), board)
    # The detector also finds grids that skip corners; between their fields there is hardly any contrast.
    seen = {size: detect_board(picture, replace(board, columns=size[0], rows=size[1])) for size in sizes}
    there = [size for size in sizes if isinstance(seen[size], Detection)]
    # Boards that may be used first, then the larger ones: parts of a board are found as well.
    return sorted(there, key=lambda size: (sum(size) % 2 == 0, -size[0] * size[1]))


def other_markers(picture: NDArray[Any], board: Board) -> list[str]:
    """Bits of the markers that stand in a picture in which a plain chessboard was not found; see `seen_markers`."""
    if board.kind is not BoardKind.CHESSBOARD or unusable(picture):
        return []
    return seen_markers(stretch(picture))
