from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from thermacq.timing import ClockModel, frame_times_ns, pair_frames

PERIOD_NS = 20_000_000


@dataclass
class Times:
    trigger_index: NDArray[np.int64]
    trigger_ns: NDArray[np.int64]
    ticks: NDArray[np.int64]
    host_ns: NDArray[np.int64]


def triggered(kept: NDArray[np.int64], jitter_ns: NDArray[np.int64] | int = 0) -> Times:
    fired = 1_000_000_000 + kept * PERIOD_NS + jitter_ns
    return Times(kept, fired, np.full(kept.size, -1), fired + 5_000_000)


def free_running(index: NDArray[np.int64], clock: ClockModel, skew_ns: int = 0) -> Times:
    exposed = 1_000_000_000 + index * PERIOD_NS + skew_ns
    ticks = np.rint((exposed - clock.reference_ns) / clock.ns_per_tick).astype(np.int64)
    unknown = np.full(index.size, -1)
    return Times(unknown, unknown, ticks, exposed + 30_000_000)


LEFT_CLOCK = ClockModel(0, 0, 1000.0, 1e6, 0.0, "envelope", 9)
RIGHT_CLOCK = ClockModel(0, 700_000_000, 1000.05, 1e6, 0.0, "envelope", 9)


@settings(deadline=None)
@given(st.lists(st.booleans(), min_size=5, max_size=60), st.lists(st.booleans(), min_size=5, max_size=60))
def test_losses_never_misalign_triggered_pairs(left_kept: list[bool], right_kept: list[bool]) -> None:
    left_index, right_index = np.flatnonzero(left_kept), np.flatnonzero(right_kept)
    left, right = triggered(left_index), triggered(right_index, 40)
    pairs = pair_frames(left, right)
    both = np.intersect1d(left_index, right_index)
    np.testing.assert_array_equal(pairs.trigger_index, both)
    np.testing.assert_array_equal(left_index[pairs.left], right_index[pairs.right])
    assert np.all(pairs.skew_ns == 40)
    assert set(left_index[pairs.unpaired_left]) == set(left_index) - set(both)
    assert set(right_index[pairs.unpaired_right]) == set(right_index) - set(both)


@settings(deadline=None)
@given(
    st.lists(st.booleans(), min_size=12, max_size=60),
    st.lists(st.booleans(), min_size=12, max_size=60),
    st.integers(-4_000_000, 4_000_000),
)
def test_losses_never_misalign_pairs_by_device_time(
    left_kept: list[bool], right_kept: list[bool], skew_ns: int
) -> None:
    left_index, right_index = np.flatnonzero(left_kept), np.flatnonzero(right_kept)
    left = free_running(left_index, LEFT_CLOCK)
    right = free_running(right_index, RIGHT_CLOCK, skew_ns)
    pairs = pair_frames(left, right, LEFT_CLOCK, RIGHT_CLOCK, tolerance_ns=PERIOD_NS // 2)
    np.testing.assert_array_equal(left_index[pairs.left], right_index[pairs.right])
    assert pairs.left.size == np.intersect1d(left_index, right_index).size
    assert np.all(np.abs(pairs.skew_ns - skew_ns) <= 2000)
    if left_index.size and right_index.size:
        assert pairs.paired_by == "device time"


def test_frames_that_arrive_in_another_order_are_paired_by_their_time() -> None:
    index = np.array([3, 0, 2, 1])
    pairs = pair_frames(
        free_running(index, LEFT_CLOCK), free_running(np.arange(4), RIGHT_CLOCK), LEFT_CLOCK, RIGHT_CLOCK
    )
    np.testing.assert_array_equal(index[pairs.left], np.arange(4)[pairs.right])
    np.testing.assert_array_equal(index[pairs.left], np.arange(4))


def test_without_index_and_clock_nothing_is_paired_by_arrival() -> None:
    left = free_running(np.arange(5), LEFT_CLOCK)
    pairs = pair_frames(left, left)
    assert pairs.left.size == 0
    assert pairs.paired_by == "nothing"
    assert pairs.unpaired_left.size == 5


def test_the_first_of_two_frames_with_one_index_is_taken() -> None:
    pairs = pair_frames(triggered(np.array([0, 1, 1, -1])), triggered(np.array([1, 0])))
    np.testing.assert_array_equal(pairs.left, [0, 1])
    np.testing.assert_array_equal(pairs.right, [1, 0])
    np.testing.assert_array_equal(pairs.unpaired_left, [2, 3])


def test_the_best_known_time_of_a_frame_is_used() -> None:
    frames = Times(
        np.array([0, -1, -1]), np.array([11, -1, -1]), np.array([5, 7, -1]), np.array([91, 92, 93])
    )
    clock = ClockModel(0, 0, 10.0, 1e8, 0.0, "envelope", 9)
    np.testing.assert_array_equal(frame_times_ns(frames, clock), [11, 70, 93])
    np.testing.assert_array_equal(frame_times_ns(frames), [11, 92, 93])
