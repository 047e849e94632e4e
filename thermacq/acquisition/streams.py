"""The loops that run inside a device process: what is asked of a camera, a probe, a trigger source.

Each loop counts every loss by its cause on the board and posts it as an event, so that it reaches the file.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from thermacq.acquisition.board import Board, Cell, Order
from thermacq.acquisition.messages import ArmOrder, Pulse, Samples
from thermacq.acquisition.outbox import Outbox
from thermacq.acquisition.priority import TriggerPriority
from thermacq.acquisition.ring import FrameRing
from thermacq.devices import (
    Camera,
    Counts,
    Frame,
    FrameFlag,
    SampleBlock,
    TriggerMode,
    TriggerSource,
    WaveProbe,
)
from thermacq.errors import DeviceFault, DeviceOverrun, IncompleteFrame
from thermacq.store import Event, EventKind
from thermacq.timing import NS_PER_S, Clock, lost_between

# A device that fails this often in a row without delivering anything is given up.
_MAX_FAILURES = 100
_FULL_RING_POLL_S = 0.0005
# A frame can come this many triggers after its own and still be given its time.
_TRIGGERS_REMEMBERED = 256

_Item = TypeVar("_Item")


@dataclass
class Station:
    """What every loop needs: the device's place on the board, its clock and its mail."""

    name: str
    index: int
    board: Board
    clock: Clock
    outbox: Outbox
    recorder_pid: int
    end_ns: int | None = None

    def stopping(self) -> bool:
        """Whether the device shall end now; also the sign of life that the recorder watches."""
        self.board.add(self.index, Cell.HEARTBEAT)
        return self.ordered_to_stop() or (self.end_ns is not None and self.clock.now_ns() >= self.end_ns)

    def ordered_to_stop(self) -> bool:
        """Whether the recorder said stop, or is gone."""
        return self.board.order(Order.STOP) != 0 or os.getppid() != self.recorder_pid

    def event(self, kind: EventKind, index: int, detail: str) -> None:
        """Post an event for the file."""
        self.outbox.post(Event(self.clock.now_ns(), self.name, kind, index, detail))

    def lost(self, cell: Cell, kind: EventKind, amount: int, index: int, detail: str) -> None:
        """Count a loss and post it."""
        self.board.add(self.index, cell, amount)
        self.event(kind, index, detail)


class RingHost:
    """The host's side of a camera: hands out buffers of the ring and counts what does not fit."""

    def __init__(self, station: Station, ring: FrameRing, scratch: Counts) -> None:
        self._station = station
        self._ring = ring
        self._scratch = scratch
        self._current: Counts | None = None
        self._gap_start = -1
        self._gap = 0

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
                int(frame.flags),
                frame.fpa_temperature_k,
            )
        )

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


class Stream(Generic[_Item]):
    """A device's generator, made anew after the faults through which a stream can go on."""

    def __init__(self, station: Station, make: Callable[[], Iterator[_Item]]) -> None:
        self._station = station
        self._make = make
        self._stream: Iterator[_Item] | None = None
        self._failures = 0
        self._announced = 0
        self._overrun = False

    def next(self, index: int) -> _Item | None:
        """Next frame or block; None when it was lost, or when the device shall stop.

        Raises
        ------
        DeviceFault
            The device cannot go on, or its stream ended unasked.
        """
        if self._stream is None:
            self._stream = self._make()
        try:
            item = next(self._stream)
        except StopIteration:
            if self._station.stopping():
                return None
            raise DeviceFault(self._station.name, "acquire", "its stream ended unasked") from None
        except (IncompleteFrame, DeviceOverrun) as fault:
            self._stream = None
            self._count(fault, index)
            return None
        self._failures = 0
        return item

    def take_announced(self) -> tuple[int, bool]:
        """Losses that faults announced since the last call, and whether one was an overrun."""
        announced = self._announced, self._overrun
        self._announced, self._overrun = 0, False
        return announced

    def _count(self, fault: DeviceFault, index: int) -> None:
        self._failures += 1
        if self._failures > _MAX_FAILURES:
            what = f"gave nothing good {self._failures} times in a row; last: {fault.what}"
            raise DeviceFault(self._station.name, "acquire", what) from fault
        self._announced += 1
        if isinstance(fault, DeviceOverrun):
            self._overrun = True
            self._station.lost(Cell.OVERRUN, EventKind.OVERRUN, 1, index, fault.what)
        else:
            self._station.lost(Cell.INCOMPLETE, EventKind.INCOMPLETE, 1, index, fault.what)


class CameraLoop:
    """Runs one camera: fires its software triggers, takes its frames, finds its gaps."""

    def __init__(
        self,
        camera: Camera,
        station: Station,
        host: RingHost,
        order: ArmOrder,
        priority: TriggerPriority | None,
    ) -> None:
        self._camera = camera
        self._station = station
        self._host = host
        self._order = order
        self._priority = priority
        self._frames = Stream(station, lambda: camera.frames(host))
        self._counter = -1
        self._was_shuttered = False
        self._fired: dict[int, int] = {}

    def run(self, start_ns: int) -> None:
        """Take frames until the order is fulfilled or the recorder says stop."""
        if self._order.mode is TriggerMode.SOFTWARE:
            self._run_software(start_ns)
        else:
            self._run_following(start_ns)
        self._host.close_gap()

    def _run_software(self, start_ns: int) -> None:
        """Absolute deadlines; a trigger that is too late is skipped and never caught up."""
        station, order = self._station, self._order
        raised = self._priority.raised if self._priority else nullcontext
        index = 0
        while order.count is None or index < order.count:
            deadline = start_ns + round(index * NS_PER_S / order.rate_hz)
            with raised():
                fired_ns = station.clock.wait_until_ns(deadline, station.stopping)
                late_ns = fired_ns - deadline
                # Nothing else between the reading of the time and the trigger; a negative value means stop.
                if 0 <= late_ns <= order.late_after_ns:
                    self._camera.trigger(index)
            if station.stopping():
                return
            if late_ns > order.late_after_ns:
                detail = f"skipped: {late_ns / 1000:.0f} us late"
                station.lost(Cell.LATE_TRIGGER, EventKind.LATE_TRIGGER, 1, index, detail)
            else:
                station.board.note_trigger(station.index, index, fired_ns)
                self._fired[index] = fired_ns
                self._fired.pop(index - _TRIGGERS_REMEMBERED, None)
                frame = self._frames.next(index)
                if frame is not None:
                    self._take(frame, index)
                elif station.stopping():
                    return
            index += 1

    def _run_following(self, start_ns: int) -> None:
        """Free run from the common start, or frames that a line triggers from now on."""
        if self._order.mode is TriggerMode.FREE_RUN:
            self._station.clock.wait_until_ns(start_ns, self._station.stopping)
        taken = 0
        while not self._station.stopping() and (self._order.count is None or taken < self._order.count):
            frame = self._frames.next(taken)
            if frame is not None:
                self._take(frame, -1)
                taken += 1

    def _take(self, frame: Frame, trigger_index: int) -> None:
        """Deliver a frame; the driver's own trigger index, if it knows one, is the better one."""
        station = self._station
        index = frame.trigger_index if frame.trigger_index >= 0 else trigger_index
        self._note_gap(frame, index)
        shuttered = bool(frame.flags & FrameFlag.SHUTTER)
        if shuttered and not self._was_shuttered:
            station.event(EventKind.SHUTTER, index, "shutter closed")
        self._was_shuttered = shuttered
        self._host.deliver(frame, index, self._fired.get(index, -1))
        station.board.add(station.index, Cell.RECEIVED)
        station.board.put(station.index, Cell.LAST_HOST_NS, frame.host_ns)

    def _note_gap(self, frame: Frame, index: int) -> None:
        """Losses inside the device show as a jump of its counter; some were announced by a fault."""
        if frame.flags & FrameFlag.INCOMPLETE:
            detail = "frame arrived damaged; it is stored and flagged"
            self._station.event(EventKind.INCOMPLETE, index, detail)
        announced, overrun = self._frames.take_announced()
        previous, self._counter = self._counter, frame.counter
        if previous < 0 or frame.counter < 0:
            return
        lost = lost_between(previous, frame.counter, self._camera.capabilities.counter_bits)
        if lost < 0:
            detail = f"counter went from {previous} to {frame.counter}: the camera was restarted"
            self._station.event(EventKind.NOTE, index, detail)
        elif lost > announced:
            cell, kind = (
                (Cell.OVERRUN, EventKind.OVERRUN) if overrun else (Cell.DEVICE_GAP, EventKind.DEVICE_GAP)
            )
            detail = f"{lost - announced} frames lost before this one"
            self._station.lost(cell, kind, lost - announced, index, detail)


class ProbeLoop:
    """Runs one probe: takes its blocks, refuses garbage, finds its gaps."""

    def __init__(self, probe: WaveProbe, station: Station) -> None:
        self._probe = probe
        self._station = station
        self._blocks = Stream(station, lambda: probe.samples(station))
        self._next_index = -1

    def run(self) -> None:
        """Take blocks until told to stop."""
        station = self._station
        while not station.stopping():
            block = self._blocks.next(self._next_index)
            if block is None:
                continue
            try:
                block = check_block(block, len(self._probe.capabilities.channels))
            except (ValueError, TypeError) as error:
                station.lost(Cell.INCOMPLETE, EventKind.INCOMPLETE, 1, self._next_index, f"garbage: {error}")
                continue
            samples = block.ticks.size
            lost = block.first_index - self._next_index if self._next_index >= 0 else 0
            if lost > 0:
                detail = f"{lost} samples lost before this one"
                station.lost(Cell.PROBE_GAP, EventKind.PROBE_GAP, lost, block.first_index, detail)
            self._next_index = block.first_index + samples
            station.board.add(station.index, Cell.RECEIVED, samples)
            station.board.put(station.index, Cell.LAST_HOST_NS, block.host_ns)
            station.outbox.post_patiently(Samples(block), station.ordered_to_stop)


def check_block(block: object, channels: int) -> SampleBlock:
    """A block with proper arrays; raises `ValueError` or `TypeError` saying what is wrong."""
    if not isinstance(block, SampleBlock):
        raise TypeError(f"a {type(block).__name__} instead of a block of samples")
    values = np.asarray(block.values, np.float64)
    ticks = np.asarray(block.ticks, np.int64)
    pulses = np.asarray(block.pulse_ticks, np.int64)
    if values.ndim != 2 or values.shape[1] != channels:
        raise ValueError(f"values of shape {values.shape} for {channels} channels")
    if ticks.shape != (values.shape[0],) or pulses.ndim != 1:
        raise ValueError(f"{ticks.shape} ticks for {values.shape[0]} samples")
    if np.any(np.diff(ticks) < 0):
        raise ValueError("its clock runs backwards")
    if not np.all(np.isfinite(values)):
        raise ValueError("values that are not finite")
    return SampleBlock(values, ticks, int(block.first_index), int(block.host_ns), pulses)


def run_trigger_source(source: TriggerSource, station: Station, start_ns: int) -> None:
    """Let a trigger source emit its pulses, from the common start on."""
    station.clock.wait_until_ns(start_ns, station.stopping)
    for pulse in source.pulses(station):
        station.outbox.post(Pulse(pulse.index, pulse.host_ns))
        station.board.add(station.index, Cell.RECEIVED)
        station.board.put(station.index, Cell.LAST_HOST_NS, pulse.host_ns)
        if station.stopping():
            return
