"""A serial port that is a pseudo-terminal: the driver opens it with the real pyserial.

A thread serves the far end: it hands what the host wrote to the device logic and sends what that answers.
Unplugging closes the pseudo-terminal, so that the driver sees the errors of a pulled cable.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Protocol, Self

from thermacq.testing.emulation.faults import FaultKind, FaultSchedule, FaultSettings, damaged
from thermacq.timing.clock import NS_PER_S, Clock, VirtualClock
from thermacq.transports import SerialNode

_POLL_S = 0.005
_LARGEST_READ = 65536


class SerialDevice(Protocol):
    """A device on a serial line: bytes in, answers out, and what it says unasked."""

    def power_up(self) -> None:
        """Start afresh, as after the cable was plugged in."""
        ...

    def receive(self, data: bytes) -> Sequence[bytes]:
        """Take bytes from the host, in whatever pieces they come, and return the answers, each one item."""
        ...

    def due_ns(self) -> int | None:
        """Host time of the next thing that it does unasked; None when it only answers."""
        ...

    def act(self) -> Sequence[bytes]:
        """Do what is due by now and return the messages to send, each one item."""
        ...


class PtyPort:
    """One serial port with an emulated device at its far end; a context manager.

    Parameters
    ----------
    device
        What it is connected to. Its methods are called from the port's thread only.
    node
        USB identity of the port; its path is that of the pseudo-terminal.
    clock
        Host clock.
    schedule
        Faults of the wire that strike the device's answers and messages, counted together as items:
        ``timeout``, ``stall``, ``short_read``, ``disconnect``, ``bad_crc``, ``drop``, ``duplicate``,
        ``garbage`` and ``slow``. Other kinds are left to the device.
    drives_time
        In virtual time, whether the device's messages make the time pass. False for a device that acts at
        the times to which the driver waits.
    """

    WIRE_FAULTS = (
        FaultKind.TIMEOUT,
        FaultKind.STALL,
        FaultKind.SHORT_READ,
        FaultKind.DISCONNECT,
        FaultKind.BAD_CRC,
        FaultKind.DROP,
        FaultKind.DUPLICATE,
        FaultKind.GARBAGE,
        FaultKind.SLOW,
    )

    def __init__(
        self,
        device: SerialDevice,
        node: SerialNode,
        clock: Clock,
        schedule: FaultSchedule | None = None,
        *,
        drives_time: bool = True,
    ) -> None:
        self._device = device
        self._node = node
        self._clock = clock
        self._schedule = schedule or FaultSchedule((), clock)
        self._drives_time = drives_time
        self._lock = threading.RLock()
        self._ends: tuple[int, int] | None = None
        self._replug_s: float | None = None
        # An order to unplug from another thread: seconds until it is plugged in again.
        self._pull: float | None = None
        self._silent_until_s = 0.0
        self._item = 0
        self._busy = False
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"emulated port {node.serial}", daemon=True)

    def __enter__(self) -> Self:
        """Plug in and serve."""
        self.plug()
        self._thread.start()
        if isinstance(self._clock, VirtualClock):
            self._clock.holds.append(self._settle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the thread and unplug."""
        if isinstance(self._clock, VirtualClock):
            self._clock.holds.remove(self._settle)
        self._ending.set()
        self._thread.join()
        self.unplug()

    def node(self) -> SerialNode | None:
        """The port as the host sees it; None while it is unplugged."""
        with self._lock:
            return None if self._ends is None else replace(self._node, path=os.ttyname(self._ends[1]))

    def plug(self) -> None:
        """Plug the cable in: the device starts afresh, on a new path."""
        with self._lock:
            if self._ends is None:
                ours, theirs = os.openpty()
                tty.setraw(theirs)
                os.set_blocking(ours, False)
                # Our hold on the far end keeps the port alive while no driver has it open.
                self._ends = ours, theirs
                self._replug_s = None
                self._device.power_up()

    def unplug(self, replug_after_s: float = 0.0) -> None:
        """Pull the cable; it is plugged in again after so many real seconds, or not when 0."""
        # Closed by the thread that waits on them: another could close a descriptor that is in use.
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._pull = replug_after_s
            while self._waits_for_pull() and self._thread.is_alive():
                time.sleep(_POLL_S / 5)
        else:
            self._close(replug_after_s)

    def _waits_for_pull(self) -> bool:
        return self._pull is not None

    def _close(self, replug_after_s: float) -> None:
        with self._lock:
            for end in self._ends or ():
                os.close(end)
            self._ends = None
            self._replug_s = time.monotonic() + replug_after_s if replug_after_s > 0 else None

    def _settle(self, stopping: Callable[[], bool]) -> None:
        """Keep virtual time from passing while bytes are on the wire, or the device is behind with its acts."""
        if threading.current_thread() is not self._thread:
            while self._thread.is_alive() and not (self._is_quiet() or stopping()):
                time.sleep(_POLL_S / 25)

    def _is_quiet(self) -> bool:
        with self._lock:
            if self._ends is None:
                return True
            # Looked at in this order: the thread is busy before it takes the bytes.
            if select.select([self._ends[0]], [], [], 0)[0] or self._busy:
                return False
        due_ns = self._device.due_ns()
        return self._drives_time or due_ns is None or due_ns > self._clock.now_ns()

    def _serve(self) -> None:
        while not self._ending.is_set():
            if self._pull is not None:
                self._close(self._pull)
                self._pull = None
            if self._ends is None:
                self._wait_for_replug()
                continue
            if select.select([self._ends[0]], [], [], self._patience_s())[0]:
                self._answer()
            due_ns = self._device.due_ns()
            if due_ns is not None and self._drives_time and self._clock.is_virtual:
                self._clock.wait_until_ns(due_ns)
            if due_ns is not None and due_ns <= self._clock.now_ns():
                self._send(self._device.act())

    def _wait_for_replug(self) -> None:
        if self._replug_s is not None and time.monotonic() >= self._replug_s:
            self.plug()
        else:
            self._ending.wait(_POLL_S)

    def _patience_s(self) -> float:
        due_ns = self._device.due_ns()
        if due_ns is None:
            return 4 * _POLL_S
        if self._clock.is_virtual:
            return 0.0 if self._drives_time else _POLL_S / 10
        return min(4 * _POLL_S, max(0.0, (due_ns - self._clock.now_ns()) / NS_PER_S))

    def _answer(self) -> None:
        with self._lock:
            if self._ends is None:
                return
            self._busy = True
            try:
                data = os.read(self._ends[0], _LARGEST_READ)
            except OSError:
                data = b""
        self._send(self._device.receive(data))
        self._busy = False

    def _send(self, items: Sequence[bytes]) -> None:
        for item in items:
            faults = self._schedule.strike(self._item, *self.WIRE_FAULTS)
            self._item += 1
            data = item
            for fault in faults:
                data = self._act_out(data, fault)
            if time.monotonic() >= self._silent_until_s:
                self._write(data)

    def _act_out(self, data: bytes, fault: FaultSettings) -> bytes:
        if fault.kind is FaultKind.DISCONNECT:
            self.unplug(fault.seconds)
            return b""
        if fault.kind is FaultKind.SLOW:
            self._ending.wait(fault.seconds)
        if fault.kind in (FaultKind.TIMEOUT, FaultKind.STALL):
            self._silent_until_s = time.monotonic() + fault.seconds
        return damaged(data, fault)

    def _write(self, data: bytes) -> None:
        """Send as fast as the host takes it; a host that takes nothing holds the device up."""
        while data and not self._ending.is_set():
            with self._lock:
                if self._ends is None:
                    return
                ours = self._ends[0]
                with contextlib.suppress(BlockingIOError):
                    data = data[os.write(ours, data) :]
            if data:
                select.select([], [ours], [], _POLL_S)
