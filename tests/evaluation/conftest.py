from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

Series = NDArray[np.float64]


@pytest.fixture(scope="session")
def regular_wave() -> Callable[..., tuple[Series, Series]]:
    """A sine wave of known height and period, 28 samples a period unless told otherwise."""

    def make(
        height_m: float = 0.08,
        period_s: float = 0.55,
        waves: float = 10.3,
        per_period: float = 28.0,
        phase: float = 0.4,
    ) -> tuple[Series, Series]:
        time = np.arange(int(waves * per_period)) * period_s / per_period
        return time, height_m / 2 * np.cos(2 * np.pi * time / period_s - phase)

    return make


@pytest.fixture(scope="session")
def random_sea() -> Callable[..., tuple[Series, Series]]:
    """A Gaussian sea of a narrow spectrum with Hm0 = 1 m and mean frequency 0.25 Hz, sampled at 4 Hz."""

    def make(seed: int = 0, duration_s: float = 4000.0) -> tuple[Series, Series]:
        generator = np.random.default_rng(seed)
        time = np.arange(0, duration_s, 0.25)
        frequency = np.arange(0.15, 0.35, 0.5 / duration_s)
        density = np.exp(-(((frequency - 0.25) / 0.03) ** 2))
        amplitude = np.sqrt(2 * density / density.sum()) / 4
        phase = generator.uniform(0, 2 * np.pi, frequency.size)
        elevation = np.zeros_like(time)
        for a, f, p in zip(amplitude, frequency, phase, strict=True):
            elevation += a * np.cos(2 * np.pi * f * time + p)
        return time, elevation

    return make
