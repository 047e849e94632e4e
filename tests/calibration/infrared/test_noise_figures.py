"""SiTF, NETD, spectra and uniformity against formulas."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from thermacq_calibration import CalibrationError
from thermacq_calibration.infrared.noise import noise_3d
from thermacq_calibration.infrared.noise_figures import (
    Sitf,
    fit_sitf,
    likeness_of_neighbours,
    line_spectrum,
    netd,
    netd_from_differences,
    residual_non_uniformity,
)


def test_the_slope_and_its_error_are_those_of_the_straight_line() -> None:
    t = [285.0, 290.0, 295.0, 300.0]
    random = np.random.default_rng(0)
    found = [fit_sitf(t, 100 * np.array(t) + random.normal(0, 20, 4)) for _ in range(2000)]
    slopes = np.array([each.counts_per_kelvin for each in found])
    true_error = 20 / np.sqrt(np.sum((np.array(t) - np.mean(t)) ** 2))
    assert slopes.mean() == pytest.approx(100, abs=4 * true_error / np.sqrt(2000))
    assert slopes.std() == pytest.approx(true_error, rel=0.06)
    assert np.sqrt(np.mean([each.standard_error**2 for each in found])) == pytest.approx(true_error, rel=0.06)


def test_curvature_shows_as_a_residual() -> None:
    found = fit_sitf([290, 295, 300], [0.0, 500 - 3.0, 1000])
    assert found.counts_per_kelvin == pytest.approx(100)
    assert found.largest_residual_counts == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("temperatures", "levels", "message"),
    [
        ([290, 295], [1, 2], "3 different temperatures"),
        ([290, 290, 295], [1, 2, 3], "3 different temperatures"),
        ([290, 290.1, 290.2], [1, 2, 3], "span only 0.2 K"),
        ([290, 295, 300], [3, 2, 1], "do not rise"),
        ([290, 295, 300], [1, 2], "one mean level"),
        ([290, 295, np.nan], [1, 2, 3], "finite"),
    ],
)
def test_what_gives_no_slope_is_refused(temperatures, levels, message) -> None:
    with pytest.raises(CalibrationError, match=message):
        fit_sitf(temperatures, levels)


def test_figures_in_kelvin_carry_both_errors() -> None:
    random = np.random.default_rng(2)
    values = 6000 + random.normal(0, 3.5, (64, 60, 80)) + random.normal(0, 5.0, (60, 80))
    noise = noise_3d(values)
    exact = netd(noise, Sitf(100.0))
    assert exact.value == pytest.approx(0.035, rel=0.01)
    assert exact.standard_error == pytest.approx(0.035 / np.sqrt(2 * 63 * 59 * 79), rel=0.02)
    assert netd(noise, Sitf(100.0, 5.0)).standard_error == pytest.approx(0.05 * 0.035, rel=0.02)
    assert netd_from_differences(noise, Sitf(100.0)).value == pytest.approx(exact.value, rel=0.01)
    assert residual_non_uniformity(noise, Sitf(100.0)).value == pytest.approx(0.05, rel=0.03)


def test_a_spectrum_keeps_the_variance_and_finds_stripes() -> None:
    random = np.random.default_rng(3)
    picture = random.normal(0, 2.0, (400, 128))
    frequency, density = line_spectrum(picture, axis=1)
    assert density.sum() * (frequency[1] - frequency[0]) == pytest.approx(4.0, rel=0.03)
    assert np.median(density) == pytest.approx(8.0, rel=0.1)
    striped = picture + 5 * np.cos(2 * np.pi * 0.25 * np.arange(128))
    frequency, density = line_spectrum(striped, axis=1)
    assert frequency[np.argmax(density)] == pytest.approx(0.25)
    _, along_columns = line_spectrum(striped, axis=0)
    assert np.median(along_columns) == pytest.approx(8.0, rel=0.1)


def test_neighbours_are_alike_in_a_scene_and_not_in_the_pattern_of_a_sensor() -> None:
    random = np.random.default_rng(4)
    pattern = random.normal(0, 50, (256, 320)) + random.normal(0, 80, 320) + random.normal(0, 80, (256, 1))
    pattern += np.linspace(0, 400, 320)
    assert abs(likeness_of_neighbours(pattern)) < 0.03
    scene = cv2.GaussianBlur(random.normal(0, 1, (256, 320)), (0, 0), 1.5)
    assert likeness_of_neighbours(60 * scene / scene.std() + pattern / 10) > 0.3
    assert likeness_of_neighbours(np.full((20, 30), 7.0)) == 0.0
