"""The notice board of a recording: plain integers in shared memory, each written by one process only.

The recorder writes orders (go, stop), devices and writer write how far they are. Without locks, a process
that is killed cannot stop the others from reading.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.acquisition.shared import SharedBlock

HISTORY = 64
"""How many of the latest triggers of a camera are kept for the skew shown while recording."""


class Order(IntEnum):
    """Cells that the recorder writes; the last two are written by the trigger source that leads."""

    GO = 0
    START_NS = 1
    STOP = 2
    PULSES_BEFORE = 3
    """Pulses emitted before the source was away for the last time; its own count begins anew then."""
    PULSES_SINCE_NS = 4
    """Host time from which `PULSES_BEFORE` holds."""


class Cell(IntEnum):
    """Cells of one device; all but `WRITTEN` and `RING_FILLED` are written by its own process."""

    HEARTBEAT = 0
    RECEIVED = 1
    LAST_HOST_NS = 2
    LATE_TRIGGER = 3
    RING_FULL = 4
    DEVICE_GAP = 5
    INCOMPLETE = 6
    OVERRUN = 7
    PROBE_GAP = 8
    WRITTEN = 9
    RING_FILLED = 10
    DISCONNECTED = 11


LOSSES = (
    Cell.LATE_TRIGGER,
    Cell.RING_FULL,
    Cell.DEVICE_GAP,
    Cell.INCOMPLETE,
    Cell.OVERRUN,
    Cell.PROBE_GAP,
    Cell.DISCONNECTED,
)
"""Cells that count losses, by cause: frames of a camera, samples or blocks of a probe, pulses of a source."""

_ORDERS = 8
_CELLS = 16
_DEVICE_WORDS = _CELLS + 2 * HISTORY


class Board:
    """The board, as every process of the recording sees it."""

    def __init__(self, devices: int) -> None:
        self._block = SharedBlock()
        self._block.allocate(8 * (_ORDERS + devices * _DEVICE_WORDS))
        self._devices = devices
        self._map()

    def _map(self) -> None:
        words = np.frombuffer(self._block.map(), np.int64)
        self._orders = words[:_ORDERS]
        self._rows = words[_ORDERS:].reshape(self._devices, _DEVICE_WORDS)
        self._cells = self._rows[:, :_CELLS]
        # (devices, HISTORY, 2): trigger index plus one, so that 0 is empty, and the host time it was fired
        self._history = self._rows[:, _CELLS:].reshape(self._devices, HISTORY, 2)

    def order(self, order: Order) -> int:
        """Value of an order."""
        return int(self._orders[order])

    def give(self, order: Order, value: int = 1) -> None:
        """Recorder: give an order."""
        self._orders[order] = value

    def get(self, device: int, cell: Cell) -> int:
        """Value of a device's cell."""
        return int(self._cells[device, cell])

    def put(self, device: int, cell: Cell, value: int) -> None:
        """Set a device's cell."""
        self._cells[device, cell] = value

    def add(self, device: int, cell: Cell, amount: int = 1) -> None:
        """Count something of a device."""
        self._cells[device, cell] += amount

    def note_trigger(self, device: int, index: int, host_ns: int) -> None:
        """Camera: note when a trigger was fired."""
        self._history[device, index % HISTORY] = (index + 1, host_ns)

    def recent_skew_ns(self, left: int, right: int) -> NDArray[np.int64]:
        """Absolute skews of the latest triggers that both cameras fired, (n,) int64."""
        a, b = self._history[left].copy(), self._history[right].copy()
        both = (a[:, 0] == b[:, 0]) & (a[:, 0] > 0)
        skew: NDArray[np.int64] = np.abs(b[both, 1] - a[both, 1])
        return skew

    def losses(self, device: int) -> dict[str, int]:
        """Losses of a device by cause, causes without a loss left out."""
        counts = {cell.name.lower(): self.get(device, cell) for cell in LOSSES}
        return {cause: count for cause, count in counts.items() if count}

    def close(self) -> None:
        """Let go of the board's memory handle; what is mapped stays readable."""
        self._block.close()

    def __getstate__(self) -> Any:
        return self._block, self._devices

    def __setstate__(self, state: Any) -> None:
        self._block, self._devices = state
        self._map()
