import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from thermacq.timing import ClockModel, fit_clock, fit_clock_to_pulses

OFFSETS = st.integers(-(10**15), 10**15)
DRIFTS = st.floats(-300, 300)
SEEDS = st.integers(0, 2**32 - 1)


def host_times(ticks: np.ndarray, rate: float, offset_ns: int, drift_ppm: float) -> np.ndarray:
    """Truth: host time of the ticks of a clock with that offset and drift."""
    return offset_ns + np.rint(ticks * (1e9 / (rate * (1 + drift_ppm * 1e-6)))).astype(np.int64)


@settings(deadline=None)
@given(OFFSETS, DRIFTS, SEEDS, st.sampled_from([1e3, 1e6, 1e8]))
def test_receipt_times_give_offset_and_drift_within_the_stated_residual(
    offset_ns: int, drift_ppm: float, seed: int, rate: float
) -> None:
    rng = np.random.default_rng(seed)
    ticks = np.arange(0, int(120 * rate), int(rate / 10))
    truth = host_times(ticks, rate, offset_ns, drift_ppm)
    late = rng.exponential(2e6, ticks.size).astype(np.int64)
    late[rng.random(ticks.size) < 0.05] += 200_000_000
    model = fit_clock(ticks, truth + late, rate)
    assert model.method == "envelope"
    error = model.to_host_ns(ticks) - truth
    assert np.abs(error).max() <= model.residual_ns
    # The whole residual over the whole record is the most that the drift can be wrong.
    assert model.drift_ppm == pytest.approx(drift_ppm, abs=model.residual_ns / 120e9 * 1e6)
    assert np.all(truth + late - model.to_host_ns(ticks) >= -1)


@settings(deadline=None)
@given(OFFSETS, DRIFTS, SEEDS)
@example(offset_ns=0, drift_ppm=0.02734375, seed=0)  # most ticks exact, the others a whole tick off
def test_pulses_give_the_clock_to_their_jitter_in_spite_of_losses(
    offset_ns: int, drift_ppm: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rate, period_ns = 1e6, 20_000_000
    fired = offset_ns + 10**9 + np.arange(1000) * period_ns
    # Ticks of the pulses by the inverse of the true line, rounded to whole ticks.
    ticks = np.rint((fired - offset_ns) * 1e-9 * rate * (1 + drift_ppm * 1e-6)).astype(np.int64)
    block_ticks = np.arange(0, 21_000_000, 250_000)
    block_host = host_times(block_ticks, rate, offset_ns, drift_ppm) + rng.exponential(
        3e6, block_ticks.size
    ).astype(np.int64)
    seen = rng.random(ticks.size) > 0.2
    spurious = rng.integers(0, 20_000_000, 5)
    model = fit_clock_to_pulses(
        np.sort(np.concatenate([ticks[seen], spurious])), fired, fit_clock(block_ticks, block_host, rate)
    )
    assert model is not None
    assert model.method == "pulses"
    assert model.points >= 0.95 * seen.sum()
    # One tick is 1000 ns; a rounded tick is uniform within half of that.
    assert model.residual_ns < 1000
    assert np.abs(model.to_host_ns(ticks) - fired).max() < 1000


def test_pulses_are_recognised_through_a_receipt_lateness_of_several_periods() -> None:
    rate, fired = 1e6, 10**9 + np.arange(200) * 10_000_000
    ticks = np.arange(200) * 10_000 + 5_000
    late = fit_clock(
        [0, 2_000_000], [10**9 - 5_000_000 + 43_000_000, 3 * 10**9 - 5_000_000 + 43_000_000], rate
    )
    model = fit_clock_to_pulses(ticks, fired, late)
    assert model is not None
    np.testing.assert_array_equal(model.to_host_ns(ticks), fired)


def test_offset_and_drift_are_those_of_the_line() -> None:
    model = ClockModel(1_000_000, 5_000_000_000, 999.9, 1e6, 0.0, "pulses", 10)
    assert model.offset_ns == 5_000_000_000 - 999_900_000
    assert model.drift_ppm == pytest.approx(100.01, abs=0.001)


def test_too_short_a_record_gives_the_offset_only() -> None:
    ticks = np.arange(4) * 250
    model = fit_clock(ticks, ticks * 1_000_000 + np.array([9, 2, 7, 3]) * 1_000_000, 1000.0)
    assert model.method == "offset only"
    assert model.drift_ppm == pytest.approx(0)
    assert model.offset_ns == 2_000_000


def test_one_point_is_an_offset() -> None:
    assert fit_clock([10], [1_000], 1e9).to_host_ns([20])[0] == 1_010


@pytest.mark.parametrize(("ticks", "host", "rate"), [([], [], 1.0), ([1], [1, 2], 1.0), ([1], [1], 0.0)])
def test_impossible_input_is_refused(ticks: list[int], host: list[int], rate: float) -> None:
    with pytest.raises(ValueError, match="clock model"):
        fit_clock(ticks, host, rate)


def test_no_pulses_no_model() -> None:
    receipt = fit_clock([0, 100], [0, 100], 1e9)
    assert fit_clock_to_pulses([], [1, 2, 3], receipt) is None
    assert fit_clock_to_pulses([1, 2, 3], [], receipt) is None
