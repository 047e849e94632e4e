from collections import deque

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq.acquisition.ring import FrameRing, ring_bytes
from thermacq.acquisition.shared import SharedBlock

ROWS, COLUMNS = 3, 5


def make_ring(slots: int) -> tuple[FrameRing, FrameRing]:
    """Both ends of a ring, each with a mapping of its own."""
    block = SharedBlock()
    block.allocate(ring_bytes(ROWS, COLUMNS, slots))
    ends = FrameRing(block, ROWS, COLUMNS, slots), FrameRing(block, ROWS, COLUMNS, slots)
    block.close()
    return ends


def put(producer: FrameRing, number: int) -> bool:
    counts = producer.claim()
    if counts is None:
        return False
    counts[:] = number
    producer.publish((number, -1, number * 10, number, -1, 0, 300.5))
    return True


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 7), st.lists(st.booleans(), max_size=80))
def test_a_ring_is_a_bounded_queue(slots: int, puts: list[bool]) -> None:
    producer, consumer = make_ring(slots)
    model: deque[int] = deque()
    for number, is_put in enumerate(puts):
        if is_put:
            assert put(producer, number) == (len(model) < slots)
            if len(model) < slots:
                model.append(number)
        else:
            item = consumer.peek()
            assert (item is None) == (not model)
            if item is not None:
                counts, meta = item
                assert np.all(counts == model[0])
                assert meta["counter"] == model.popleft()
                consumer.release()
        assert consumer.filled == producer.filled == len(model)


def test_frames_can_be_looked_at_ahead_without_freeing_them() -> None:
    producer, consumer = make_ring(4)
    for number in range(3):
        put(producer, number)
    ahead = [consumer.peek(place) for place in range(4)]
    assert [item[1]["counter"] for item in ahead if item] == [0, 1, 2]
    assert ahead[3] is None
    assert consumer.filled == 3


def test_what_travels_beside_a_picture_arrives() -> None:
    producer, consumer = make_ring(2)
    producer.claim()
    producer.publish((1, 2, 3, 4, 5, 6, 7.5))
    item = consumer.peek()
    assert item is not None
    assert item[1].item() == (1, 2, 3, 4, 5, 6, 7.5)


def test_an_unannounced_frame_is_not_seen() -> None:
    producer, consumer = make_ring(2)
    counts = producer.claim()
    assert counts is not None
    counts[:] = 9
    assert consumer.peek() is None
