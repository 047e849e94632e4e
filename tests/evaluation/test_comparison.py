from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq.evaluation.comparison import agreement, compare_series
from thermacq.evaluation.lag import estimate_lag, interpolate_reference
from thermacq.evaluation.series import WaveError


def probe_and_stereo(slope=0.979, offset=0.001, lag_s=0.0, noise_m=0.0, seed=0, seconds=8.0):
    generator = np.random.default_rng(seed)
    probe_time = np.arange(-1, seconds + 1, 0.005)
    probe = 0.04 * np.sin(2 * np.pi * probe_time / 0.791)
    time = np.arange(0, seconds, 0.02)
    stereo = slope * 0.04 * np.sin(2 * np.pi * (time - lag_s) / 0.791) + offset
    return time, stereo + generator.normal(0, noise_m, time.size), probe_time, probe


def test_slope_bias_and_heights_of_a_known_pair():
    found = compare_series(*probe_and_stereo())
    assert found.agreement.slope == pytest.approx(0.979, abs=2e-3)
    assert found.agreement.orthogonal_slope == pytest.approx(0.979, abs=2e-3)
    assert found.agreement.bias_m == pytest.approx(0.001, abs=5e-5)
    assert found.amplitude_ratio == pytest.approx(0.979, abs=1e-3)
    assert found.height_error == pytest.approx(-0.021, abs=1e-3)
    assert found.period_error == pytest.approx(0, abs=1e-3)
    assert found.missing_fraction == 0
    assert not found.lag.applied


def test_r_squared_is_the_papers_formula():
    generator = np.random.default_rng(1)
    probe = generator.normal(size=200)
    stereo = 0.9 * probe + 0.1 + generator.normal(0, 0.2, 200)
    found = agreement(stereo, probe, block=10)
    assert found.r_squared == pytest.approx(
        1 - np.sum((probe - stereo) ** 2) / np.sum((probe - probe.mean()) ** 2)
    )
    assert found.rmse_m == pytest.approx(np.sqrt(np.mean((stereo - probe) ** 2)))
    assert (found.slope, found.intercept_m) == pytest.approx(np.polyfit(probe, stereo, 1))
    assert found.correlation == pytest.approx(np.corrcoef(probe, stereo)[0, 1])
    assert found.rmse_m**2 == pytest.approx(found.bias_m**2 + found.difference_sd_m**2 * 199 / 200)


@settings(max_examples=50, deadline=None)
@given(
    slope=st.floats(0.5, 2), seed=st.integers(0, 1000), offset=st.floats(-1, 1), scale=st.floats(1e-3, 1e3)
)
def test_identities(slope, seed, offset, scale):
    generator = np.random.default_rng(seed)
    probe = generator.normal(size=60)
    stereo = slope * probe + generator.normal(0, 0.1, 60)
    found = agreement(stereo, probe, block=5, resamples=0)
    turned = agreement(probe, stereo, block=5, resamples=0)
    moved = agreement(scale * (stereo + offset), scale * (probe + offset), block=5, resamples=0)
    # Orthogonal regression does not know which series is the target; least squares does.
    assert found.orthogonal_slope * turned.orthogonal_slope == pytest.approx(1)
    assert found.slope * turned.slope == pytest.approx(found.correlation**2)
    assert (moved.slope, moved.r_squared) == pytest.approx((found.slope, found.r_squared), rel=1e-6, abs=1e-9)
    assert moved.bias_m == pytest.approx(scale * found.bias_m, rel=1e-6, abs=1e-9 * scale)
    assert found.r_squared <= found.correlation**2 + 1e-12


def test_bland_altman_limits_hold_95_percent_of_the_differences():
    generator = np.random.default_rng(2)
    probe = generator.normal(size=20_000)
    stereo = probe + generator.normal(0.3, 0.7, 20_000)
    low, high = agreement(stereo, probe, block=10, resamples=0).limits_m
    inside = np.mean((stereo - probe > low) & (stereo - probe < high))
    assert inside == pytest.approx(0.95, abs=0.005)
    assert (low, high) == pytest.approx((0.3 - 1.96 * 0.7, 0.3 + 1.96 * 0.7), abs=0.03)


def ar1(generator, size, memory=0.8):
    noise = generator.normal(size=size)
    for index in range(1, size):
        noise[index] += memory * noise[index - 1]
    return noise


def test_block_bootstrap_covers_the_bias_of_correlated_errors():
    generator = np.random.default_rng(7)
    trials, covered, covered_by_single_samples = 200, 0, 0
    for trial in range(trials):
        probe = generator.normal(size=400)
        stereo = probe + ar1(generator, 400)
        low, high = agreement(stereo, probe, block=25, resamples=300, seed=trial).intervals["bias_m"]
        covered += low < 0 < high
        low, high = agreement(stereo, probe, block=1, resamples=300, seed=trial).intervals["bias_m"]
        covered_by_single_samples += low < 0 < high
    assert covered / trials > 0.85
    # Without blocks the interval is far too narrow: this is why there are blocks.
    assert covered_by_single_samples / trials < 0.6


def test_the_bootstrap_repeats_with_its_seed():
    series = probe_and_stereo(noise_m=0.001)
    first, again, other = (compare_series(*series, seed=seed).agreement.intervals for seed in (1, 1, 2))
    assert first == again
    assert first != other
    for low, high in first.values():
        assert low < high


def test_a_lag_is_found_and_stated_but_not_applied():
    lagging = probe_and_stereo(slope=1, offset=0, lag_s=0.030)
    found = compare_series(*lagging)
    assert found.lag.lag_s == pytest.approx(0.030, abs=1e-4)
    assert found.lag.phase_deg == pytest.approx(360 * 0.030 / 0.791, abs=0.1)
    assert not found.lag.applied
    assert found.agreement.r_squared < 0.97
    shifted = compare_series(*lagging, apply_lag=True)
    assert shifted.lag.applied
    assert shifted.lag.lag_s == pytest.approx(0.030, abs=1e-4)
    assert shifted.agreement.r_squared > 0.9999


def test_a_leading_series_has_a_negative_lag():
    found = estimate_lag(*probe_and_stereo(lag_s=-0.1), period_s=0.791)
    assert found.lag_s == pytest.approx(-0.1, abs=5e-4)
    assert found.phase_deg == pytest.approx(-360 * 0.1 / 0.791, abs=0.5)


def test_missing_stereo_samples_are_counted_and_left_out():
    time, stereo, probe_time, probe = probe_and_stereo()
    stereo[::10] = np.nan
    found = compare_series(time, stereo, probe_time, probe)
    assert found.missing_fraction == pytest.approx(0.1)
    assert found.agreement.samples == np.isfinite(stereo).sum()
    assert np.isnan(found.reference_m[::10]).all()


def test_the_probe_is_not_interpolated_across_a_gap():
    time = np.arange(0, 1, 0.01)
    kept = (time < 0.4) | (time > 0.5)
    value = np.where(kept, time, np.nan)
    found = interpolate_reference(time, value, np.array([-0.1, 0.205, 0.45, 0.6, 1.2]))
    assert found == pytest.approx([np.nan, 0.205, np.nan, 0.6, np.nan], nan_ok=True)


def test_series_that_cannot_be_compared_are_refused():
    time, stereo, probe_time, probe = probe_and_stereo()
    with pytest.raises(WaveError, match=r"hardly overlap.*stereo from 0\.000.*probe from 99"):
        compare_series(time, stereo, probe_time + 100, probe)
    with pytest.raises(WaveError, match="too few to compare"):
        compare_series(time, stereo, probe_time, np.full_like(probe, np.nan))
    with pytest.raises(WaveError, match="hardly overlap"):
        compare_series(time, np.full_like(stereo, np.nan), probe_time, probe)
    with pytest.raises(WaveError, match="stereo: the series holds no complete wave"):
        compare_series(time, np.zeros_like(stereo), probe_time, probe)
    with pytest.raises(WaveError, match="probe: the series holds no complete wave"):
        compare_series(time, stereo, probe_time, np.zeros_like(probe))
    with pytest.raises(WaveError, match="two equal columns"):
        compare_series(time, stereo[:-1], probe_time, probe)


def test_short_records_have_no_intervals():
    generator = np.random.default_rng(0)
    found = agreement(generator.normal(size=10), generator.normal(size=10), block=8)
    assert all(np.isnan(value) for interval in found.intervals.values() for value in interval)
