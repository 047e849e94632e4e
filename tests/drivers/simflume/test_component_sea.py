from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from thermacq_drivers.simflume.component_sea import Components, ComponentSea
from thermacq_drivers.simflume.spectra import draw_components, jonswap

DEPTH = 0.9
HERE = np.zeros(1)


@cache
def sea(spreading: float | None = None, height_m: float = 0.04) -> ComponentSea:
    waves = draw_components(
        lambda f: jonswap(f, 1 / 0.9), (0.55, 3.3), height_m, 200, DEPTH, 5, spreading=spreading
    )
    return ComponentSea(waves, random_phases=True)


def summed(waves: Components, x: np.ndarray, y: np.ndarray, time_s: float) -> np.ndarray:
    """Elevation, slope along x and across, by the sum as it stands in the book."""
    phase = np.multiply.outer(x, waves.along_rad_m) + np.multiply.outer(y, waves.across_rad_m)
    phase += waves.phase_rad - waves.omega_rad_s * time_s
    return np.array(
        [
            np.cos(phase) @ waves.amplitude_m,
            -np.sin(phase) @ (waves.amplitude_m * waves.along_rad_m),
            -np.sin(phase) @ (waves.amplitude_m * waves.across_rad_m),
        ]
    )


def points(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.uniform(-0.15, 0.6, count), random.uniform(-0.3, 0.3, count)


@pytest.mark.parametrize("spreading", [None, 12.0])
def test_the_table_is_the_sum_to_a_micrometre(spreading: float | None) -> None:
    water = sea(spreading)
    x, y = points(3000)
    for time_s in (0.0, 3.21, 600.0):
        expected = summed(water.components, x, y, time_s)
        np.testing.assert_allclose(water.elevation(x, y, time_s), expected[0], atol=1e-6)
        np.testing.assert_allclose(water.slope(x, y, time_s), expected[1:], atol=1e-4)


@pytest.mark.parametrize("spreading", [None, 12.0])
def test_the_same_at_few_points_in_time_series_and_row_by_row(spreading: float | None) -> None:
    water = sea(spreading)
    x, y = points(2000)
    at_once = water.elevation(x, y, 1.5)
    np.testing.assert_allclose(water.elevation(x[:5], y[:5], 1.5), at_once[:5], atol=1e-6)
    time_s = np.linspace(0, 3, 7)
    series = water.elevation(np.full(7, x[0]), np.full(7, y[0]), time_s)
    one_by_one = [water.elevation(x[:1], y[:1], float(time))[0] for time in time_s]
    np.testing.assert_allclose(series, one_by_one, atol=1e-12)
    read_s = 1.5 + np.linspace(0, 0.016, 2000)
    rows = water.elevation(x, y, read_s)
    direct = [summed(water.components, x[i], y[i], read_s[i])[0] for i in range(0, 2000, 100)]
    np.testing.assert_allclose(rows[::100], direct, atol=1e-6)


def test_hm0_of_a_long_record_is_that_of_the_spectrum() -> None:
    water = sea()
    time_s = np.arange(0, 1800, 0.1)
    eta = water.elevation(np.full(time_s.size, 0.2), np.zeros(time_s.size), time_s)
    assert 4 * eta.std() == pytest.approx(0.04, rel=0.01)
    assert np.abs(eta).max() < water.highest_m


@pytest.mark.parametrize("spreading", [None, 12.0])
def test_a_particle_keeps_its_label(spreading: float | None) -> None:
    water = sea(spreading)
    x, y = points(6, 3)

    def velocity(time_s: float, place: np.ndarray) -> np.ndarray:
        return np.concatenate(water.velocity(place[:6], place[6:], time_s))

    path = solve_ivp(velocity, (0.0, 4.0), np.concatenate([x, y]), rtol=1e-9, atol=1e-10)
    begun = water.label(x, y, 0.0)
    ended = water.label(path.y[:6, -1], path.y[6:, -1], 4.0)
    np.testing.assert_allclose(ended, begun, atol=2e-7)


def test_the_label_follows_linear_theory_at_the_moving_surface() -> None:
    # Particles driven by u(z = 0) + eta du/dz, which is right to second order: in 5 s they move 0.2 m to and fro
    # and drift by some centimetres; the label loses them by the drift's variation within groups.
    water = sea()
    waves = water.components
    k = waves.along_rad_m
    speed = waves.amplitude_m * waves.omega_rad_s / np.tanh(k * DEPTH)

    def velocity(time_s: float, x: np.ndarray) -> np.ndarray:
        phase = np.outer(x, k) + waves.phase_rad - waves.omega_rad_s * time_s
        growth = waves.amplitude_m * waves.omega_rad_s * k
        return np.cos(phase) @ speed + (np.cos(phase) @ waves.amplitude_m) * (np.cos(phase) @ growth)

    start = np.linspace(-0.1, 0.5, 13)
    zero = np.zeros(13)
    path = solve_ivp(velocity, (0.0, 5.0), start, rtol=1e-8, atol=1e-9)
    lost = water.label(path.y[:, -1], zero, 5.0)[0] - water.label(start, zero, 0.0)[0]
    assert np.abs(lost).max() < 0.025
    moved = path.y[:, -1] - start
    assert np.abs(lost).max() < 0.5 * np.abs(moved).max()


def test_one_component_drifts_as_stokes_says() -> None:
    k = 5.0
    wave = Components(
        np.array([0.01]), np.array([np.sqrt(9.81 * k)]), np.array([k]), HERE, HERE, depth_m=50.0
    )
    water = ComponentSea(wave)
    assert water.drift_m_s[0] == pytest.approx(0.01**2 * k * np.sqrt(9.81 * k))
    assert (water.highest_m, water.steepest) == (pytest.approx(0.01), pytest.approx(0.05))
    # Seen by the particle: back at the same place of the orbit after a Lagrangian period.
    period_s = 2 * np.pi / (np.sqrt(9.81 * k) - k * water.drift_m_s[0])
    path = solve_ivp(lambda t, x: water.velocity(x, HERE, t)[0], (0, period_s), [0.3], rtol=1e-10, atol=1e-12)
    assert path.y[0, -1] - 0.3 == pytest.approx(water.drift_m_s[0] * period_s, rel=1e-6)


def test_waves_sent_back_have_an_antinode_at_the_wall() -> None:
    waves = sea().components
    x = np.linspace(7.9, 8.1, 5)
    both = summed(waves, x, 0 * x, 2.0) + summed(waves.reflected(1.0, 8.0), x, 0 * x, 2.0)
    assert abs(both[1, 2]) < 1e-12
    np.testing.assert_allclose(both[0], both[0, ::-1], atol=1e-12)


def test_the_surface_is_the_same_each_time_and_in_any_order() -> None:
    x, y = points(2000)
    one, other = (ComponentSea(sea(12.0).components) for _ in range(2))
    other.elevation(x + 3, y, 7.0)
    other.slope(x, y, 2.0)
    np.testing.assert_array_equal(one.elevation(x, y, 2.0), other.elevation(x, y, 2.0))
