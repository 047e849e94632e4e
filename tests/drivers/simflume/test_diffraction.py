from __future__ import annotations

import numpy as np
import pytest
from scipy.special import hankel1

from thermacq_drivers.simflume.diffraction import Diffraction, solve_diffraction

FLUMES = [(6.0, 0.1), (6.43, 0.1), (12.9, 0.05), (6.43, 0.2), (2.9, 0.15), (30.0, 0.1)]


def test_on_the_wall_the_series_is_that_of_the_wronskian() -> None:
    from scipy.special import h1vp

    ka, theta, orders = 1.7, np.linspace(0, np.pi, 7), np.arange(-30, 31)
    terms = 2j / (np.pi * ka * h1vp(orders, ka)) * 1j**orders
    expected = np.exp(1j * np.outer(theta, orders)) @ terms
    found = solve_diffraction(ka, 1.0).field(np.cos(theta), np.sin(theta))[0]
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("width_m", [None, 1.0])
def test_no_water_passes_the_cylinder(width_m: float | None) -> None:
    solution = solve_diffraction(6.43, 0.15, width_m)
    theta = np.linspace(-np.pi, np.pi, 41)
    _, along, across = solution.field(0.15 * np.cos(theta), 0.15 * np.sin(theta))
    assert np.abs(along * np.cos(theta) + across * np.sin(theta)).max() < 1e-10 * 6.43


@pytest.mark.parametrize(("k", "radius_m"), FLUMES)
def test_no_water_passes_the_walls_of_the_flume(k: float, radius_m: float) -> None:
    x = np.concatenate([np.linspace(-2, -0.01, 30), np.linspace(0.01, 2, 30)])
    for y_m in (-0.5, 0.5):
        across = solve_diffraction(k, radius_m, 1.0).field(x, np.full(60, y_m))[2]
        assert np.abs(across).max() < 1e-8 * k


@pytest.mark.parametrize(("k", "radius_m"), FLUMES)
def test_the_two_forms_of_the_field_agree_where_both_hold(k: float, radius_m: float) -> None:
    solution = solve_diffraction(k, radius_m, 1.0)
    y = np.linspace(-0.5, 0.5, 21)
    for x_m in (-0.36, 0.36):
        x = np.full(21, x_m)
        near = solution.near(np.hypot(x, y), np.arctan2(y, x))
        far = solution.far(x, y)
        np.testing.assert_allclose(near, far, atol=1e-7 * k)


@pytest.mark.parametrize(("k", "radius_m"), FLUMES)
def test_energy_is_neither_lost_nor_made(k: float, radius_m: float) -> None:
    # Flux of energy along the flume, Im ∫ F* dF/dx dy, is the same before and behind the cylinder.
    solution = solve_diffraction(k, radius_m, 1.0)
    y = (np.arange(400) + 0.5) / 400 - 0.5
    flux = []
    for x_m in (-1.5, -0.4, 0.4, 1.5):
        value, along, _ = solution.field(np.full(400, x_m), y)
        flux.append((value.conj() * along).imag.mean() / k)
    np.testing.assert_allclose(flux, flux[0], atol=1e-7)
    assert 0 < flux[0] < 1


def test_images_are_those_of_a_row_of_cylinders() -> None:
    # The sum over the images as it stands, damped a little so that it converges, twice to take the damping out.
    solution = solve_diffraction(5.2, 0.12, 1.0)
    orders = np.arange(len(solution.scattered)) - len(solution.scattered) // 2
    x, y = 0.31, 0.17

    def row(damping: float) -> complex:
        place = np.arange(-60_000, 60_001)
        radius, angle = np.hypot(x, y - place), np.arctan2(y - place, x)
        z = 5.2 * radius * (1 + 1j * damping)
        each = (
            s * (hankel1(n, z) * np.exp(1j * n * angle)).sum()
            for n, s in zip(orders, solution.scattered, strict=True)
            if abs(s) > 1e-12
        )
        return complex(sum(each))

    expected = np.exp(5.2j * x) + 2 * row(1e-4) - row(2e-4)
    found = solution.field(np.array([x]), np.array([y]))[0][0]
    assert found == pytest.approx(expected, abs=1e-6)


def test_a_wide_flume_is_nearly_open_water() -> None:
    theta = np.linspace(0, np.pi, 13)
    place = 0.1 * np.cos(theta), 0.1 * np.sin(theta)
    open_water = solve_diffraction(9.0, 0.1).field(*place)[0]
    differences = [
        np.abs(solve_diffraction(9.0, 0.1, width_m).field(*place)[0] - open_water).max()
        for width_m in (1.1, 11.3, 101.7)
    ]
    # Waves from the images fall as 1 / sqrt(W).
    assert differences[2] < differences[1] < differences[0]
    assert differences[2] < 0.05


@pytest.mark.parametrize("width_m", [None, 1.0])
def test_a_thin_pile_disturbs_nothing(width_m: float | None) -> None:
    x, y = np.linspace(-0.8, 0.8, 9), np.full(9, 0.2)
    field = solve_diffraction(6.5, 0.0005, width_m).field(x, y)[0]
    np.testing.assert_allclose(field, np.exp(6.5j * x), atol=1e-4)


def test_a_cylinder_wider_than_the_flume_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1\.2 m does not fit into a flume 1 m wide"):
        solve_diffraction(6.0, 0.6, 1.0)


def test_a_wave_across_the_flume_is_refused() -> None:
    with pytest.raises(ValueError, match="resonance with the width"):
        solve_diffraction(2 * np.pi, 0.1, 1.0)
    nearly = solve_diffraction(2 * np.pi + 1e-4, 0.1, 1.0)
    assert isinstance(nearly, Diffraction)
    assert np.isfinite(nearly.field(np.array([-0.1, 0.7]), np.zeros(2))[0]).all()
