from __future__ import annotations

import numpy as np
import pytest

from thermacq_drivers.simflume.component_sea import Components, ComponentSea
from thermacq_drivers.simflume.dispersion import group_speed
from thermacq_drivers.simflume.wave_group import (
    bichromatic,
    check_group,
    focus,
    focused_group,
    gaussian_group,
)

DEPTH = 0.9
GROUPS = {
    "bichromatic": bichromatic(0.03, 0.9, 0.1, DEPTH),
    "gaussian": gaussian_group(0.03, 0.9, 0.1, DEPTH),
    "focused": focused_group(0.03, 0.9, DEPTH),
}


@pytest.mark.parametrize("waves", GROUPS.values(), ids=GROUPS)
def test_the_crest_stands_at_the_focus_with_the_amplitude(waves: Components) -> None:
    water = ComponentSea(focus(waves, 0.25, 12.0))
    time_s = np.linspace(10, 14, 2001)
    eta = water.elevation(np.full(2001, 0.25), np.zeros(2001), time_s)
    assert eta.max() == pytest.approx(0.03, rel=1e-6)
    assert time_s[eta.argmax()] == pytest.approx(12.0, abs=0.002)
    assert water.highest_m == pytest.approx(0.03)


def test_the_gaussian_envelope_travels_at_the_group_speed() -> None:
    water = ComponentSea(focus(GROUPS["gaussian"], 0.0, 10.0))
    speed = group_speed(2 * np.pi / 0.9, DEPTH)
    time_s = np.arange(0, 30, 0.01)
    middles = []
    for x_m in (0.0, 2.0):
        eta = water.elevation(np.full(time_s.size, x_m), np.zeros(time_s.size), time_s)
        middles.append((time_s * eta**2).sum() / (eta**2).sum())
    assert middles[1] - middles[0] == pytest.approx(2.0 / speed, rel=0.02)


def test_the_gaussian_envelope_has_its_width() -> None:
    water = ComponentSea(focus(GROUPS["gaussian"], 0.0, 10.0))
    time_s = np.arange(0, 20, 0.01)
    eta = water.elevation(np.zeros(time_s.size), np.zeros(time_s.size), time_s)
    energy = eta**2 / (eta**2).sum()
    # The square of an envelope of standard deviation σ has σ / sqrt 2.
    width = np.sqrt((energy * (time_s - 10) ** 2).sum())
    assert width == pytest.approx(0.9 / (2 * np.pi * 0.1) / np.sqrt(2), rel=0.02)


def test_a_group_that_breaks_at_its_focus_is_refused() -> None:
    check_group(GROUPS["focused"])
    with pytest.raises(ValueError, match=r"too steep: Σ a k = 0\.\d\d at its focus"):
        check_group(focused_group(0.06, 0.9, DEPTH))
