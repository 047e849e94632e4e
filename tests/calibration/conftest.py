"""A small camera in formulas, for tests of the infrared correction."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from thermacq_calibration import ReferenceView, observe

SHAPE = (48, 64)


class FormulaCamera:
    """counts = 6000 + 80 gain (T - 295) + offset + shading, and normal noise of 3 counts."""

    def __init__(self, seed: int = 1) -> None:
        self.random = np.random.default_rng(seed)
        self.gain = self.random.normal(1, 0.03, SHAPE)
        self.offset = self.random.normal(0, 150, SHAPE)
        self.shading = np.zeros(SHAPE)
        self.noise = np.full(SHAPE, 3.0)

    def mean(self, kelvin: float) -> np.ndarray:
        return 6000 + 80 * self.gain * (kelvin - 295) + self.offset + self.shading

    def frames(self, kelvin: float, count: int = 64) -> Iterator[np.ndarray]:
        mean = self.mean(kelvin)
        for _ in range(count):
            noisy = mean + self.noise * self.random.standard_normal(SHAPE)
            yield np.clip(np.rint(noisy), 0, 16383).astype(np.uint16)

    def view(
        self, kelvin: float, count: int = 64, known: bool = True, inside_k: float | None = 305.0
    ) -> ReferenceView:
        return observe(self.frames(kelvin, count), kelvin if known else None, inside_k, f"run-{kelvin:g}")


@pytest.fixture
def camera() -> FormulaCamera:
    return FormulaCamera()


@pytest.fixture
def another_camera() -> Callable[[int], FormulaCamera]:
    return FormulaCamera
