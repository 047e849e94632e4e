"""Clocks that begin anew: every stretch by itself, against the times that the clocks were made from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from thermacq.timing import ClockModel, RestartedClock, fit_device_clock, pair_frames

RATE_HZ = 1e6
PERIOD_NS = 20_000_000
AWAY_NS = 3_000_000_000


def stretches(
    counts: list[int], ppm: float, delay_ns: int = 40_000
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], list[int]]:
    """Ticks, times of receipt, true times, and restarts of a device that counts from 1000 after each outage."""
    ticks, received, truth, restarts = [], [], [], []
    start_ns = 5_000_000_000
    for number, count in enumerate(counts):
        since_ns = np.arange(count) * PERIOD_NS
        ticks.append(1000 + np.rint(since_ns * (1 + ppm * 1e-6) * RATE_HZ / 1e9).astype(np.int64))
        truth.append(start_ns + since_ns)
        # Late by at least the shortest delay, exactly by it now and then.
        received.append(truth[-1] + delay_ns + (np.arange(count) % 7) * 10_000)
        if number:
            restarts.append(start_ns - 1_000_000)
        start_ns += count * PERIOD_NS + AWAY_NS
    return np.concatenate(ticks), np.concatenate(received), np.concatenate(truth), restarts


def test_a_clock_that_never_restarted_is_an_ordinary_model() -> None:
    ticks, received, truth, restarts = stretches([200], 50.0)
    clock = fit_device_clock(ticks, received, RATE_HZ, restarts)
    assert isinstance(clock, ClockModel)
    assert np.max(np.abs(clock.times_of(ticks, received) - truth - 40_000)) < 2000


@settings(deadline=None, max_examples=30)
@given(st.lists(st.integers(20, 150), min_size=2, max_size=4), st.floats(-200, 200))
def test_each_stretch_has_a_model_of_its_own(counts: list[int], ppm: float) -> None:
    ticks, received, truth, restarts = stretches(counts, ppm)
    clock = fit_device_clock(ticks, received, RATE_HZ, restarts)
    assert isinstance(clock, RestartedClock)
    assert len(clock.models) == len(counts)
    assert np.max(np.abs(clock.times_of(ticks, received) - truth - 40_000)) < 200_000
    assert clock.longest.points == max(counts)


def test_one_line_across_a_restart_would_be_off_by_the_outage() -> None:
    ticks, received, truth, _ = stretches([100, 100], 20.0)
    wrong = fit_device_clock(ticks, received, RATE_HZ)
    assert np.max(np.abs(wrong.times_of(ticks, received) - truth)) > AWAY_NS / 2


def test_an_outage_without_a_frame_after_it_leaves_no_empty_model() -> None:
    ticks, received, truth, restarts = stretches([50, 60], 0.0)
    between = [restarts[0] - 500_000_000, restarts[0], int(received[-1]) + 10**9]
    clock = fit_device_clock(ticks, received, RATE_HZ, between)
    assert isinstance(clock, RestartedClock)
    assert len(clock.models) == 2
    assert np.max(np.abs(clock.times_of(ticks, received) - truth - 40_000)) < 200_000


def test_pulses_are_told_apart_where_their_ticks_go_back() -> None:
    ticks, received, truth, restarts = stretches([100, 120], 80.0)
    pulses, triggers = ticks + 500, truth + 500_000
    clock = fit_device_clock(ticks, received, RATE_HZ, restarts, pulses, triggers)
    assert clock.method == "pulses"
    assert clock.drift_ppm == pytest.approx(80, abs=2)
    # Pulses tell the time itself; receipts are late by the shortest delay.
    assert np.max(np.abs(clock.times_of(ticks, received) - truth)) < 5000


def test_pulses_that_cannot_be_told_apart_are_not_used() -> None:
    ticks, received, truth, restarts = stretches([100, 120], 80.0)
    clock = fit_device_clock(ticks, received, RATE_HZ, restarts, np.sort(ticks), truth)
    assert clock.method == "envelope"


class Frames:
    def __init__(self, ticks: NDArray[np.int64], host_ns: NDArray[np.int64]) -> None:
        self.ticks, self.host_ns = ticks, host_ns
        self.trigger_index = self.trigger_ns = np.full(ticks.size, -1)


def test_frames_after_an_outage_are_paired_with_those_of_the_camera_that_stayed() -> None:
    right_ticks, right_ns, right_truth, restarts = stretches([100, 120], 30.0)
    left_truth = np.arange(right_truth[0], right_truth[-1] + 1, PERIOD_NS)
    left = Frames((left_truth - left_truth[0]) // 1000, left_truth + 40_000)
    right = Frames(right_ticks, right_ns)
    clocks = (
        fit_device_clock(left.ticks, left.host_ns, RATE_HZ),
        fit_device_clock(right.ticks, right.host_ns, RATE_HZ, restarts),
    )
    pairs = pair_frames(left, right, *clocks)
    assert pairs.paired_by == "device time"
    np.testing.assert_array_equal(left_truth[pairs.left], right_truth[pairs.right])
    assert pairs.right.size == 220
    assert pairs.unpaired_left.size == left_truth.size - 220
    assert np.max(np.abs(pairs.skew_ns)) < 200_000


def test_the_report_of_a_restarted_clock_names_every_stretch() -> None:
    ticks, received, _, restarts = stretches([100, 120], 30.0)
    told = fit_device_clock(ticks, received, RATE_HZ, restarts).to_dict()
    assert told["points"] == 120
    assert [one["from_ns"] for one in told["stretches"]] == [None, restarts[0]]
