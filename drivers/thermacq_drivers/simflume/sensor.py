"""How a microbolometer sees a scene: optics blur, fixed pattern, shading, noise, bad pixels, counts.

The levels are those of a camera that runs its own non-uniformity correction: what is left is small enough
to match pictures without further correction, and large enough to matter.
"""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.settings import Table

BIT_DEPTH = 14
MIDDLE_COUNT = 6000
"""Count of an object at the reference temperature."""

_FULL_SCALE = 2**BIT_DEPTH - 1
_SHADING_DEGREE = 3


class SensorSettings(Table):
    """What the sensor adds to the scene, in kelvin of apparent temperature."""

    blur_px: float = Field(0.6, ge=0, le=5, description="standard deviation of the optics' point spread")
    netd_k: float = Field(0.035, ge=0, description="temporal noise of a pixel")
    offset_k: float = Field(0.015, ge=0, description="fixed pattern of offsets left by the correction")
    gain: float = Field(0.002, ge=0, lt=0.5, description="fixed pattern of relative gains")
    shading_k: float = Field(0.2, ge=0, description="smooth non-uniformity, peak to peak")
    bad_pixel_fraction: float = Field(0.0005, ge=0, lt=0.2)
    bad_pixels: Literal["replaced", "raw"] = "replaced"
    counts_per_k: float = Field(100.0, gt=0)
    reference_k: float = Field(295.0, gt=0, description="temperature at which gains are equal")


class Sensor:
    """The sensor of one camera; its fixed pattern follows from the seed and the camera's name.

    Parameters
    ----------
    settings
        Levels of noise and pattern.
    rows, columns
        Size of the picture in pixels.
    seed, name
        Seed of the scene and name of the camera.
    """

    def __init__(self, settings: SensorSettings, rows: int, columns: int, seed: int, name: str) -> None:
        self._settings = settings
        self._key = (seed, name)
        random = generator(seed, name, "fixed pattern")
        shape = (rows, columns)
        self._gain = (1 + settings.gain * random.standard_normal(shape)).astype(np.float32)
        offset = settings.offset_k * random.standard_normal(shape)
        offset += settings.shading_k * _shading(rows, columns, random)
        # counts = gain · (T - reference) · counts_per_k + base
        self._gain *= np.float32(settings.counts_per_k)
        self._base = (MIDDLE_COUNT + settings.counts_per_k * offset).astype(np.float32)
        bad = np.flatnonzero(random.uniform(size=rows * columns) < settings.bad_pixel_fraction)
        self._bad = bad
        self._neighbours = _neighbours(bad, rows, columns)
        self._stuck = random.integers(0, _FULL_SCALE, len(bad)).astype(np.float32)

    def expose(self, temperature_k: NDArray[np.float32], index: int, counts: NDArray[np.uint16]) -> None:
        """One frame.

        Parameters
        ----------
        temperature_k
            (rows, columns) float32, apparent temperature that a perfect camera would see; overwritten.
        index
            Number of the exposure; picks the noise.
        counts
            (rows, columns) uint16, receives the counts.
        """
        settings = self._settings
        seen = temperature_k
        if settings.blur_px > 0:
            blurred = cv2.GaussianBlur(seen, (0, 0), settings.blur_px, borderType=cv2.BORDER_REPLICATE)
            seen = np.asarray(blurred, np.float32)
        seen = np.subtract(seen, np.float32(settings.reference_k), dtype=np.float32)
        if settings.netd_k > 0:
            noise = generator(self._key[0], self._key[1], "noise", index).standard_normal(
                seen.shape, dtype=np.float32
            )
            noise *= np.float32(settings.netd_k)
            seen += noise
        seen *= self._gain
        seen += self._base
        flat = seen.reshape(-1)
        if settings.bad_pixels == "replaced":
            flat[self._bad] = np.median(flat[self._neighbours], axis=0)
        else:
            flat[self._bad] = self._stuck
        np.rint(seen, out=seen)
        np.clip(seen, 0, _FULL_SCALE, out=seen)
        np.copyto(counts, seen, casting="unsafe")


def _shading(rows: int, columns: int, random: np.random.Generator) -> NDArray[np.float64]:
    """Smooth pattern, a random polynomial in both directions, of peak-to-peak 1 and mean 0."""
    weights = random.standard_normal((_SHADING_DEGREE + 1, _SHADING_DEGREE + 1))
    degree = np.add.outer(np.arange(_SHADING_DEGREE + 1), np.arange(_SHADING_DEGREE + 1))
    weights[(degree == 0) | (degree > _SHADING_DEGREE)] = 0
    pattern = np.polynomial.legendre.leggrid2d(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), weights)
    centred: NDArray[np.float64] = (pattern - pattern.mean()) / np.ptp(pattern)
    return centred


def _neighbours(bad: NDArray[np.intp], rows: int, columns: int) -> NDArray[np.intp]:
    """Flat indices of the eight pixels around each bad one, mirrored at the border: (8, bad)."""
    row, column = np.divmod(bad, columns)
    around = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if (down, right) != (0, 0):
                there = np.abs(row + down), np.abs(column + right)
                there = (
                    np.minimum(there[0], 2 * (rows - 1) - there[0]),
                    np.minimum(there[1], 2 * (columns - 1) - there[1]),
                )
                around.append(there[0] * columns + there[1])
    return np.array(around, np.intp).reshape(8, len(bad))
