from __future__ import annotations

import math

import numpy as np
import pytest
import raschii
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from thermacq_drivers.simflume.cases import TABLE_II
from thermacq_drivers.simflume.regular_wave import ORDER, RegularWave, solve_wave
from thermacq_drivers.simflume.surfaces import StillWater

DEPTH = 0.9
HERE = np.zeros(1)


def case_wave(name: str) -> RegularWave:
    case = TABLE_II[name]
    return solve_wave(case.period_s, case.steepness, DEPTH)


def test_table_ii_has_all_15_cases() -> None:
    assert len(TABLE_II) == 15
    assert TABLE_II["T0.791-H2/25"].paper_height_m == pytest.approx(0.0822)
    assert TABLE_II["T1.186-H1/16"].steepness == 0.0625


@pytest.mark.parametrize("name", TABLE_II)
def test_every_case_has_the_period_steepness_and_height_of_table_ii(name: str) -> None:
    case, wave = TABLE_II[name], case_wave(name)
    assert wave.period_s == pytest.approx(case.period_s, rel=1e-9)
    assert wave.height_m / wave.length_m == pytest.approx(case.steepness, rel=1e-6)
    assert wave.height_m == pytest.approx(case.paper_height_m, rel=0.02)


@pytest.mark.parametrize("name", ["T0.553-H1/10", "T0.791-H2/25", "T1.186-H1/16"])
def test_elevation_slope_and_velocity_agree_with_raschii(name: str) -> None:
    wave = case_wave(name)
    steepness = TABLE_II[name].steepness
    oracle = raschii.FentonWave(height=steepness * wave.length_m, depth=DEPTH, length=wave.length_m, N=ORDER)
    x = np.linspace(-1, 2, 301)
    for time_s in (0.0, 0.37, 12.3):
        eta = wave.elevation(x, HERE, time_s)
        expected = np.ravel(oracle.surface_elevation(x, time_s, include_depth=False))
        np.testing.assert_allclose(eta, expected, atol=1e-10)
        np.testing.assert_allclose(
            wave.slope(x, HERE, time_s)[0], np.ravel(oracle.surface_slope(x, time_s)), atol=1e-9
        )
        at_surface = oracle.velocity(x, DEPTH + eta, time_s, all_points_wet=True)
        np.testing.assert_allclose(wave.velocity(x, HERE, time_s)[0], at_surface[:, 0], atol=1e-9)


def test_the_mean_elevation_is_zero_and_the_crest_stands_at_the_origin() -> None:
    wave = case_wave("T0.791-H1/10")
    x = np.arange(4000) / 4000 * wave.length_m
    eta = wave.elevation(x, HERE, 0.0)
    assert abs(eta.mean()) < 1e-12
    assert eta.argmax() == 0
    assert eta[0] == pytest.approx(wave.highest_m)
    assert np.abs(wave.slope(x, HERE, 0.0)[0]).max() == pytest.approx(wave.steepest, rel=1e-4)


def test_phase_moves_the_crest() -> None:
    shifted = solve_wave(0.791, 0.08, DEPTH, phase_rad=math.pi)
    plain = solve_wave(0.791, 0.08, DEPTH)
    x = np.linspace(0, 1, 50)
    np.testing.assert_allclose(
        shifted.elevation(x, HERE, 0.2), plain.elevation(x + plain.length_m / 2, HERE, 0.2), atol=1e-12
    )


@pytest.mark.parametrize("name", ["T0.553-H1/10", "T0.791-H2/25"])
def test_a_particle_keeps_its_label(name: str) -> None:
    wave = case_wave(name)
    start = np.array([-0.2, 0.1, 0.33])

    def velocity(time_s: float, x: np.ndarray) -> np.ndarray:
        return wave.velocity(x, HERE, time_s)[0]

    path = solve_ivp(velocity, (0.0, 5 * wave.period_s), start, rtol=1e-10, atol=1e-12, dense_output=True)
    begun = wave.label(start, HERE, 0.0)[0]
    for time_s in np.linspace(0, 5 * wave.period_s, 11):
        label = wave.label(path.sol(time_s), HERE, time_s)[0]
        np.testing.assert_allclose(label, begun, atol=1e-7)


def test_particles_drift_with_the_lagrangian_mean() -> None:
    # Seen from a particle, a wave passes in the Lagrangian period λ / (c - U).
    wave = case_wave("T0.791-H1/10")
    period_s = wave.length_m / (wave.celerity_m_s - wave.drift_m_s)
    path = solve_ivp(
        lambda time_s, x: wave.velocity(x, HERE, time_s)[0], (0, 3 * period_s), [0.1], rtol=1e-10, atol=1e-12
    )
    assert path.y[0, -1] - 0.1 == pytest.approx(3 * period_s * wave.drift_m_s, rel=1e-6)


def test_small_waves_drift_as_stokes_says() -> None:
    wave = solve_wave(0.6, 0.004, DEPTH)
    steepness = wave.wavenumber_rad_m * wave.height_m / 2
    assert wave.drift_m_s == pytest.approx(steepness**2 * wave.celerity_m_s, rel=1e-3)


def test_there_is_no_mean_current_below_the_troughs() -> None:
    # The convention: c = B0 of Rienecker and Fenton, so the mean Eulerian velocity is zero.
    wave = case_wave("T0.791-H2/25")
    oracle = raschii.FentonWave(height=wave.height_m, depth=DEPTH, length=wave.length_m, N=ORDER)
    x = np.arange(256) / 256 * wave.length_m
    below = oracle.velocity(x, np.full(256, DEPTH - 0.06), 0.0, all_points_wet=True)
    assert abs(below[:, 0].mean()) < 1e-12
    assert oracle.data["B"][0] == pytest.approx(oracle.c)


@given(x_m=st.floats(-50, 50), time_s=st.floats(-10, 1000), name=st.sampled_from(sorted(TABLE_II)))
def test_label_is_monotonic_and_moves_with_the_wave(x_m: float, time_s: float, name: str) -> None:
    wave = case_wave(name)
    x = x_m + np.array([0.0, 1e-4])
    labels = wave.label(x, HERE, time_s)[0]
    assert labels[1] > labels[0]
    # One period later and one wavelength on, the label has grown by what the drift left behind.
    later = wave.label(x + wave.length_m, HERE, time_s + wave.period_s)[0]
    grown = wave.length_m - wave.drift_m_s * wave.period_s
    np.testing.assert_allclose(later - labels, grown, atol=1e-9)


@given(x_m=st.floats(-5, 5), time_s=st.floats(0, 100))
def test_slope_is_the_derivative_of_elevation(x_m: float, time_s: float) -> None:
    wave = case_wave("T0.712-H1/10")
    step = 1e-6
    ends = wave.elevation(np.array([x_m - step, x_m + step]), HERE, time_s)
    assert wave.slope(np.array([x_m]), HERE, time_s)[0][0] == pytest.approx(
        (ends[1] - ends[0]) / (2 * step), abs=1e-6
    )


@pytest.mark.parametrize(("period_s", "steepness"), [(0.8, 0.2), (0.8, 0.13), (3.0, 0.12)])
def test_a_breaking_wave_is_refused(period_s: float, steepness: float) -> None:
    with pytest.raises(ValueError, match="too high"):
        solve_wave(period_s, steepness, DEPTH)


def test_still_water_is_still() -> None:
    water = StillWater()
    x, y = np.linspace(0, 1, 5), np.linspace(-1, 0, 5)
    assert not water.elevation(x, y, 3.0).any()
    assert not water.slope(x, y, 3.0)[0].any()
    assert not water.velocity(x, y, 3.0)[1].any()
    np.testing.assert_array_equal(water.label(x, y, 3.0), (x, y))
