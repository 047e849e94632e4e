from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_drivers.simflume.cases import TABLE_II
from thermacq_drivers.simflume.dispersion import breaking_height, frequency, group_speed, wavenumber
from thermacq_drivers.simflume.regular_wave import solve_wave


@given(omega=st.floats(1e-3, 1e3), depth_m=st.floats(0.01, 100))
def test_the_wavenumber_satisfies_the_dispersion_relation(omega: float, depth_m: float) -> None:
    k = float(wavenumber(omega, depth_m))
    assert 9.81 * k * math.tanh(k * depth_m) == pytest.approx(omega**2, rel=1e-12)
    assert frequency(k, depth_m) == pytest.approx(omega, rel=1e-12)


def test_limits_of_deep_and_shallow_water() -> None:
    assert wavenumber(np.array([8.0]), 50.0)[0] == pytest.approx(64 / 9.81)
    assert 2 * math.pi / float(wavenumber(0.01, 0.9)) == pytest.approx(
        2 * math.pi / 0.01 * math.sqrt(9.81 * 0.9), rel=1e-4
    )
    assert group_speed(8.0, 50.0) == pytest.approx(9.81 / 16)
    assert group_speed(0.01, 0.9) == pytest.approx(math.sqrt(9.81 * 0.9), rel=1e-4)


@given(omega=st.floats(0.1, 20), depth_m=st.floats(0.1, 5))
def test_the_group_speed_is_the_derivative_of_frequency(omega: float, depth_m: float) -> None:
    step = 1e-5
    k = wavenumber(np.array([omega * (1 - step), omega * (1 + step)]), depth_m)
    assert group_speed(omega, depth_m) == pytest.approx(2 * omega * step / (k[1] - k[0]), rel=1e-6)


def test_low_waves_are_linear() -> None:
    wave = solve_wave(0.8, 0.001, 0.9)
    assert wave.wavenumber_rad_m == pytest.approx(float(wavenumber(2 * math.pi / 0.8, 0.9)), rel=1e-4)


def test_no_wave_of_table_ii_breaks() -> None:
    assert all(case.paper_height_m < breaking_height(case.period_s, 0.9) for case in TABLE_II.values())
    assert breaking_height(0.8, 0.9) == pytest.approx(0.142, rel=0.01)
