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
