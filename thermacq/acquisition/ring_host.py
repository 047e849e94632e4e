"""The host's side of a camera's acquisition: buffers out of the ring, frames into it, what did not fit counted."""

from __future__ import annotations

import time

import numpy as np

from thermacq.acquisition.board import Cell
from thermacq.acquisition.ring import FrameRing
from thermacq.acquisition.station import Station
from thermacq.devices import Counts, Frame, FrameFlag
from thermacq.errors import DeviceFault
from thermacq.store import EventKind

_FULL_RING_POLL_S = 0.0005


class RingHost:
    """The host's side of a camera: hands out buffers of the ring and counts what does not fit."""

    def __init__(self, station: Station, ring: FrameRing, scratch: Counts) -> None:
        self._station = station
        self._ring = ring
        self._scratch = scratch
        self._current: Counts | None = None
        self._gap_start = -1
        self._gap = 0
        self._restarted = 0

    def stopping(self) -> bool:
        """See `Station.stopping`."""
        return self._station.stopping()

    def buffer(self) -> Counts:
        """Hand out the next buffer: a slot of the ring, or scratch space when the ring is full."""
        if self._current is None:
            self._current = self._ring.claim()
            # Virtual time waits for the writer; real time cannot.
            while self._current is None and self._station.clock.is_virtual:
                self._station.board.add(self._station.index, Cell.HEARTBEAT)
                if self._station.ordered_to_stop():
                    break
                time.sleep(_FULL_RING_POLL_S)
                self._current = self._ring.claim()
            if self._current is None:
                self._current = self._scratch
        return self._current

    def deliver(self, frame: Frame, trigger_index: int, trigger_ns: int) -> None:
        """Pass a frame on to the writer, or count it as lost when it did not fit."""
        buffer = self.buffer()
        if frame.counts is not buffer:
            _check_picture(self._station.name, frame.counts, buffer)
            np.copyto(buffer, frame.counts)
        self._current = None
        if buffer is self._scratch:
            if self._gap == 0:
                self._gap_start = trigger_index if trigger_index >= 0 else frame.counter
            self._gap += 1
            self._station.board.add(self._station.index, Cell.RING_FULL)
            return
        self.close_gap()
        self._ring.publish(
            (
                frame.counter,
                frame.ticks,
                frame.host_ns,
                trigger_index,
                trigger_ns,
                int(frame.flags) | self._restarted,
                frame.fpa_temperature_k,
            )
        )
        self._restarted = 0

    def note_restart(self) -> None:
        """Flag the next frame that reaches the ring: counter and clock of the camera began anew before it."""
        self._restarted = int(FrameFlag.RESTARTED)

    def close_gap(self) -> None:
        """Post the frames lost since the ring was full as one event."""
        if self._gap:
            detail = f"{self._gap} frames lost: the writer was late"
            self._station.event(EventKind.RING_FULL, self._gap_start, detail)
            self._gap = 0


def _check_picture(name: str, counts: object, buffer: Counts) -> None:
    if not (isinstance(counts, np.ndarray) and counts.shape == buffer.shape and counts.dtype == buffer.dtype):
        found = f"{counts.shape} {counts.dtype}" if isinstance(counts, np.ndarray) else type(counts).__name__
        raise DeviceFault(name, "acquire", f"delivered {found} instead of {buffer.shape} uint16")
