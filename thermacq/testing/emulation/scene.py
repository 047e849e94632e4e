"""Pictures for emulated cameras: a drifting warm texture that is cheap to make and tells its number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_DIGITS = 8
_MARK = 3000
_STEP = 16


class ThermalScene:
    """Pictures of a slowly drifting texture, different from frame to frame.

    Parameters
    ----------
    rows, columns
        Size of the pictures; at least 16 columns.
    level, span
        Mean counts and the range that the texture takes, counts.
    seed
        Two cameras with the same seed see the same.
    """

    def __init__(
        self, rows: int, columns: int, *, level: int = 8000, span: int = 2000, seed: int = 0
    ) -> None:
        rng = np.random.default_rng(seed)
        y, x = np.mgrid[0:rows, 0 : 2 * columns]
        waves = np.sin(2 * np.pi * x / columns * 3) * np.cos(2 * np.pi * y / rows * 2)
        noise = rng.normal(0, 0.02, (rows, columns))
        texture = level + span * (0.4 * waves + np.tile(noise, 2))
        self._texture = np.clip(texture, 0, 65535).astype(np.uint16)
        self.rows, self.columns = rows, columns

    def picture(self, number: int) -> NDArray[np.uint16]:
        """Make the picture of a frame: (rows, columns) uint16, a fresh array."""
        shift = number % self.columns
        picture: NDArray[np.uint16] = self._texture[:, shift : shift + self.columns].copy()
        digits = [(number >> (4 * place)) & 0xF for place in range(_DIGITS)]
        picture[0, 0] = _MARK
        picture[0, 1 : 1 + _DIGITS] = [_MARK + _STEP * (1 + digit) for digit in digits]
        return picture


def frame_number(picture: NDArray[np.uint16]) -> int:
    """Read the number (modulo 2**32) of a picture of `ThermalScene`, (rows, columns) uint16.

    It survives a constant added to all counts. Raises `ValueError` for any other picture.
    """
    marks = picture[0, 1 : 1 + _DIGITS].astype(int) - int(picture[0, 0])
    digits, rest = np.divmod(marks, _STEP)
    if np.any(rest) or np.any(digits < 1) or np.any(digits > 16):
        raise ValueError("this is no picture of the emulated scene")
    return int(sum((int(digit) - 1) << (4 * place) for place, digit in enumerate(digits)))
