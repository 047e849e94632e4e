"""Frame ids become continuous whatever was lost in between."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from thermacq_drivers.gige.frame_ids import FrameIds

STEPS = st.lists(st.integers(1, 32_000), max_size=60)


def count_all(frame_ids):
    ids = FrameIds()
    return [ids.count(frame_id) for frame_id in frame_ids]


@given(start=st.integers(1, 65_535), steps=STEPS)
def test_ids_that_skip_zero_count_every_frame(start, steps):
    numbers = [start]
    for step in steps:
        numbers.append(numbers[-1] + step)
    delivered = [(number - 1) % 65_535 + 1 for number in numbers]
    assert count_all(delivered) == numbers


@given(start=st.integers(1, 65_535), steps=STEPS)
def test_ids_that_count_through_zero_are_recognised_by_it(start, steps):
    numbers = [0]
    for step in [start, *steps]:
        numbers.append(numbers[-1] + step)
    assert count_all([number % 65_536 for number in numbers]) == numbers


@given(start=st.integers(65_536, 2**62), steps=st.lists(st.integers(1, 10**6), max_size=20))
def test_wide_ids_stay_as_they_are(start, steps):
    numbers = [start]
    for step in steps:
        numbers.append(numbers[-1] + step)
    assert count_all(numbers) == numbers


@given(st.lists(st.integers(0, 2**64 - 1), max_size=50))
def test_any_ids_give_counts_that_are_not_negative(frame_ids):
    assert all(count >= 0 for count in count_all(frame_ids))


def test_a_wide_id_goes_on_past_16_bits():
    counts = count_all([65_534, 65_535, 65_536, 65_537])
    assert [two - one for one, two in pairwise(counts)] == [1, 1, 1]


def test_the_same_frame_counts_once():
    assert count_all([7, 7]) == [7, 7]
