"""When a simulated camera exposes: by its own clock, on software triggers, or on a trigger line.

Each source counts every exposure since it was made, also those that the camera then loses, so that losses
show as gaps of the frame counter.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from thermacq.devices import StreamHost
from thermacq.timing import NS_PER_S, Clock
from thermacq.timing.trigger_line import LineReader

_POLL_NS = 20_000_000
_LINE_POLL_S = 0.0005
_QUEUED_EXPOSURES = 3


@dataclass(frozen=True)
class Exposure:
    """One exposure: its number since arming, the trigger's index (-1: none), and when it started."""

    number: int
    trigger_index: int
    start_ns: int


class ExposureSource(Protocol):
    """Tells a camera when to expose."""

    def next(self, host: StreamHost) -> Exposure | None:
        """Wait for the next exposure; None when the host stops; `TimeoutError` when none comes."""
        ...

    def close(self) -> None:
        """Let go of what the source holds."""
        ...


class FreeRun:
    """Exposures at the rate of the camera's own clock.

    Parameters
    ----------
    clock
        Host clock.
    period_ns
        Period in host time, the drift of the camera's clock included.
    queued
        Exposures that the camera keeps for a late host; older ones are overwritten and lost.
    """

    def __init__(self, clock: Clock, period_ns: float, queued: int = _QUEUED_EXPOSURES) -> None:
        self._clock = clock
        self._period_ns = period_ns
        self._queued = queued
        self._start_ns = -1
        self._number = 0

    def next(self, host: StreamHost) -> Exposure | None:
        """Wait for the camera's own clock."""
        if self._start_ns < 0:
            self._start_ns = self._clock.now_ns()
        late = int((self._clock.now_ns() - self._start_ns) / self._period_ns) - self._number
        if late > self._queued:
            self._number += late - self._queued
        due_ns = self._start_ns + round(self._number * self._period_ns)
        sleep_until(self._clock, due_ns, host)
        if host.stopping():
            return None
        self._number += 1
        return Exposure(self._number - 1, -1, due_ns)

    def close(self) -> None:
        """Nothing to let go of."""


class SoftwareTriggers:
    """Exposures at the calls of the camera's ``trigger``.

    Parameters
    ----------
    clock
        Host clock.
    timeout_s
        Longest wait for a call.
    """

    def __init__(self, clock: Clock, timeout_s: float) -> None:
        self._clock = clock
        self._timeout_s = timeout_s
        self._calls: deque[Exposure] = deque()
        self._number = 0

    def call(self, index: int) -> None:
        """Expose now."""
        self._calls.append(Exposure(self._number, index, self._clock.now_ns()))
        self._number += 1

    def next(self, host: StreamHost) -> Exposure | None:
        """Take the oldest call, waiting for one if need be."""
        deadline_ns = self._clock.now_ns() + round(self._timeout_s * NS_PER_S)
        while not self._calls:
            if host.stopping():
                return None
            if self._clock.now_ns() >= deadline_ns:
                raise TimeoutError(f"no trigger within {self._timeout_s:g} s")
            sleep_until(self._clock, self._clock.now_ns() + _POLL_NS, host)
        return self._calls.popleft()

    def close(self) -> None:
        """Forget calls not served."""
        self._calls.clear()


class LineTriggers:
    """Exposures at the pulses of a trigger line.

    Parameters
    ----------
    clock
        Host clock; in virtual time it advances to each pulse.
    line
        The line's reading end.
    timeout_s
        Longest wait for a pulse.
    queued
        Exposures that the camera keeps for a late host; in virtual time it is never late.
    is_missed
        Whether the camera overlooks the pulse of this index.
    """

    def __init__(
        self,
        clock: Clock,
        line: LineReader,
        timeout_s: float,
        queued: int = _QUEUED_EXPOSURES,
        is_missed: Callable[[int], bool] = lambda _: False,
    ) -> None:
        self._clock = clock
        self._line = line
        self._timeout_s = timeout_s
        self._queued = queued
        self._is_missed = is_missed
        self._number = 0

    def next(self, host: StreamHost) -> Exposure | None:
        """Wait for a pulse; after the last one of a session, until the host stops."""
        while True:
            pulse = self._next_pulse(host)
            if pulse is None or not self._is_missed(pulse[0]):
                break
        if pulse is None:
            return None
        self._number += 1
        return Exposure(self._number - 1, *pulse)

    def _next_pulse(self, host: StreamHost) -> tuple[int, int] | None:
        """Index and host time of the next pulse, once it is due."""
        # Real seconds in any case: in virtual time no time passes while nothing happens.
        deadline = time.monotonic() + self._timeout_s
        while self._line.waiting == 0:
            if host.stopping():
                return None
            if self._line.finished:
                sleep_until(self._clock, self._clock.now_ns() + _POLL_NS, host)
            elif time.monotonic() >= deadline:
                raise TimeoutError(f"no pulse on the trigger line within {self._timeout_s:g} s")
            time.sleep(_LINE_POLL_S)
        while not self._clock.is_virtual and self._line.waiting > self._queued:
            self._line.take()
            self._number += 1
        index, pulse_ns = self._line.take()
        self._clock.wait_until_ns(pulse_ns, host.stopping)
        return index, pulse_ns

    def close(self) -> None:
        """Let go of the line."""
        self._line.close()


def sleep_until(clock: Clock, due_ns: int, host: StreamHost) -> None:
    """Wait without spinning: simulated devices leave the processor to the recorder.

    In virtual time, advance to the deadline.
    """
    if clock.is_virtual:
        clock.wait_until_ns(due_ns, host.stopping)
    while (left_ns := due_ns - clock.now_ns()) > 0 and not host.stopping():
        time.sleep(min(left_ns, _POLL_NS) / NS_PER_S)
