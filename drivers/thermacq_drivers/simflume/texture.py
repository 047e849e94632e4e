"""The thermal pattern of the water: a random temperature field over material labels.

The pattern is a function of the material label, so it moves, stretches and drifts with the water. It is
replaced slowly, by water that comes up from below: at any time two unrelated fields are mixed with weights
cos and sin, which keeps the variance; each lives for two lifetimes. All fields are one periodic field,
shifted at random.

Eddies draw a pattern out into filaments. This is done once, by displacing a Gaussian field with the curl of
a random stream function at two scales, and then letting heat diffuse over half a millimetre.

The field is defined as the bilinear interpolant of a grid of 0.5 mm, half of a pixel's footprint. OpenCV 5
samples that exactly; OpenCV 4 rounds places to 1/32 of the grid, 16 µm or 0.017 px. The grid is kept twice
along each axis, so that a view narrower than one period never has to wrap, which costs more than sampling.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.settings import TextureSettings
from thermacq_drivers.simflume.surfaces import Floats

_COARSE = 1024
_REFINEMENT = 2
_SPACING_M = 0.0005
_SIZE = _COARSE * _REFINEMENT
_EDDY_GRID = 512
_SMALL_EDDIES = 0.4
_DIFFUSION_M = 0.0005
_MARGIN = 8
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
        down, right = (int(shift) for shift in random.uniform(0, _SIZE, 2))
        first_row, rows = _from_first(rows, down)
        first_column, columns = _from_first(columns, right)
        sampled = cv2.remap(self._field[first_row:, first_column:], columns, rows, cv2.INTER_LINEAR)
        return np.asarray(sampled, np.float32)


def _from_first(place: NDArray[np.float32], shift: int) -> tuple[int, NDArray[np.float32]]:
    """First row (or column) of the doubled grid that shifted places need, and the places counted from it."""
    first = int(np.floor(place.min()))
    start = (first + shift) % _SIZE
    local = place - np.float32(first)
    if start + local.max() >= 2 * _SIZE - 1:
        start, local = 0, np.mod(local + np.float32(start), np.float32(_SIZE))
    return start, local


def grid_place(label_m: Floats) -> Floats:
    """Place of labels on the texture's grid, brought near to zero by whole periods."""
    periods = label_m / PERIOD_M
    place: Floats = (periods - np.floor(periods.min())) * _SIZE
    return place


@lru_cache(maxsize=1)
def _random_field(settings: TextureSettings, seed: int) -> NDArray[np.float32]:
    """The pattern twice along each axis, (4096, 4096) float32, kelvin; rows along x, columns along y."""
    field = _gaussian_field(settings, seed)
    if settings.stirring_m > 0:
        for part in (1.0, _SMALL_EDDIES):
            field = _stir(field, part * settings.stirring_m, part * settings.eddies_m, seed)
        field = _wrapped(cv2.GaussianBlur, field, (0, 0), _DIFFUSION_M / _SPACING_M)
    if settings.warm_streaks > 0:
        field *= settings.warm_streaks / max(float(field.std()), 1e-30)
        field = np.expm1(field)
        field -= field.mean()
    field *= settings.rms_k / max(float(field.std()), 1e-30)
    return np.tile(field, (2, 2))


def _stir(field: NDArray[np.float32], reach_m: float, eddies_m: float, seed: int) -> NDArray[np.float32]:
    """The field displaced by eddies: by `reach_m` (root mean square), in eddies of that correlation length."""
    noise = generator(seed, "eddies", round(eddies_m * 1e6)).standard_normal((_EDDY_GRID, _EDDY_GRID))
    step_m = PERIOD_M / _EDDY_GRID
    along = 2 * np.pi * fft.fftfreq(_EDDY_GRID, step_m)[:, None]
    across = 2 * np.pi * fft.rfftfreq(_EDDY_GRID, step_m)[None, :]
    stream = fft.rfft2(noise) * np.exp(-0.25 * (along**2 + across**2) * eddies_m**2)
    down, right = fft.irfft2(1j * across * stream), fft.irfft2(-1j * along * stream)
    scale = reach_m / _SPACING_M / np.sqrt((down**2 + right**2).mean())
    size = (_SIZE + 2 * _MARGIN * _SIZE // _EDDY_GRID,) * 2
    here = np.arange(_SIZE, dtype=np.float32)
    shifts = (
        _wrapped(cv2.resize, (scale * shift).astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
        for shift in (down, right)
    )
    rows, columns = (
        np.mod(start + shift, np.float32(_SIZE))
        for start, shift in zip((here[:, None], here), shifts, strict=True)
    )
    stirred = cv2.remap(field, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(stirred, np.float32)


def _wrapped(
    operation: Callable[..., Any], field: NDArray[np.float32], *arguments: Any, **options: Any
) -> NDArray[np.float32]:
    """A filter or enlargement of a periodic field, which OpenCV would take to end at its border."""
    padded = np.asarray(operation(np.pad(field, _MARGIN, mode="wrap"), *arguments, **options), np.float32)
    margin = _MARGIN * padded.shape[0] // (len(field) + 2 * _MARGIN)
    return padded[margin:-margin, margin:-margin]


def _gaussian_field(settings: TextureSettings, seed: int) -> NDArray[np.float32]:
    """Periodic Gaussian field, (2048, 2048) float32, of no particular strength.

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
    return np.asarray(field, np.float32)
