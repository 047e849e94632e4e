"""1/f noise as a pure function of time: a sum of random series, one per octave.

The series of period P runs through independent random values at the multiples of P, shifted at random,
and mixes neighbours with weights cos and sin, which keeps its variance σ². Its spectrum is that of one
shape, stretched; periods a factor of two apart therefore add up to the one-sided spectral density
σ² / (f ln 2). This holds within 15 % from 1 / LONGEST_S to 0.05 / SHORTEST_S; below, the spectrum becomes
flat, and above, where the white noise rules, it falls faster.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.seeds import generator

SHORTEST_S = 0.125
LONGEST_S = 2048.0


class Flicker:
    """1/f noise of many pixels, all alike and independent of each other.

    Parameters
    ----------
    per_octave
        Standard deviation of what falls into one octave of frequency, in the unit of the result.
    shape
        (rows, columns) of the pixels.
    seed, key
        Seed of the scene, and names that tell this noise from others.
    """

    def __init__(self, per_octave: float, shape: tuple[int, int], seed: int, *key: str) -> None:
        self._per_octave = per_octave
        self._shape = shape
        self._seed, self._key = seed, key
        octaves = round(math.log2(LONGEST_S / SHORTEST_S)) + 1
        self._periods_s = [SHORTEST_S * 2**octave for octave in range(octaves)]
        self._phases = generator(seed, *key, "phases").uniform(size=octaves)
        self._fields: dict[tuple[int, int], NDArray[np.float32]] = {}

    def at(self, time_s: float) -> NDArray[np.float32]:
        """Noise at a time: a new array (rows, columns) float32."""
        total = np.zeros(self._shape, np.float32)
        used = {}
        for octave, period_s in enumerate(self._periods_s):
            number, fraction = divmod(time_s / period_s + float(self._phases[octave]), 1.0)
            angle = 0.5 * math.pi * fraction
            for offset, weight in ((0, math.cos(angle)), (1, math.sin(angle))):
                place = octave, int(number) + offset
                used[place] = self._field(*place)
                cv2.scaleAdd(used[place], self._per_octave * weight, total, dst=total)
        # Only the fields in use are kept: those of a long octave serve for minutes.
        self._fields = used
        return total

    def _field(self, octave: int, number: int) -> NDArray[np.float32]:
        kept = self._fields.get((octave, number))
        if kept is not None:
            return kept
        # `number` is negative before the scene starts; seeds must not be.
        random = generator(self._seed, *self._key, octave, number % 2**32)
        return random.standard_normal(self._shape, dtype=np.float32)
