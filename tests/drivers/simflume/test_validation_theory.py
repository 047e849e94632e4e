from __future__ import annotations

import dataclasses

import pytest

from thermacq_drivers.simflume.cases import TABLE_II
from thermacq_drivers.simflume.validation_theory import (
    case_wave,
    field_checks,
    profile_check,
    theory_checks,
    tracked_drift,
)
from thermacq_drivers.simflume.validation_water import failed


@pytest.mark.slow
def test_waves_agree_with_second_sources() -> None:
    checks = theory_checks()
    assert len(checks) == 15 + 15 + 15
    assert failed(checks) == []


def test_the_demo_wave_and_the_field_of_a_cylinder_agree() -> None:
    assert failed([profile_check(TABLE_II["T0.791-H2/25"]), *field_checks()]) == []


def test_a_particle_without_mean_velocity_would_be_noticed() -> None:
    wave = case_wave(TABLE_II["T0.791-H1/16"])
    series = (wave.velocity_series[0] - 0.01, *wave.velocity_series[1:])
    slower = dataclasses.replace(wave, velocity_series=series)
    assert abs(tracked_drift(slower) - wave.drift_m_s) > 0.005
    assert tracked_drift(wave) == pytest.approx(wave.drift_m_s, abs=1e-6)
