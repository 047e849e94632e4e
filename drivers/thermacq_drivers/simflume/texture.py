"""The thermal pattern of the water: a random temperature field over material labels.

The pattern is a function of the material label, so it moves, stretches and drifts with the water. It is
replaced slowly: at any time two unrelated fields are mixed with weights cos and sin, which keeps the
variance; each lives for two lifetimes. All fields are one periodic field, shifted at random.

The field is defined as the bilinear interpolant of a grid of 0.25 mm, a quarter of a pixel's footprint.
OpenCV 5 samples that exactly; OpenCV 4 rounds places to 1/32 of the grid, 8 µm or 0.008 px.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.settings import TextureSettings
from thermacq_drivers.simflume.surfaces import Floats

_COARSE = 1024
_REFINEMENT = 4
_SPACING_M = 0.00025
_SIZE = _COARSE * _REFINEMENT
PERIOD_M = _SIZE * _SPACING_M
"""The pattern repeats after this distance, 1.024 m, along both label coordinates."""


class ThermalTexture:
    """Temperature deviation in kelvin as a function of label and time.

    Parameters
    ----------
    settings
        Strength, correlation lengths and lifetime.
    seed
        Seed of the scene.
    """

    def __init__(self, settings: TextureSettings, seed: int) -> None:
        self._field = _random_field(settings, seed)
        self._lifetime_s = settings.lifetime_s
        self._seed = seed

    def sample(
        self, rows: NDArray[np.float32], columns: NDArray[np.float32], time_s: float
    ) -> NDArray[np.float32]:
        """Temperature deviation at places of the grid.

        Parameters
        ----------
        rows, columns
            (rows, columns) float32, places given by `grid_place` for the labels along x and along y.
        time_s
            Time of the scene.

        Returns
        -------
        numpy.ndarray
            (rows, columns) float32, kelvin.
        """
        age, fraction = divmod(time_s / self._lifetime_s, 1.0)
        angle = 0.5 * np.pi * fraction
        old = self._sample_field(int(age), rows, columns)
        new = self._sample_field(int(age) + 1, rows, columns)
        old *= np.float32(np.cos(angle))
        new *= np.float32(np.sin(angle))
        old += new
        return old

    def _sample_field(
        self, number: int, rows: NDArray[np.float32], columns: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        # `number` may be -1 just before the scene starts; seeds must not be negative.
        random = generator(self._seed, "texture shift", number % 2**32)
        down, right = random.uniform(0, _SIZE, 2)
        sampled = cv2.remap(
            self._field,
            _shifted(columns, right),
            _shifted(rows, down),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )
        return np.asarray(sampled, np.float32)


def _shifted(place: NDArray[np.float32], shift: float) -> NDArray[np.float32]:
    """Shifted places within the grid: OpenCV can wrap them too, but far more slowly."""
    shifted = place + np.float32(shift)
    periods = np.floor(shifted * np.float32(1 / _SIZE))
    periods *= np.float32(_SIZE)
    shifted -= periods
    return shifted


def grid_place(label_m: Floats) -> Floats:
    """Place of labels on the texture's grid, brought near to zero by whole periods."""
    periods = label_m / PERIOD_M
    place: Floats = (periods - np.floor(periods.min())) * _SIZE
    return place


@lru_cache(maxsize=1)
def _random_field(settings: TextureSettings, seed: int) -> NDArray[np.float32]:
    """Periodic Gaussian field, (4096, 4096) float32, kelvin; rows along x, columns along y.

    Equal variance at each correlation length l: the covariance is the mean of exp(-(r/l)²/2).
    """
    noise = generator(seed, "texture").standard_normal((_COARSE, _COARSE), dtype=np.float32)
    spectrum = fft.rfft2(noise)
    step_m = _SPACING_M * _REFINEMENT
    along = 2 * np.pi * fft.fftfreq(_COARSE, step_m)[:, None] * settings.streakiness
    across = 2 * np.pi * fft.rfftfreq(_COARSE, step_m)[None, :]
    power = np.zeros((_COARSE, _COARSE // 2 + 1))
    for length_m in settings.lengths_m:
        shape = np.exp(-0.5 * (along**2 + across**2) * length_m**2)
        power += shape / shape.sum()
    power[0, 0] = 0.0
    spectrum *= np.sqrt(power)
    # Zero-padding the spectrum refines the grid without changing the field.
    half = _COARSE // 2
    fine = np.zeros((_SIZE, _SIZE // 2 + 1), spectrum.dtype)
    fine[:half, : half + 1] = spectrum[:half]
    fine[-half:, : half + 1] = spectrum[half:]
    field = fft.irfft2(fine, s=(_SIZE, _SIZE), overwrite_x=True)
    field *= settings.rms_k / max(float(field.std()), 1e-30)
    return np.ascontiguousarray(field, np.float32)
