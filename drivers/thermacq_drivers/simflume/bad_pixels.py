"""Bad pixels: which they are, of which kind, and how each kind behaves."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.sensor_settings import SensorSettings

_DWELL_S = (1.0, 8.0)
# A blinking pixel throws a coin after each such time.


class BadPixel(IntFlag):
    """Why a pixel is bad; the bits of a bad-pixel map."""

    NONE = 0
    DEAD = 1
    HOT = 2
    NOISY = 4
    BLINKING = 8
    OUTLIER = 16


KINDS = (BadPixel.DEAD, BadPixel.HOT, BadPixel.NOISY, BadPixel.BLINKING, BadPixel.OUTLIER)


@dataclass(frozen=True, eq=False)
class BadPixels:
    """The bad pixels of one sensor; places are flat indices, one value per pixel of the kind.

    Parameters
    ----------
    places
        Flat indices of all bad pixels, ascending.
    kinds
        `BadPixel` of each.
    dead_gain
        Relative responsivity of the dead ones, below one half.
    noise_excess
        Noise of the noisy ones over that of good pixels.
    jump_k, dwell_s, phase
        Height of a blinking pixel's jumps, time between its chances to jump, and their shift.
    outlier_offset_k, outlier_curvature_per_k
        Offset and curvature of the outliers. A two-point correction takes away the offset only.
    """

    places: NDArray[np.intp]
    kinds: NDArray[np.uint8]
    dead_gain: NDArray[np.float32]
    noise_excess: NDArray[np.float32]
    jump_k: NDArray[np.float32]
    dwell_s: NDArray[np.float64]
    phase: NDArray[np.uint64]
    outlier_offset_k: NDArray[np.float32]
    outlier_curvature_per_k: NDArray[np.float32]

    def of(self, kind: BadPixel) -> NDArray[np.intp]:
        """Flat indices of the pixels of one kind."""
        places: NDArray[np.intp] = self.places[self.kinds == kind]
        return places

    def map(self, rows: int, columns: int) -> NDArray[np.uint8]:
        """Bad-pixel map: (rows, columns) uint8, the bits of `BadPixel`."""
        picture = np.zeros(rows * columns, np.uint8)
        picture[self.places] = self.kinds
        return picture.reshape(rows, columns)

    def blink_k(self, time_s: float) -> NDArray[np.float32]:
        """Present rise of the blinking pixels, kelvin: 0 or their jump."""
        turns = np.floor(time_s / self.dwell_s).astype(np.int64).astype(np.uint64) + self.phase
        return np.where(_mixed(turns) & np.uint64(1), self.jump_k, np.float32(0))


def draw_bad_pixels(settings: SensorSettings, places: NDArray[np.intp], seed: int, name: str) -> BadPixels:
    """Kinds and behaviour of the bad pixels of one camera.

    Parameters
    ----------
    settings
        Shares of the kinds.
    places
        Flat indices of the bad pixels.
    seed, name
        Seed of the scene and name of the camera.
    """
    random = generator(seed, name, "bad pixels")
    shares = np.array(settings.bad_pixel_shares.in_order)
    kinds = random.choice(np.array(KINDS, np.uint8), len(places), p=shares / shares.sum())
    dead, noisy, blinking, outlier = (
        int(np.count_nonzero(kinds == kind))
        for kind in (BadPixel.DEAD, BadPixel.NOISY, BadPixel.BLINKING, BadPixel.OUTLIER)
    )
    return BadPixels(
        places=places,
        kinds=kinds,
        dead_gain=random.uniform(0.0, 0.4, dead).astype(np.float32),
        noise_excess=random.uniform(3.0, 8.0, noisy).astype(np.float32),
        jump_k=_either_sign(random, 0.5, 2.0, blinking),
        dwell_s=random.uniform(*_DWELL_S, blinking),
        phase=random.integers(0, 2**62, blinking, dtype=np.uint64),
        outlier_offset_k=_either_sign(random, 1.0, 4.0, outlier),
        outlier_curvature_per_k=_either_sign(random, 0.02, 0.05, outlier),
    )


def _either_sign(random: np.random.Generator, low: float, high: float, count: int) -> NDArray[np.float32]:
    size = random.uniform(low, high, count) * random.choice([-1.0, 1.0], count)
    either: NDArray[np.float32] = size.astype(np.float32)
    return either


def _mixed(words: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Random-looking bits of each word (the finaliser of SplitMix64)."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))
