"""The thermal pattern of the water: a random temperature field over material labels.

The pattern is a function of the material label, so it moves, stretches and drifts with the water. It is
replaced slowly: at any time two unrelated fields are mixed with weights cos and sin, which keeps the
variance; each lives for two lifetimes. All fields are one periodic field, shifted at random.

The field is defined as the bilinear interpolant of a grid of 0.25 mm, a quarter of a pixel's footprint.
OpenCV 5 samples that exactly; OpenCV 4 rounds places to 1/32 of the grid, 8 µm or 0.008 px.
"""

from __future__ import annotations

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
PERIOD_M = _COARSE * _REFINEMENT * _SPACING_M
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

    def sample(self, label_x_m: Floats, label_y_m: Floats, time_s: float) -> NDArray[np.float32]:
        """Temperature deviation of labelled water.

        Parameters
        ----------
        label_x_m, label_y_m
            (rows, columns) float64, material labels in metres.
        time_s
            Time of the scene.

        Returns
        -------
        numpy.ndarray
            (rows, columns) float32, kelvin.
        """
        age, fraction = divmod(time_s / self._lifetime_s, 1.0)
        angle = 0.5 * np.pi * fraction
        old = self._sample_field(int(age), label_x_m, label_y_m)
        new = self._sample_field(int(age) + 1, label_x_m, label_y_m)
        old *= np.float32(np.cos(angle))
        new *= np.float32(np.sin(angle))
        old += new
        return old

    def _sample_field(self, number: int, label_x_m: Floats, label_y_m: Floats) -> NDArray[np.float32]:
        # `number` may be -1 just before the scene starts; seeds must not be negative.
        shift = generator(self._seed, "texture shift", number % 2**32).uniform(0, PERIOD_M, 2)
        columns, rows = _grid_place(label_y_m, shift[0]), _grid_place(label_x_m, shift[1])
        sampled = cv2.remap(self._field, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return np.asarray(sampled, np.float32)


def _grid_place(label_m: Floats, shift_m: float) -> NDArray[np.float32]:
    """Place on the grid, brought near to zero so that float32 resolves 0.0002 of its spacing."""
    place = (label_m + shift_m) / PERIOD_M
    place -= np.floor(place.min())
    return (place * (PERIOD_M / _SPACING_M)).astype(np.float32)


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
    fine = np.zeros((_COARSE * _REFINEMENT, _COARSE * _REFINEMENT // 2 + 1), spectrum.dtype)
    fine[:half, : half + 1] = spectrum[:half]
    fine[-half:, : half + 1] = spectrum[half:]
    field = fft.irfft2(fine, s=(fine.shape[0],) * 2, overwrite_x=True)
    field *= settings.rms_k / max(float(field.std()), 1e-30)
    return np.ascontiguousarray(field, np.float32)
