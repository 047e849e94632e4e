from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.special import erfc

from thermacq_drivers.simflume.bolometer import LAG_RULES, lagged_temperature
from thermacq_drivers.simflume.mounting import Mounting
from thermacq_drivers.simflume.scene import build_view
from thermacq_drivers.simflume.sensor_settings import BolometerSettings
from thermacq_drivers.simflume.settings import parse_scene

TAU_S = 0.01


class Follows:
    """A uniform view whose temperature is a function of time."""

    def __init__(self, function: Callable[[float], float]) -> None:
        self.function = function

    def temperature(self, time_s: float, index: int) -> np.ndarray:
        return np.full((2, 2), self.function(time_s), np.float32)


def shown(function: Callable[[float], float], time_s: float, sub_exposures: int = 3) -> float:
    settings = BolometerSettings(time_constant_s=TAU_S, sub_exposures=sub_exposures)
    return float(lagged_temperature(Follows(function), settings, time_s, 0)[0, 0])


@pytest.mark.parametrize(
    ("sub_exposures", "reach", "error"), [(2, 1.5, 0.056), (3, 2.0, 0.017), (4, 3.0, 0.014)]
)
def test_transfer_function_is_that_of_a_first_order_lag(
    sub_exposures: int, reach: float, error: float
) -> None:
    nodes, weights = (np.array(rule) for rule in LAG_RULES[sub_exposures])
    assert weights.sum() == pytest.approx(1.0, abs=1e-9)
    assert weights @ nodes == pytest.approx(1.0, abs=2e-5)
    angle = np.linspace(0, reach, 301)[:, None]
    np.testing.assert_allclose(np.exp(-1j * angle * nodes) @ weights, 1 / (1 + 1j * angle[:, 0]), atol=error)


def test_a_swing_is_weakened_and_late() -> None:
    for turns in (0.5, 1.0, 1.5):
        rate = turns / TAU_S
        for time_s in (0.0, 0.013, 0.2):
            answer = np.exp(1j * rate * time_s) / (1 + 1j * turns)
            assert shown(lambda t, rate=rate: np.cos(rate * t), time_s) == pytest.approx(
                answer.real, abs=0.02
            )


def test_a_ramp_is_late_by_the_time_constant() -> None:
    assert shown(lambda t: 20 * t, 0.5) == pytest.approx(20 * (0.5 - TAU_S), abs=1e-5)


def test_a_soft_step_is_answered_as_by_a_first_order_lag() -> None:
    # An edge of width s that enters a pixel: the answer is the exponentially modified Gaussian.
    width = 0.8 * TAU_S
    for time_s in np.linspace(-0.03, 0.08, 23):
        step = 0.5 * erfc(-time_s / width / np.sqrt(2))
        tail = 0.5 * np.exp(width**2 / 2 / TAU_S**2 - time_s / TAU_S)
        answer = step - tail * erfc((width / TAU_S - time_s / width) / np.sqrt(2))
        seen = shown(lambda t: 0.5 * erfc(-t / width / np.sqrt(2)), float(time_s))
        assert seen == pytest.approx(answer, abs=0.03)


def test_without_a_time_constant_the_view_is_seen_at_once() -> None:
    assert lagged_temperature(Follows(lambda t: t), BolometerSettings(), 0.25, 0)[0, 0] == 0.25


@pytest.mark.parametrize(
    "scene",
    [
        {"surface": {"kind": "regular", "case": "T0.791-H2/25"}, "texture": {"lifetime_s": 1e9}},
        {"view": "chessboard", "chessboard": {"shake_m": 0.05, "shake_hz": 3.0}},
    ],
    ids=["water", "moving board"],
)
def test_each_row_is_read_out_at_its_own_time(
    scene: dict[str, Any], small_mounting: Callable[..., Mounting]
) -> None:
    mounting, line_time_s = small_mounting(), 1.5e-4
    rolling = build_view(parse_scene(scene), mounting, line_time_s).temperature(0.3, 0)
    together = build_view(parse_scene(scene), mounting)
    at_once = together.temperature(0.3, 0)
    for row in (10, 64, 120):
        own_time = together.temperature(0.3 + row * line_time_s, 0)[row]
        moved = np.abs(own_time - at_once[row]).mean()
        assert np.abs(rolling[row] - own_time).mean() < (0.02 if row > 60 else 0.2) * moved
