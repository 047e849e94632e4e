"""The loop of a camera's process: triggers out, frames in, every loss counted, the camera brought back."""

from __future__ import annotations

import math
from contextlib import nullcontext

from thermacq.acquisition.board import Cell, Order
from thermacq.acquisition.lifeline import LOST, Lifeline
from thermacq.acquisition.messages import ArmOrder
from thermacq.acquisition.priority import TriggerPriority
from thermacq.acquisition.ring_host import RingHost
from thermacq.acquisition.station import Station
from thermacq.acquisition.streams import Stream
from thermacq.devices import Camera, Frame, FrameFlag, TriggerMode
from thermacq.errors import DeviceFault
from thermacq.store import EventKind
from thermacq.timing import NS_PER_S, lost_between

# A frame can come this many triggers after its own and still be given its time.
_TRIGGERS_REMEMBERED = 256
# A camera that is away at the end does not end the run before the others have their last frames.
_LAST_FRAMES_NS = NS_PER_S


class CameraLoop:
    """Runs one camera: fires its software triggers, takes its frames, finds its gaps, has it brought back."""

    def __init__(
        self,
        camera: Camera,
        station: Station,
        host: RingHost,
        order: ArmOrder,
        priority: TriggerPriority | None,
        lifeline: Lifeline,
    ) -> None:
        self._camera = camera
        self._station = station
        self._host = host
        self._order = order
        self._priority = priority
        self._lifeline = lifeline
        self._frames = Stream(station, lambda: camera.frames(host))
        self._counter = -1
        self._was_shuttered = False
        self._fired: dict[int, int] = {}
        self._start_ns = 0
        self._last_ns = 0
        self._last_index = -1
        # First trigger, or place, of which nothing came in the outage of now.
        self._missing_from = 0

    def run(self, start_ns: int) -> None:
        """Take frames until the order is fulfilled or the recorder says stop."""
        self._start_ns = self._last_ns = start_ns
        try:
            if self._order.mode is TriggerMode.SOFTWARE:
                self._run_software()
            else:
                self._run_following()
        finally:
            if self._lifeline.is_away:
                self._count_missing()
            self._host.close_gap()

    def _count_missing(self) -> None:
        """Count what a camera missed that did not come back to the end."""
        due = self._due()
        if self._order.count is not None:
            due = min(due, self._order.count)
        self._station.board.add(self._station.index, Cell.DISCONNECTED, max(0, due - self._missing_from))

    def _due(self) -> int:
        """Triggers, or frames of a free-running camera, that were due by now."""
        since_ns = self._station.clock.now_ns() - self._start_ns
        return math.ceil(since_ns * self._order.rate_hz / NS_PER_S)

    def _run_software(self) -> None:
        """Absolute deadlines; a trigger that is too late is skipped and never caught up."""
        index, count = 0, self._order.count
        while count is None or index < count:
            try:
                if not self._trigger(index):
                    return
                index += 1
            except LOST as fault:
                if not self._bring_back(fault, index):
                    return
                # The first trigger that is still to come.
                index = max(index + 1, self._due())

    def _trigger(self, index: int) -> bool:
        """Wait for one deadline, fire, and take the frame; False when the recorder says stop."""
        station, order = self._station, self._order
        raised = self._priority.raised if self._priority else nullcontext
        deadline = self._start_ns + round(index * NS_PER_S / order.rate_hz)
        with raised():
            fired_ns = station.clock.wait_until_ns(deadline, station.stopping)
            late_ns = fired_ns - deadline
            # Nothing else between the reading of the time and the trigger; a negative value means stop.
            if 0 <= late_ns <= order.late_after_ns:
                self._camera.trigger(index)
        if station.stopping():
            return False
        if late_ns > order.late_after_ns:
            detail = f"skipped: {late_ns / 1000:.0f} us late"
            station.lost(Cell.LATE_TRIGGER, EventKind.LATE_TRIGGER, 1, index, detail)
            return True
        station.board.note_trigger(station.index, index, fired_ns)
        self._fired[index] = fired_ns
        self._fired.pop(index - _TRIGGERS_REMEMBERED, None)
        frame = self._frames.next(index)
        if frame is not None:
            self._take(frame, index)
            return True
        return not station.stopping()

    def _run_following(self) -> None:
        """Free run from the common start, or frames that a line triggers from now on.

        Frames missed in an outage count towards those that were asked for: the cameras end together.
        """
        if self._order.mode is TriggerMode.FREE_RUN:
            self._station.clock.wait_until_ns(self._start_ns, self._station.stopping)
        taken, count = 0, self._order.count
        while not self._station.stopping() and (count is None or taken < count):
            try:
                frame = self._frames.next(taken)
            except LOST as fault:
                if not self._bring_back(fault, taken):
                    return
                continue
            if frame is not None:
                taken += self._take(frame, -1)

    def _bring_back(self, fault: DeviceFault, index: int) -> bool:
        """Have the camera brought back; see `Lifeline.bring_back`."""
        if not self._lifeline.is_away:
            self._missing_from = index
        self._frames.end()
        count = self._order.count
        until_ns = self._station.end_ns
        if count is not None:
            until_ns = self._start_ns + round(count * NS_PER_S / self._order.rate_hz) + _LAST_FRAMES_NS
        if not self._lifeline.bring_back(fault, index, until_ns, self._arm):
            return False
        self._host.note_restart()
        self._counter, self._was_shuttered = -1, False
        return True

    def _arm(self) -> None:
        self._camera.arm(self._order.mode, self._order.rate_hz)

    def _take(self, frame: Frame, trigger_index: int) -> int:
        """Deliver a frame; returns how many were taken or, before it, missed in an outage.

        The driver's own trigger index, if it knows one, is the better one.
        """
        station = self._station
        index = trigger_index if frame.trigger_index < 0 else self._pulse_index(frame)
        missed = 0
        if self._lifeline.is_away:
            missed = self._missed(frame, index)
            self._lifeline.deliver(missed, index, "frames")
        self._note_gap(frame, index)
        shuttered = bool(frame.flags & FrameFlag.SHUTTER)
        if shuttered and not self._was_shuttered:
            station.event(EventKind.SHUTTER, index, "shutter closed")
        self._was_shuttered = shuttered
        self._host.deliver(frame, index, self._fired.get(index, -1))
        station.board.add(station.index, Cell.RECEIVED)
        station.board.put(station.index, Cell.LAST_HOST_NS, frame.host_ns)
        self._last_ns, self._last_index = frame.host_ns, index
        return missed + 1

    def _pulse_index(self, frame: Frame) -> int:
        """Index of the frame's trigger; a source that was away counts its pulses anew."""
        board, index = self._station.board, frame.trigger_index
        if self._order.mode is TriggerMode.HARDWARE and frame.host_ns >= board.order(Order.PULSES_SINCE_NS):
            return index + board.order(Order.PULSES_BEFORE)
        return index

    def _missed(self, frame: Frame, index: int) -> int:
        """Frames missing between the last one and this one: by trigger index, else by time."""
        if self._order.mode is TriggerMode.SOFTWARE:
            return index - self._missing_from
        if index >= 0 and (self._last_index >= 0 or self._missing_from == 0):
            return max(0, index - self._last_index - 1)
        periods = (frame.host_ns - self._last_ns) * self._order.rate_hz / NS_PER_S
        return max(0, round(periods) - (1 if self._missing_from else 0))

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
