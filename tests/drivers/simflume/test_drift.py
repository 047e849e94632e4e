from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch

from thermacq_drivers.simflume.drift import Flicker


def test_spectrum_is_that_of_one_over_f() -> None:
    step_s, level = 0.25, 0.01
    flicker = Flicker(level, (24, 24), 1, "left", "flicker")
    series = np.array([flicker.at(number * step_s) for number in range(4096)]).reshape(4096, -1)
    frequency, density = welch(series, fs=1 / step_s, nperseg=1024, axis=0)
    density = density.mean(axis=1)
    band = (frequency > 0.01) & (frequency < 0.4)
    slope = np.polyfit(np.log(frequency[band]), np.log(density[band]), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.06)
    expected = level**2 / (frequency[band] * np.log(2))
    assert np.median(density[band] / expected) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(density[band] / expected, 1.0, atol=0.25)


def test_it_depends_on_time_only_and_hardly_changes_at_once() -> None:
    flicker = Flicker(1.0, (16, 16), 1, "left", "flicker")
    later = flicker.at(500.0)
    flicker.at(-3.0)
    np.testing.assert_array_equal(flicker.at(500.0), later)
    assert np.abs(flicker.at(500.001) - later).max() < 0.1
    assert np.abs(flicker.at(600.0) - later).mean() > 0.5
    other = Flicker(1.0, (16, 16), 1, "right", "flicker").at(500.0)
    assert abs(np.corrcoef(other.ravel(), later.ravel())[0, 1]) < 0.25
