"""Noise that is new in each frame: of pixels, rows, columns, and of the frame as a whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.sensor_settings import SensorSettings


class TemporalNoise:
    """White noise of one camera; the noise of a frame follows from its number.

    Parameters
    ----------
    settings
        Levels, in kelvin.
    seed, name
        Seed of the scene and name of the camera.
    noisy
        Flat indices of the pixels that are noisier than others.
    excess
        Their noise over that of the others.
    """

    def __init__(
        self,
        settings: SensorSettings,
        seed: int,
        name: str,
        noisy: NDArray[np.intp],
        excess: NDArray[np.float32],
    ) -> None:
        self._settings = settings
        self._key = (seed, name)
        self._noisy, self._excess = noisy, excess

    def add(self, seen: NDArray[np.float32], index: int) -> None:
        """Add the noise of frame `index` to (rows, columns) float32 kelvin."""
        settings = self._settings
        if settings.netd_k > 0:
            noise = self._draw("noise", index, seen.shape, settings.netd_k)
            noise.reshape(-1)[self._noisy] *= self._excess
            seen += noise
        rows, columns = seen.shape
        for purpose, shape, level_k in (
            ("row noise", (rows, 1), settings.row_noise_k),
            ("column noise", (1, columns), settings.column_noise_k),
            ("frame noise", (1, 1), settings.frame_noise_k),
        ):
            if level_k > 0:
                seen += self._draw(purpose, index, shape, level_k)

    def _draw(self, purpose: str, index: int, shape: tuple[int, ...], level_k: float) -> NDArray[np.float32]:
        seed, name = self._key
        noise = generator(seed, name, purpose, index).standard_normal(shape, dtype=np.float32)
        noise *= np.float32(level_k)
        return noise
