"""Frame counters and sample counts that wrap or jump: unwrapping, and what was lost between two values."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_INT64_BITS = 63


def unwrap_counter(values: ArrayLike, bits: int) -> NDArray[np.int64]:
    """Make a wrapping counter continuous.

    Each step is taken as the smallest one, forward or backward, that explains the two values, so up to
    half a turn may be lost between two frames.

    Parameters
    ----------
    values
        (n,) integers as the device delivered them, each in ``[0, 2**bits)``.
    bits
        Width of the counter; 0 or more than 62 means that it does not wrap.

    Returns
    -------
    numpy.ndarray
        (n,) int64; the first value is kept.
    """
    counters = np.array(values, dtype=np.int64)
    if counters.size == 0 or not 0 < bits < _INT64_BITS:
        return counters
    turn = 1 << bits
    steps = np.diff(counters) & (turn - 1)
    steps[steps >= turn // 2] -= turn
    counters[1:] = counters[0] + np.cumsum(steps)
    return counters


def lost_between(previous: int, current: int, bits: int) -> int:
    """How many counts are missing between two delivered counters.

    Returns
    -------
    int
        0 when `current` follows `previous`; -1 when the counter stood still or went back (a restarted
        device), which says nothing about losses.
    """
    step = current - previous
    if 0 < bits < _INT64_BITS:
        turn = 1 << bits
        step %= turn
        if step >= turn // 2:
            step -= turn
    return step - 1 if step > 0 else -1
