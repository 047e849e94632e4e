"""Markers of any kind in a picture, with their bits: to say why a plain chessboard is not found in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Float
from thermacq_calibration.targets.pictures import Bytes

# Thermal markers are small and blurred: looked for in pictures so many times larger, so smooth.
_SEARCHES = ((2, 1.5), (1, 0.8))
_BITS = range(3, 8)
_CELL_PX = 8
_RIM_PX = 2
# Contrast of light and dark bits over how uneven each of them is; of real markers 2.3 and more.
_LEAST_CLEAR = 1.5
# A speck in a dark square is no marker.
_FEWEST_LIGHT = 3


def seen_markers(grey: Bytes) -> list[str]:
    """Bits of the square markers in a picture, as they stand in it, rows from above: ``011/110/010``.

    A marker is a quadrangle with a dark border around a grid of 3 x 3 to 7 x 7 light and dark bits, in the picture
    or in its inverse; at least three bits are light. Plain squares are none.

    Parameters
    ----------
    grey
        (rows, columns) stretched to 8 bit.
    """
    import cv2

    # The dictionary does not matter: quadrangles whose bits it does not know are wanted as well.
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    for image in (grey, 255 - grey):
        for scale, sigma in _SEARCHES:
            large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
            smooth = np.asarray(cv2.GaussianBlur(large, (0, 0), sigma), np.uint8)
            known, _, others = detector.detectMarkers(smooth)
            quadrangles = [np.asarray(one, np.float64).reshape(4, 2) for one in (*known, *others)]
            found = [bits for one in quadrangles if (bits := _bits(smooth, one))]
            if found:
                return found
    return []


def _bits(image: Bytes, corners: Float) -> str:
    """Bits inside a quadrangle, of the grid that they fit best; empty when it is no marker."""
    best, clearest = "", _LEAST_CLEAR
    for count in _BITS:
        means, unevenness = _cells(image, _from_upper_left(corners), count + 2)
        light = means > (means.min() + means.max()) / 2
        inside = light[1:-1, 1:-1]
        if light.sum() != inside.sum() or inside.sum() < _FEWEST_LIGHT:
            continue
        contrast = means[light].mean() - means[~light].mean()
        clear = float(contrast / (means[light].std() + means[~light].std() + unevenness + 1))
        if clear > clearest:
            best, clearest = "/".join("".join(str(int(bit)) for bit in row) for row in inside), clear
    return best


def _cells(image: Bytes, corners: Float, count: int) -> tuple[NDArray[np.float64], float]:
    """Means of count x count cells of a quadrangle, and the mean unevenness within them."""
    import cv2

    side = count * _CELL_PX
    square = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) - 0.5
    turned = cv2.getPerspectiveTransform(corners.astype(np.float32), square)
    flat = np.asarray(cv2.warpPerspective(image, turned, (side, side)), np.float64)
    cells = flat.reshape(count, _CELL_PX, count, _CELL_PX)[:, _RIM_PX:-_RIM_PX, :, _RIM_PX:-_RIM_PX]
    return cells.mean(axis=(1, 3)), float(cells.std(axis=(1, 3)).mean())


def _from_upper_left(corners: Float) -> Float:
    """The corners, clockwise, beginning with the one that is uppermost and leftmost."""
    return np.roll(corners, -int(np.argmin(corners.sum(axis=1))), axis=0)
