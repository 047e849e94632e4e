import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from thermacq.timing import lost_between, unwrap_counter


@given(
    start=st.integers(0, 2**16 - 1),
    steps=st.lists(st.integers(1, 2**15 - 1), max_size=200),
)
def test_unwrapping_restores_a_16_bit_counter_through_losses(start: int, steps: list[int]) -> None:
    truth = start + np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
    np.testing.assert_array_equal(unwrap_counter(truth % 2**16, 16), truth)


def test_unwrapping_understands_frames_out_of_order() -> None:
    np.testing.assert_array_equal(unwrap_counter([65534, 0, 65535, 1], 16), [65534, 65536, 65535, 65537])


def test_a_counter_without_width_is_left_alone() -> None:
    np.testing.assert_array_equal(unwrap_counter([5, 3, 9], 0), [5, 3, 9])
    assert unwrap_counter([], 16).size == 0


@given(previous=st.integers(0, 255), lost=st.integers(0, 126), bits=st.just(8))
def test_losses_are_counted_across_the_wrap(previous: int, lost: int, bits: int) -> None:
    assert lost_between(previous, (previous + 1 + lost) % 256, bits) == lost


def test_a_counter_that_stands_or_goes_back_tells_nothing_about_losses() -> None:
    assert lost_between(7, 7, 8) == -1
    assert lost_between(200, 190, 8) == -1
    assert lost_between(10, 3, 0) == -1
