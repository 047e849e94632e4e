from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq.evaluation.series import WaveError, prepare
from thermacq.evaluation.waves import fit_harmonic, single_waves, spectrum, wave_statistics


@pytest.mark.parametrize("phase", np.linspace(0, 2 * np.pi, 7))
@pytest.mark.parametrize("crossing", ["up", "down"])
def test_a_regular_wave_gives_back_its_height_and_period(regular_wave, phase, crossing):
    time, elevation = regular_wave(height_m=0.0823, period_s=0.551, phase=phase)
    found = wave_statistics(time, elevation, crossing=crossing)
    assert found.waves in (9, 10)
    assert found.mean_height_m == pytest.approx(0.0823, rel=5e-5)
    assert found.significant_height_m == pytest.approx(0.0823, rel=1e-4)
    assert found.rms_height_m == pytest.approx(0.0823, rel=5e-5)
    assert found.mean_period_s == pytest.approx(0.551, rel=1e-3)
    assert found.peak_period_s == pytest.approx(0.551, rel=0.01)
    assert found.spectral_period_s == pytest.approx(0.551, rel=0.03)
    assert found.spectral_height_m == pytest.approx(math.sqrt(2) * 0.0823, rel=0.02)
    assert found.first_harmonic_amplitude_m == pytest.approx(0.0823 / 2, rel=2e-3)


def test_the_parabola_mends_the_height_that_samples_cut_off(regular_wave):
    time, elevation = regular_wave(per_period=27.3, waves=40)
    raw = wave_statistics(time, elevation, crest="sample").mean_height_m
    assert 0.08 * math.cos(math.pi / 27.3) < raw < 0.08 * 0.9985
    assert wave_statistics(time, elevation).mean_height_m == pytest.approx(0.08, rel=5e-5)


def test_uneven_samples_give_the_same_wave(regular_wave):
    generator = np.random.default_rng(3)
    time = np.cumsum(generator.uniform(0.6, 1.4, 400)) * 0.55 / 28
    elevation = 0.04 * np.sin(2 * np.pi * time / 0.55)
    found = wave_statistics(time, elevation)
    assert found.gaps == 0
    assert found.mean_height_m == pytest.approx(0.08, rel=1e-3)
    assert found.mean_period_s == pytest.approx(0.55, rel=1e-3)
    assert found.spectral_height_m == pytest.approx(4 * 0.04 / math.sqrt(2), rel=0.02)


def test_a_sea_of_known_spectrum(random_sea):
    time, elevation = random_sea()
    found = wave_statistics(time, elevation)
    assert found.spectral_height_m == pytest.approx(1.0, rel=0.03)
    # Narrow-banded Gaussian sea: Rayleigh heights.
    assert found.significant_height_m == pytest.approx(1.0, rel=0.06)
    assert found.rms_height_m == pytest.approx(1 / math.sqrt(2), rel=0.06)
    assert found.mean_height_m == pytest.approx(math.sqrt(math.pi / 8), rel=0.06)
    assert found.spectral_period_s == pytest.approx(1 / math.hypot(0.25, 0.03 / math.sqrt(2)), rel=0.02)
    assert found.peak_period_s == pytest.approx(4.0, rel=0.1)


def test_the_spectrum_holds_the_variance(random_sea):
    series = prepare(*random_sea())
    frequency, density = spectrum(series, 4.0)
    variance = np.sum(density) * (frequency[1] - frequency[0])
    assert variance == pytest.approx(np.var(series.elevation_m), rel=0.05)


def test_a_wave_across_a_gap_is_not_counted(regular_wave):
    time, elevation = regular_wave(waves=12.2, phase=0.0)
    whole = single_waves(prepare(time, elevation))
    broken = elevation.copy()
    broken[3 * 28 + 4 : 3 * 28 + 12] = np.nan
    series = prepare(time, broken)
    waves = single_waves(series)
    assert series.gap.sum() == 1
    assert series.missing == 8
    assert waves.period_s.size == whole.period_s.size - 1
    assert waves.lost_to_gaps == 1
    assert waves.height_m == pytest.approx(np.full(waves.period_s.size, 0.08), rel=1e-3)
    assert wave_statistics(time, broken).mean_height_m == pytest.approx(0.08, rel=1e-3)


def test_a_gap_at_a_crossing_loses_both_waves(regular_wave):
    time, elevation = regular_wave(waves=8.3, phase=0.0)
    broken = elevation.copy()
    crossing = 3 * 28 + 21
    broken[crossing - 3 : crossing + 4] = np.nan
    assert single_waves(prepare(time, broken)).lost_to_gaps == 2


def test_one_missing_frame_is_no_gap(regular_wave):
    time, elevation = regular_wave()
    elevation[::15] = np.nan
    found = wave_statistics(time, elevation)
    assert found.gaps == 0
    assert found.missing == np.isnan(elevation).sum()
    assert found.mean_height_m == pytest.approx(0.08, rel=2e-3)


def test_a_dead_band_keeps_noise_from_making_waves():
    generator = np.random.default_rng(0)
    time = np.arange(0, 80, 0.02)
    noisy = 0.04 * np.cos(2 * np.pi * time / 0.791) + generator.normal(0, 0.004, time.size)
    plain = wave_statistics(time, noisy)
    banded = wave_statistics(time, noisy, dead_band_m=0.015)
    assert plain.shortest_period_s < 0.1
    assert plain.waves > 105
    assert banded.waves == 100
    assert banded.mean_period_s == pytest.approx(0.791, rel=1e-3)
    assert banded.shortest_period_s > 0.7


def test_a_touch_of_zero_is_no_crossing():
    value = np.array([-1.0, 1, 0, 1, -1, 1, -1, 1])
    assert single_waves(prepare(np.arange(8.0), value, "none")).period_s.tolist() == [4, 2]


def test_linear_detrending_removes_a_drift(regular_wave):
    time, elevation = regular_wave(waves=20)
    drifting = elevation + 0.01 * time + 0.3
    found = wave_statistics(time, drifting, detrend="linear")
    assert found.mean_height_m == pytest.approx(0.08, rel=5e-3)
    assert found.mean_period_s == pytest.approx(0.55, rel=1e-3)


def test_the_harmonic_fit_finds_amplitude_phase_and_mean():
    time = np.linspace(0, 3.3, 200)
    series = prepare(time, 0.02 + 0.05 * np.cos(2 * np.pi * time / 0.8 - 1.1), "none")
    found = fit_harmonic(series, 0.8)
    assert (found.amplitude_m, found.phase_rad, found.mean_m) == pytest.approx((0.05, 1.1, 0.02))
    assert found.residual_m == pytest.approx(0, abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(
    offset=st.floats(-5, 5),
    scale=st.floats(0.01, 100),
    later=st.floats(-1e3, 1e3),
    seed=st.integers(0, 2**16),
)
def test_statistics_follow_offset_scale_and_time_shift(offset, scale, later, seed):
    generator = np.random.default_rng(seed)
    time = np.arange(300) * 0.02
    value = np.sin(2 * np.pi * time / 0.7) + 0.4 * np.sin(2 * np.pi * time / 0.51 + generator.uniform(0, 6))
    plain = wave_statistics(time, value)
    moved = wave_statistics(time + later, scale * value + offset)
    assert moved.waves == plain.waves
    assert moved.mean_height_m == pytest.approx(scale * plain.mean_height_m, rel=1e-6)
    assert moved.spectral_height_m == pytest.approx(scale * plain.spectral_height_m, rel=1e-6)
    assert moved.first_harmonic_amplitude_m == pytest.approx(
        scale * plain.first_harmonic_amplitude_m, rel=1e-4
    )
    assert moved.mean_period_s == pytest.approx(plain.mean_period_s, rel=1e-6)
    assert moved.spectral_period_s == pytest.approx(plain.spectral_period_s, rel=1e-4)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_time_reversal_turns_up_crossings_into_down_crossings(seed):
    generator = np.random.default_rng(seed)
    time = np.arange(400) * 0.02
    value = sum(np.sin(2 * np.pi * time / period + generator.uniform(0, 6)) for period in (0.5, 0.7, 0.9))
    forward = single_waves(prepare(time, value), "up")
    backward = single_waves(prepare(-time[::-1], value[::-1]), "down")
    assert backward.height_m[::-1] == pytest.approx(forward.height_m, rel=1e-9)
    assert backward.period_s[::-1] == pytest.approx(forward.period_s, rel=1e-9)


@pytest.mark.parametrize(
    ("time", "elevation", "message"),
    [
        ([0, 1], [0, 1], "too few"),
        ([0, 1, 2], [np.nan, 1, np.nan], "too few"),
        ([0, 1, 1, 2], [0, 1, 0, 1], "do not increase at sample 2"),
        ([0, 1, 2], [0, 1], "two equal columns"),
        ([[0, 1, 2]], [[0, 1, 2]], "two equal columns"),
        (np.arange(9.0), np.zeros(9), "no complete wave"),
        (np.arange(9.0), np.arange(9.0), "no complete wave"),
    ],
)
def test_series_that_hold_no_wave_are_refused(time, elevation, message):
    with pytest.raises(WaveError, match=message):
        wave_statistics(time, elevation)


def test_laboratory_flume_series(shared_data: Path):
    time, elevation = np.loadtxt(shared_data / "luth1994_flume" / "CaseA_Exp_22m.txt", unpack=True)
    for crossing in ("up", "down"):
        found = wave_statistics(time, elevation, crossing=crossing)
        assert found.mean_period_s == pytest.approx(2.020, rel=0.005)
        assert found.mean_height_m == pytest.approx(0.0218, rel=0.02)


def test_sea_series(shared_data: Path):
    time, elevation = np.loadtxt(shared_data / "wafo_waves" / "sea.dat", unpack=True)
    found = wave_statistics(time, elevation, crest="sample")
    assert found.waves == 534
    assert found.spectral_height_m == pytest.approx(1.89, abs=0.005)
    assert found.mean_height_m == pytest.approx(1.104, abs=0.001)
    assert found.significant_height_m == pytest.approx(1.772, abs=0.001)
    assert found.mean_period_s == pytest.approx(4.45, abs=0.005)
    rounded = wave_statistics(time, elevation)
    assert 1.0 < rounded.mean_height_m / found.mean_height_m < 1.02
