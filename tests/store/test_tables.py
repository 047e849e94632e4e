from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from thermacq.store import CameraStream
from thermacq.store.tables import CameraSink, Table


@given(bits=st.integers(4, 32), steps=st.lists(st.integers(-2, 7), min_size=1, max_size=40))
def test_counter_wraps_are_taken_out(bits, steps):
    stream = CameraStream("c", 1, 1, capabilities={"counter_bits": bits})
    camera = CameraSink(stream, None, Table([], None))
    truth = (1 << bits) - 3 + np.cumsum([0, *steps])
    found = [camera.next_sequence_number(int(number % (1 << bits))) for number in truth]
    np.testing.assert_array_equal(np.diff(found), steps)


@given(bits=st.integers(4, 32), before=st.integers(0, 2**40), after=st.integers(0, 2**40))
def test_a_counter_that_began_anew_goes_on_by_one(bits, before, after):
    turn = 1 << bits
    camera = CameraSink(CameraStream("c", 1, 1, capabilities={"counter_bits": bits}), None, Table([], None))
    first = camera.next_sequence_number(before % turn)
    camera.table.append()
    assert camera.next_sequence_number(after % turn, restarted=True) == first + 1
    assert camera.next_sequence_number((after + 3) % turn) == first + 4
