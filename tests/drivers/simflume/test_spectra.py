from __future__ import annotations

import numpy as np
import pytest

from thermacq_drivers.simflume.spectra import (
    check_sea,
    draw_components,
    jonswap,
    pierson_moskowitz,
    spread_directions,
    white,
)

FREQUENCY = np.linspace(0.3, 20, 200_001)


def test_pierson_moskowitz_has_its_energy_and_its_peak() -> None:
    # ∫ (fp/f)^5 exp(-1.25 (fp/f)^4) df = fp / 5.
    shape = pierson_moskowitz(FREQUENCY, 1.25)
    assert np.trapezoid(shape, FREQUENCY) == pytest.approx(1.25 / 5, rel=1e-4)
    assert FREQUENCY[shape.argmax()] == pytest.approx(1.25, abs=2e-4)


def test_jonswap_is_enhanced_at_the_peak_only() -> None:
    ratio = jonswap(FREQUENCY, 1.1, 3.3) / pierson_moskowitz(FREQUENCY, 1.1)
    assert FREQUENCY[ratio.argmax()] == pytest.approx(1.1, abs=2e-4)
    assert ratio.max() == pytest.approx(3.3, rel=1e-5)
    assert ratio[-1] == pytest.approx(1.0)
    np.testing.assert_allclose(jonswap(FREQUENCY, 1.1, 1.0), pierson_moskowitz(FREQUENCY, 1.1))


def test_each_part_of_the_band_has_its_energy() -> None:
    sea = draw_components(lambda f: jonswap(f, 1.1), (0.55, 3.3), 0.04, 240, 0.9, 7)
    assert sea.significant_wave_height_m == pytest.approx(0.04, rel=1e-12)
    band = FREQUENCY[(FREQUENCY > 0.55) & (FREQUENCY < 3.3)]
    energy = np.cumsum(jonswap(band, 1.1))
    energy *= (0.04 / 4) ** 2 / energy[-1]
    frequency = sea.omega_rad_s / (2 * np.pi)
    for edge in (0.9, 1.1, 1.3, 2.0):
        below = (sea.amplitude_m[frequency < edge] ** 2).sum() / 2
        assert below == pytest.approx(np.interp(edge, band, energy), abs=0.02 * energy[-1])


def test_random_amplitudes_have_the_energy_on_average() -> None:
    seas = [draw_components(white, (0.5, 2.0), 0.05, 100, 0.9, seed, True) for seed in range(200)]
    energy = [(sea.amplitude_m**2).sum() / 2 for sea in seas]
    assert np.mean(energy) == pytest.approx((0.05 / 4) ** 2, rel=0.03)
    # 100 exponential variables of equal mean: their sum scatters by a tenth.
    assert np.std(energy) / np.mean(energy) == pytest.approx(0.1, rel=0.2)


def test_the_seed_fixes_the_sea() -> None:
    one, same, other = (draw_components(white, (0.5, 2.0), 0.05, 50, 0.9, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.phase_rad, same.phase_rad)
    np.testing.assert_array_equal(one.omega_rad_s, same.omega_rad_s)
    assert np.abs(one.phase_rad - other.phase_rad).max() > 1


@pytest.mark.parametrize("exponent", [2.0, 10.0, 75.0])
def test_directions_are_spread_as_cos_2s(exponent: float) -> None:
    drawn = spread_directions((np.arange(4001) + 0.5) / 4001, exponent)
    theta = np.linspace(-np.pi, np.pi, 20_001)
    density = np.cos(theta / 2) ** (2 * exponent)
    density /= density.sum()
    assert np.mean(np.cos(drawn)) == pytest.approx(exponent / (exponent + 1), rel=1e-3)
    assert np.mean(drawn**2) == pytest.approx((density * theta**2).sum(), rel=5e-3)
    sea = draw_components(white, (0.5, 2.0), 0.05, 200, 0.9, 1, spreading=exponent)
    np.testing.assert_allclose(
        np.sort(np.arctan2(sea.across_rad_m, sea.along_rad_m)),
        spread_directions((np.arange(200) + 0.5) / 200, exponent),
        atol=1e-12,
    )


def test_a_sea_that_breaks_all_over_is_refused() -> None:
    check_sea(0.08, 0.9, 0.9)
    with pytest.raises(ValueError, match=r"sea of Hm0 = 0\.1 m is too high.*0\.9 s.*break above 0\.084 m"):
        check_sea(0.1, 0.9, 0.9)
