from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_drivers.simflume.radiance import (
    WATER_INDEX,
    WaterSkin,
    apparent_curvature,
    apparent_rise,
    band_radiance,
    fresnel,
    water_reflectance,
)


def test_band_radiance_of_room_temperature_is_the_textbooks() -> None:
    # All wavelengths give σT⁴/π; 8 to 14 µm hold 37.5 % of it at 300 K (tables of the blackbody function).
    total = 5.670374e-8 * 300.0**4 / math.pi
    assert band_radiance(300.0) / total == pytest.approx(0.3754, abs=0.001)


@given(st.floats(1.05, 3.0), st.floats(0.0, 1.0))
def test_reflectance_at_normal_incidence(n: float, k: float) -> None:
    expected = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    s, p = fresnel(1.0, n, k)
    assert s == pytest.approx(expected)
    assert p == pytest.approx(expected)


@given(st.floats(0.0, 1.0), st.floats(1.01, 3.0), st.floats(0.0, 2.0))
def test_reflectance_is_between_nothing_and_all(cosine: float, n: float, k: float) -> None:
    s, p = fresnel(cosine, n, k)
    assert -1e-12 <= p <= s + 1e-12
    assert s <= 1 + 1e-12


def test_brewsters_angle() -> None:
    angle = np.radians(np.linspace(0, 89.9, 9000))
    _, clear = fresnel(np.cos(angle), 1.2, 0.0)
    assert angle[clear.argmin()] == pytest.approx(math.atan(1.2), abs=2e-4)
    assert clear.min() < 1e-8
    _, absorbing = fresnel(np.cos(angle), 1.2, 0.1)
    assert absorbing.min() > 1e-4
    assert angle[absorbing.argmin()] == pytest.approx(math.atan(1.2), abs=0.05)


def test_grazing_light_is_all_reflected() -> None:
    assert water_reflectance(0.0) == pytest.approx(1.0)


def test_water_reflects_as_measured() -> None:
    # Between the extremes that the index gives within the band.
    at_each = np.array([fresnel(1.0, n, k)[0] for _, n, k in WATER_INDEX])
    normal = float(water_reflectance(1.0))
    assert at_each.min() < normal < at_each.max()
    assert 0.012 < normal < 0.018
    assert 0.045 < float(water_reflectance(0.5)) < 0.06
    steeper = water_reflectance(np.linspace(1.0, 0.0, 200))
    assert np.all(np.diff(steeper) > 0)


@pytest.mark.parametrize("emissivity", [0.9, 0.95, 0.985])
def test_emissivity_falls_with_the_angle_as_fresnels(emissivity: float) -> None:
    skin = WaterSkin(emissivity)
    cosine = np.cos(np.radians([0.0, 20.0, 45.0, 60.0, 80.0]))
    found = skin.emissivity(cosine)
    assert found[0] == pytest.approx(emissivity)
    expected = (1 - water_reflectance(cosine)) / (1 - water_reflectance(1.0))
    np.testing.assert_allclose(found / emissivity, expected, atol=1e-5)


def test_apparent_temperature_is_linear_in_radiance() -> None:
    hot, cold = band_radiance(320.0), band_radiance(290.0)
    between = apparent_rise([290.0, 320.0], 295.0)
    slope = (hot - cold) / (between[1] - between[0])
    assert slope == pytest.approx((band_radiance(295.01) - band_radiance(294.99)) / 0.02, rel=1e-6)
    assert apparent_rise(295.0, 295.0) == pytest.approx(0.0, abs=1e-12)
    warmer = np.linspace(-3, 3, 13)
    curve = warmer + apparent_curvature(295.0) * warmer**2
    np.testing.assert_allclose(curve, apparent_rise(295.0 + warmer, 295.0), atol=2e-4)
