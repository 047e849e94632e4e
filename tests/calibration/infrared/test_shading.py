"""Shading as a low-order surface that grows with the temperature of the camera."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dctn, idctn

from thermacq_calibration import CalibrationError, make_correction, uniformity, with_shading
from thermacq_calibration.infrared.shading import low_order_surface


def corrected(camera):
    views = [camera.view(292.0), camera.view(298.0)]
    return make_correction(views, serial="SIM-1", camera="left")


def fall_off() -> np.ndarray:
    """What cos^4 takes away in the paper's cameras, on a coarse picture."""
    rows, columns = np.linspace(-256, 256, 48)[:, None], np.linspace(-320, 320, 64)
    return (1 - (1 + (rows**2 + columns**2) / 705.9**2) ** -2).astype(np.float32)


def test_polynomials_up_to_degree_four_are_found_exactly():
    v, u = np.meshgrid(np.linspace(-1, 1, 48), np.linspace(-1, 1, 64), indexing="ij")
    surface = (1 + 2 * u - v * u + 3 * u**2 * v**2 - v**4 + u**3).astype(np.float32)
    np.testing.assert_allclose(low_order_surface(surface), surface, atol=1e-4)
    beyond = (u**3 * v**3).astype(np.float32)
    assert np.abs(low_order_surface(beyond) - beyond).max() > 0.1


def test_polynomials_fit_the_fall_off_of_light_better_than_cosines():
    pattern = fall_off()
    terms = dctn(pattern, norm="ortho")
    terms[6:], terms[:, 6:] = 0, 0
    cosines = np.ptp(pattern - idctn(terms, norm="ortho"))
    polynomials = np.ptp(pattern - low_order_surface(pattern))
    assert polynomials < 0.03 * np.ptp(pattern)
    assert polynomials < 0.25 * cosines


def test_shading_scales_with_the_temperature_of_the_camera(camera):
    correction = corrected(camera)
    pattern = fall_off() * 100
    camera.shading = 2 * pattern
    shaded = with_shading(correction, camera.view(295.0, inside_k=307.0))
    camera.shading = 3 * pattern
    held_out = camera.view(294.0, inside_k=308.0)
    assert uniformity(correction, held_out).large_scale_counts > 60
    assert uniformity(shaded, held_out).large_scale_counts < 4
    assert shaded.shading is not None
    assert shaded.shading.mean() == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("inside_k", [305.2, None])
def test_shading_is_constant_where_its_growth_cannot_be_told(camera, inside_k):
    correction = corrected(camera)
    camera.shading = fall_off() * 100
    shaded = with_shading(correction, camera.view(295.0, inside_k=inside_k))
    assert shaded.shading_zero_k is None
    assert uniformity(shaded, camera.view(294.0, inside_k=320.0)).large_scale_counts < 3


def test_another_fit_takes_the_place_of_the_first(camera):
    correction = corrected(camera)
    camera.shading = fall_off() * 100
    once = with_shading(correction, camera.view(295.0))
    twice = with_shading(once, camera.view(295.0))
    np.testing.assert_allclose(once.shading, twice.shading, atol=1.5)


def test_fine_texture_is_left_alone(camera):
    correction = corrected(camera)
    camera.offset += 5 * np.sign(np.sin(1.3 * np.arange(64)))
    shaded = with_shading(correction, camera.view(295.0))
    assert np.ptp(shaded.shading) < 4


def test_a_tiny_picture_is_refused():
    with pytest.raises(CalibrationError, match="so few pixels"):
        low_order_surface(np.zeros((8, 64), np.float32))
