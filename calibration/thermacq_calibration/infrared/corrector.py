"""Applies a `CameraCorrection` to one picture after the other, in one pass over memory."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.infrared.correction import CameraCorrection, Picture

_STRIP_ROWS = 64
# So many rows of counts, gain, offset and result fit into the cache together.
_FOLD_STEP_K = 0.02
# Temperatures are rounded to this before the shading is scaled: what a picture becomes depends on its own
# temperature only, never on the pictures before it, and noise of the reading seldom costs a pass.
_PLAUSIBLE_K = (200.0, 400.0)
_FEWEST_NEIGHBOURS = 3
_WIDEST = 5


class Corrector:
    """Non-uniformity, shading and bad pixels of one camera, each of which can be left out.

    Parameters
    ----------
    correction
        The record to apply.
    nonuniformity
        Gain and offset of each pixel.
    bad_pixels
        Replace bad pixels by the median of their good neighbours.
    shading
        Take the shading away, scaled by the camera's temperature.
    """

    def __init__(
        self,
        correction: CameraCorrection,
        nonuniformity: bool = True,
        bad_pixels: bool = True,
        shading: bool = True,
    ) -> None:
        self.correction = correction
        self._gain = correction.gain if nonuniformity else None
        self._own_offset = correction.offset if nonuniformity else None
        self._shading = correction.shading if shading else None
        self._folded_factor: float | None = None
        self._offset = self._own_offset
        self._replacement = Replacement(correction.bad_pixels > 0) if bad_pixels else None

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the corrections that are applied, in order."""
        used = {
            "nonuniformity": self._gain is not None,
            "shading": self._shading is not None,
            "bad-pixels": self._replacement is not None,
        }
        return tuple(name for name, is_used in used.items() if is_used)

    def __call__(
        self,
        counts: NDArray[np.uint16] | Picture,
        fpa_temperature_k: float = math.nan,
        out: Picture | None = None,
    ) -> Picture:
        """Correct a picture.

        Parameters
        ----------
        counts
            (rows, columns) uint16, raw, or float32 of a mean of raw pictures; left as they are.
        fpa_temperature_k
            Temperature of the camera with this picture; NaN (unknown): shading as it was measured.
        out
            (rows, columns) float32, receives the result; None: a new array.

        Returns
        -------
        numpy.ndarray
            (rows, columns) float32, corrected counts.

        Raises
        ------
        CalibrationError
            The picture has another size than the correction, or the temperature is not in kelvin.
        """
        if counts.shape != self.correction.shape:
            raise CalibrationError(
                f"a picture of {_size(counts.shape)} pixels does not fit the correction of camera "
                f"'{self.correction.camera}' ({_size(self.correction.shape)})",
                remedy="Give the correction that was made for this camera and picture format.",
            )
        if out is None:
            out = np.empty(counts.shape, np.float32)
        self._fold(fpa_temperature_k)
        for first in range(0, len(counts), _STRIP_ROWS):
            rows = slice(first, first + _STRIP_ROWS)
            strip = out[rows]
            np.copyto(strip, counts[rows])
            if self._gain is not None:
                strip *= self._gain[rows]
            if self._offset is not None:
                strip += self._offset[rows]
        if self._replacement is not None:
            self._replacement(out)
        return out

    def _fold(self, temperature_k: float) -> None:
        """Bring the shading at this temperature into the offset."""
        if self._shading is None:
            return
        if not math.isnan(temperature_k):
            if not _PLAUSIBLE_K[0] < temperature_k < _PLAUSIBLE_K[1]:
                raise CalibrationError(
                    f"camera '{self.correction.camera}' reports {temperature_k:g} K inside",
                    remedy="Temperatures are in kelvin; without one, shading is applied as it was measured.",
                )
            temperature_k = round(temperature_k / _FOLD_STEP_K) * _FOLD_STEP_K
        factor = self.correction.shading_factor(temperature_k)
        if factor != self._folded_factor:
            fold = self._shading * np.float32(-factor)
            if self._own_offset is not None:
                fold += self._own_offset
            self._offset, self._folded_factor = fold, factor


class Replacement:
    """Replaces bad pixels in place by the median of their good neighbours.

    The neighbours are the good ones of the 3 x 3 pixels around, or of 5 x 5 and wider where fewer than three are
    good.

    Parameters
    ----------
    is_bad
        (rows, columns) bool.

    Raises
    ------
    CalibrationError
        A bad pixel has no three good neighbours within 11 x 11.
    """

    def __init__(self, is_bad: NDArray[np.bool_]) -> None:
        self._places = np.flatnonzero(is_bad)
        neighbours, counts = _good_neighbours(is_bad, self._places)
        self._neighbours = np.where(neighbours < 0, 0, neighbours)
        self._missing = neighbours < 0
        self._values = np.empty(neighbours.shape, np.float32)
        column = np.arange(len(self._places))
        self._low = ((counts - 1) // 2, column)
        self._high = (counts // 2, column)

    def __call__(self, picture: Picture) -> None:
        """Replace the bad pixels of a (rows, columns) float32 picture in place."""
        if not len(self._places):
            return
        values = self._values
        flat = picture.reshape(-1)
        np.take(flat, self._neighbours, out=values, mode="clip")
        # Missing neighbours sort to the end, past the median of those that are there.
        values[self._missing] = np.inf
        values.sort(axis=0)
        flat[self._places] = 0.5 * (values[self._low] + values[self._high])


def _good_neighbours(
    is_bad: NDArray[np.bool_], places: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Flat indices of the good pixels around each bad one, (most, bad), -1 where fewer; and their numbers."""
    columns = is_bad.shape[1]
    found: list[list[int]] = []
    for place in places:
        row, column = divmod(int(place), columns)
        for reach in range(1, _WIDEST + 1):
            top, left = max(0, row - reach), max(0, column - reach)
            part = ~is_bad[top : row + reach + 1, left : column + reach + 1]
            down, right = np.nonzero(part)
            if len(down) >= _FEWEST_NEIGHBOURS:
                break
        else:
            raise CalibrationError(
                f"around row {row}, column {column} so many pixels are bad that none can be replaced",
                remedy="Look at the bad-pixel map: the reference views may have been covered in part.",
            )
        found.append(((top + down) * columns + left + right).tolist())
    counts = np.array([len(near) for near in found], np.intp)
    table = np.full((counts.max(initial=0), len(places)), -1, np.intp)
    for number, near in enumerate(found):
        table[: len(near), number] = near
    return table, counts


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(size) for size in shape)
