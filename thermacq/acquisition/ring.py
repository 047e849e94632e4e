"""The ring of frames between one device process and the writer: bounded, in shared memory, without locks.

One process puts frames in, one takes them out. Each of two counters is written by one side only, as one
aligned 64-bit word, after the data that it announces; a process that is killed can therefore neither leave
a lock behind nor announce half a frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.acquisition.shared import SharedBlock
from thermacq.devices import Counts

FRAME_META = np.dtype(
    [
        ("counter", "i8"),
        ("ticks", "i8"),
        ("host_ns", "i8"),
        ("trigger_index", "i8"),
        ("trigger_ns", "i8"),
        ("flags", "i8"),
        ("fpa_temperature_k", "f8"),
    ]
)
"""What travels beside each picture; the fields are those of `thermacq.store.FrameRow`."""

# The two counters lie on cache lines of their own, the pictures start on a page.
_HEAD, _TAIL = 0, 8
_META_OFFSET = 128
_PAGE = 4096


def ring_bytes(rows: int, columns: int, slots: int) -> int:
    """Size of the block of a ring."""
    return _counts_offset(slots) + slots * rows * columns * 2


def _counts_offset(slots: int) -> int:
    end = _META_OFFSET + slots * FRAME_META.itemsize
    return -(-end // _PAGE) * _PAGE


class FrameRing:
    """One side's view of a ring in an allocated block.

    Parameters
    ----------
    block
        Allocated with `ring_bytes`.
    rows, columns, slots
        As given to `ring_bytes`.
    """

    def __init__(self, block: SharedBlock, rows: int, columns: int, slots: int) -> None:
        memory = block.map()
        self.slots = slots
        self._counters = np.frombuffer(memory, np.int64, count=16)
        self._meta = np.frombuffer(memory, FRAME_META, count=slots, offset=_META_OFFSET)
        self._counts: NDArray[np.uint16] = np.frombuffer(
            memory, np.uint16, count=slots * rows * columns, offset=_counts_offset(slots)
        ).reshape(slots, rows, columns)

    @property
    def filled(self) -> int:
        """Frames that wait in the ring."""
        return int(self._counters[_HEAD] - self._counters[_TAIL])

    def claim(self) -> Counts | None:
        """Producer: buffer for the next frame, None when the ring is full."""
        head = int(self._counters[_HEAD])
        if head - int(self._counters[_TAIL]) >= self.slots:
            return None
        counts: Counts = self._counts[head % self.slots]
        return counts

    def publish(self, meta: tuple[Any, ...]) -> None:
        """Producer: announce the claimed buffer with its `FRAME_META` values."""
        head = int(self._counters[_HEAD])
        self._meta[head % self.slots] = meta
        self._counters[_HEAD] = head + 1

    def peek(self, ahead: int = 0) -> tuple[Counts, np.void] | None:
        """Consumer: the frame `ahead` places behind the oldest, None when it has not come yet."""
        if ahead >= self.filled:
            return None
        slot = (int(self._counters[_TAIL]) + ahead) % self.slots
        return self._counts[slot], self._meta[slot]

    def release(self) -> None:
        """Consumer: free the oldest frame's buffer."""
        self._counters[_TAIL] += 1
