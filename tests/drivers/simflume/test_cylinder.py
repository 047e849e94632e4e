from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from thermacq_drivers.simflume.cylinder import Cylinder, CylinderWave, Pierced
from thermacq_drivers.simflume.diffraction import solve_diffraction
from thermacq_drivers.simflume.regular_wave import RegularWave, solve_wave

CYLINDER = Cylinder(0.3, -0.03, 0.08)
CASES = [
    (0.791, 0.08, 0.08, 1.0),
    (0.632, 0.1, 0.05, 1.0),
    (1.186, 0.0625, 0.2, 1.0),
    (0.791, 0.08, 0.1, None),
]


@cache
def around(
    period_s: float = 0.791, steepness: float = 0.08, radius_m: float = 0.08, width_m: float | None = 1.0
) -> CylinderWave:
    wave = solve_wave(period_s, steepness, 0.9)
    return CylinderWave(wave, Cylinder(0.3, -0.03, radius_m), width_m)


def places(cylinder: Cylinder, count: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Places in the flume around the cylinder and beyond the table."""
    random = np.random.default_rng(1)
    x, y = random.uniform(-0.9, 1.5, count), random.uniform(-0.53, 0.47, count)
    outside = ~cylinder.covers(x, y)
    return x[outside], y[outside]


def summed(water: CylinderWave, width_m: float | None, x: np.ndarray, y: np.ndarray, time_s: float):
    """Elevation and slopes, harmonic by harmonic, from the diffraction itself."""
    wave, cylinder = water.wave, water.cylinder
    total = np.zeros((3, len(x)))
    for order, amplitude in enumerate(wave.elevation_series[1:], start=1):
        solution = solve_diffraction(order * wave.wavenumber_rad_m, cylinder.radius_m, width_m)
        phase = wave.wavenumber_rad_m * cylinder.x_m - 2 * np.pi / wave.period_s * time_s
        fields = np.array(solution.field(x - cylinder.x_m, y - cylinder.y_m))
        total += amplitude * (fields * np.exp(1j * order * phase)).real
    return total


@pytest.mark.parametrize("case", CASES)
def test_the_table_is_the_sum_of_the_diffracted_harmonics(
    case: tuple[float, float, float, float | None],
) -> None:
    water = around(*case)
    x, y = places(water.cylinder)
    expected = summed(water, case[3], x, y, 0.37)
    # Harmonics below 5 micrometres are left out.
    np.testing.assert_allclose(water.elevation(x, y, 0.37), expected[0], atol=1e-5)
    np.testing.assert_allclose(water.slope(x, y, 0.37), expected[1:], atol=1e-3)
    assert np.abs(expected[0]).max() < water.highest_m + 1e-5
    assert np.hypot(*expected[1:]).max() < water.steepest + 1e-3


def test_time_series_and_rows_agree_with_pictures() -> None:
    water = around()
    x, y = places(water.cylinder)
    at_once = water.elevation(x, y, 1.5)
    np.testing.assert_allclose(water.elevation(x, y, np.full(len(x), 1.5)), at_once, atol=1e-9)
    grid = water.elevation(x[None], y[None], np.array([[0.9], [1.5]]))
    np.testing.assert_allclose(grid[1], at_once, atol=1e-9)
    read_s = 1.5 + np.linspace(0, 0.016, len(x))
    np.testing.assert_allclose(
        water.elevation(x, y, read_s)[::100],
        [water.elevation(x[i : i + 1], y[i : i + 1], read_s[i])[0] for i in range(0, len(x), 100)],
        atol=1e-7,
    )


def test_a_thin_pile_leaves_the_nonlinear_wave_as_it_is() -> None:
    wave = solve_wave(0.791, 0.08, 0.9)
    water = CylinderWave(wave, Cylinder(0.3, -0.03, 0.0005))
    x, y = places(water.cylinder)
    time_s = 0.6
    np.testing.assert_allclose(water.elevation(x, y, time_s), wave.elevation(x, y, time_s), atol=2e-5)
    np.testing.assert_allclose(water.velocity(x, y, time_s)[0], wave.velocity(x, y, time_s)[0], atol=1e-3)
    np.testing.assert_allclose(water.label(x, y, time_s)[0], wave.label(x, y, time_s)[0], atol=1e-4)


def test_low_waves_run_up_as_maccamy_and_fuchs_say() -> None:
    # k is that of linear theory; ka = 0.5 and 1 at the wall, as published.
    for ka, published in ((0.5, (1.4316, 0.9783, 0.9951)), (1.0, (1.7071, 1.1713, 0.8882))):
        wave = solve_wave(0.7, 0.002, 0.9)
        radius_m = ka / wave.wavenumber_rad_m
        water = CylinderWave(wave, Cylinder(0.0, 0.0, radius_m), None)
        angle = np.array([np.pi, np.pi / 2, 0])
        x, y = radius_m * np.cos(angle), radius_m * np.sin(angle)
        time_s = np.arange(64)[:, None] / 64 * wave.period_s
        eta = water.elevation(x, y, time_s)
        first = 2 * np.abs(np.fft.fft(eta, axis=0)[1]) / 64
        np.testing.assert_allclose(first / wave.elevation_series[1], published, atol=1e-4)


def test_the_water_is_symmetric_and_does_not_pass_cylinder_or_walls() -> None:
    water = around()
    theta = np.linspace(0, np.pi, 25)
    x, y = 0.3 + 0.08 * np.cos(theta), 0.08 * np.sin(theta)
    for time_s in (0.1, 0.5):
        mirrored = water.elevation(x, -0.03 - y, time_s)
        np.testing.assert_allclose(water.elevation(x, -0.03 + y, time_s), mirrored, atol=1e-12)
        along, across = water.velocity(x, -0.03 + y, time_s)
        # The mean current of the wave alone is not diverted.
        along = along - water.wave.velocity_series[0]
        assert np.abs(along * np.cos(theta) + across * np.sin(theta)).max() < 1e-4
        across = water.velocity(np.linspace(-0.6, 1.2, 40), np.full(40, 0.47), time_s)[1]
        assert np.abs(across).max() < 1e-4


def test_the_velocity_moves_the_label_to_first_order() -> None:
    water = around(0.791, 0.02)
    random = np.random.default_rng(2)
    x, y = random.uniform(-0.1, 0.7, 40), random.uniform(-0.4, 0.35, 40)
    apart = np.hypot(x - 0.3, y + 0.03) > 0.11
    x, y = x[apart], y[apart]
    count = len(x)

    def velocity(time_s: float, place: np.ndarray) -> np.ndarray:
        return np.concatenate(water.velocity(place[:count], place[count:], time_s))

    path = solve_ivp(velocity, (0, 0.791), np.concatenate([x, y]), rtol=1e-7, atol=1e-9)
    begun = np.array(water.label(x, y, 0.0))
    ended = np.array(water.label(path.y[:count, -1], path.y[count:, -1], 0.791))
    halfway = path.y[:, len(path.t) // 2]
    moved = np.hypot(halfway[:count] - x, halfway[count:] - y).max()
    assert np.abs(ended - begun).max() < 0.1 * moved


def test_there_is_no_water_inside_the_cylinder() -> None:
    water = Pierced(around(), CYLINDER, (0.08, 0.0))
    x, y = np.array([0.3, 0.35, 0.3 + 0.08, 0.4]), np.full(4, -0.03)
    expected = [True, True, False, False]
    for values in (
        water.elevation(x, y, 0.2),
        *water.slope(x, y, 0.2),
        *water.velocity(x, y, 0.2),
        *water.label(x, y, 0.2),
    ):
        assert np.isnan(values).tolist() == expected
    assert np.isfinite(water.surface.elevation(x, y, 0.2)).all()
    series = water.elevation(x[:1, None], y[:1, None], np.linspace(0, 1, 5)[None])
    assert np.isnan(series).all()
    assert water.highest_m == water.surface.highest_m


def test_beyond_the_table_the_field_goes_on() -> None:
    water = around()
    x = 0.3 + np.array([0.999999, 1.000001])
    y = np.full(2, -0.03)
    eta = water.elevation(x, y, 0.4)
    assert eta[1] == pytest.approx(eta[0], abs=2e-6)
    assert isinstance(water.wave, RegularWave)
