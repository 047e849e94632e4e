"""The loops that run inside a device process: what is asked of a camera, a probe, a trigger source.

Each loop counts every loss by its cause on the board and posts it as an event, so that it reaches the file.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from thermacq.acquisition.board import Cell, Order
from thermacq.acquisition.lifeline import LOST, Lifeline
from thermacq.acquisition.messages import ArmOrder, Pulse, Samples
from thermacq.acquisition.station import Station
from thermacq.devices import SampleBlock, TriggerPulse, TriggerSource, WaveProbe
from thermacq.errors import DeviceFault, DeviceOverrun, IncompleteFrame
from thermacq.store import EventKind
from thermacq.timing import NS_PER_S

# A device that fails this often in a row without delivering anything is given up.
_MAX_FAILURES = 100

_Item = TypeVar("_Item")


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

    def end(self) -> None:
        """End the generator of a device that is lost, and forget the losses that it announced."""
        stream, self._stream = self._stream, None
        if isinstance(stream, Generator):
            with suppress(Exception):
                stream.close()
        self.take_announced()

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


class ProbeLoop:
    """Runs one probe: takes its blocks, refuses garbage, finds its gaps, has it brought back."""

    def __init__(self, probe: WaveProbe, station: Station, lifeline: Lifeline) -> None:
        self._probe = probe
        self._station = station
        self._lifeline = lifeline
        self._blocks = Stream(station, lambda: probe.samples(station))
        self._next_index = -1
        # What its own count lacks since it was armed again.
        self._before = 0
        self._first_ns = self._last_ns = 0
        # Samples since the first block was received: what its time tells of the rate.
        self._since_first = 0

    def run(self) -> None:
        """Take blocks until told to stop."""
        station = self._station
        while not station.stopping():
            try:
                block = self._blocks.next(self._next_index)
            except LOST as fault:
                self._blocks.end()
                if not self._lifeline.bring_back(fault, self._next_index, station.end_ns, self._probe.arm):
                    return
                continue
            if block is None:
                continue
            try:
                block = check_block(block, len(self._probe.capabilities.channels))
            except (ValueError, TypeError) as error:
                station.lost(Cell.INCOMPLETE, EventKind.INCOMPLETE, 1, self._next_index, f"garbage: {error}")
                continue
            self._take(block)

    def _take(self, block: SampleBlock) -> None:
        """Deliver a block of samples, numbered on after an outage."""
        station, samples = self._station, block.ticks.size
        if self._lifeline.is_away:
            self._before = max(0, self._next_index) - block.first_index
            self._lifeline.deliver(self._missed(block), max(0, self._next_index), "samples")
        first_index = block.first_index + self._before
        lost = first_index - self._next_index if self._next_index >= 0 else 0
        if lost > 0:
            detail = f"{lost} samples lost before this one"
            station.lost(Cell.PROBE_GAP, EventKind.PROBE_GAP, lost, first_index, detail)
        self._next_index = first_index + samples
        self._since_first += samples if self._first_ns else 0
        self._first_ns, self._last_ns = self._first_ns or block.host_ns, block.host_ns
        station.board.add(station.index, Cell.RECEIVED, samples)
        station.board.put(station.index, Cell.LAST_HOST_NS, block.host_ns)
        if self._before:
            block = replace(block, first_index=first_index)
        station.outbox.post_patiently(Samples(block), station.ordered_to_stop)

    def _missed(self, block: SampleBlock) -> int:
        """Samples missing in an outage, by the rate at which they came before; 0 when that is not known."""
        before_ns = self._last_ns - self._first_ns
        if before_ns <= 0:
            return 0
        due = (block.host_ns - self._last_ns) * self._since_first / before_ns
        return max(0, round(due) - block.ticks.size)


class TriggerLoop:
    """Runs the trigger source: passes its pulses on, has it brought back."""

    def __init__(self, source: TriggerSource, station: Station, order: ArmOrder, lifeline: Lifeline) -> None:
        self._source = source
        self._station = station
        self._order = order
        self._lifeline = lifeline
        self._start_ns = 0
        self._emitted = 0
        self._before = 0

    def run(self, start_ns: int) -> None:
        """Let it emit its pulses, from the common start on."""
        self._start_ns = start_ns
        self._station.clock.wait_until_ns(start_ns, self._station.stopping)
        while not self._station.stopping():
            pulses = self._source.pulses(self._station)
            try:
                self._pass_on(pulses)
                return
            except LOST as fault:
                if not self._lifeline.bring_back(fault, self._emitted, self._end_ns(), self._rearm):
                    return

    def _rearm(self) -> None:
        """Arm the source for the pulses that are left until the end; they are numbered on."""
        left = self._order.count
        if left is not None:
            left = max(1, left - self._places())
        now_ns = self._station.clock.now_ns()
        self._station.board.give(Order.PULSES_SINCE_NS, now_ns)
        self._station.board.give(Order.PULSES_BEFORE, self._emitted)
        self._before = self._emitted
        self._source.arm(self._order.rate_hz, left)

    def _pass_on(self, pulses: Iterator[TriggerPulse]) -> None:
        station = self._station
        for pulse in pulses:
            if self._lifeline.is_away:
                self._lifeline.deliver(max(0, self._places() - self._emitted), self._emitted, "pulses")
            index = pulse.index + self._before
            station.outbox.post(Pulse(index, pulse.host_ns))
            self._emitted = index + 1
            station.board.add(station.index, Cell.RECEIVED)
            station.board.put(station.index, Cell.LAST_HOST_NS, pulse.host_ns)
            if station.stopping():
                return

    def _places(self) -> int:
        """Pulses that were due by now."""
        since_ns = self._station.clock.now_ns() - self._start_ns
        return int(since_ns * self._order.rate_hz / NS_PER_S)

    def _end_ns(self) -> int | None:
        if self._order.count is None:
            return None
        return self._start_ns + round(self._order.count * NS_PER_S / self._order.rate_hz)


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
