"""When an emulated device acts: its own clock, and the exposures of a camera that it paces or a line paces."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from thermacq.timing.clock import NS_PER_S, Clock, VirtualClock
from thermacq.timing.trigger_line import LineReader

_POLL_S = 0.0005
_LONGEST_SLEEP_S = 0.02


def _never() -> bool:
    return False


class DeviceClock:
    """The clock inside a device, off by some ppm against the host's, at 0 when the device comes to life.

    Parameters
    ----------
    clock
        Host clock.
    ppm
        Positive is fast: a second of the device is shorter than one of the host.
    """

    def __init__(self, clock: Clock, ppm: float = 0.0) -> None:
        self.host = clock
        self._rate = 1 + ppm * 1e-6
        self.start_ns = clock.now_ns()
        if isinstance(clock, VirtualClock):
            # Virtual time begins anew with the recording; the device's own count goes on.
            clock.shifts.append(self._shift)

    def _shift(self, shift_ns: int) -> None:
        self.start_ns += shift_ns

    def ticks(self, host_ns: int, rate_hz: float) -> int:
        """Ticks of the device at a host time, counted at a nominal rate."""
        return int((host_ns - self.start_ns) * self._rate * rate_hz / NS_PER_S)

    def host_ns(self, ticks: int, rate_hz: float) -> int:
        """Host time at which the device's count reaches `ticks`."""
        return self.start_ns + round(ticks / rate_hz * NS_PER_S / self._rate)

    def host_interval_ns(self, device_s: float) -> float:
        """Host time that passes while the device counts so many seconds."""
        return device_s * NS_PER_S / self._rate


def wait_until(clock: Clock, due_ns: int, gone: Callable[[], bool] = _never) -> bool:
    """Sleep until a host time without spinning; in virtual time, advance to it. False when `gone` came first."""
    if clock.is_virtual:
        clock.wait_until_ns(due_ns, gone)
    while (left_ns := due_ns - clock.now_ns()) > 0 and not gone():
        time.sleep(min(left_ns / NS_PER_S, _LONGEST_SLEEP_S))
    return not gone()


@dataclass(frozen=True)
class Exposure:
    """One exposure: its number since the source was made, host time of its start, pulse of it (-1: none)."""

    number: int
    start_ns: int
    pulse: int = -1


class FreeRun:
    """Exposures by the camera's own clock.

    Parameters
    ----------
    clock
        The camera's clock.
    rate_hz
        Nominal frame rate.
    queued
        Exposures kept for a late host; older ones are lost, and missing from the numbers.
    """

    def __init__(self, clock: DeviceClock, rate_hz: float, queued: int = 3) -> None:
        self._host = clock.host
        self._period_ns = clock.host_interval_ns(1 / rate_hz)
        self._clock = clock
        self._offset_ns = self._host.now_ns() - clock.start_ns
        self._queued = queued
        self._number = 0

    def due_ns(self) -> int:
        """Host time of the next exposure; those that a late host lost are skipped."""
        first_ns = self._clock.start_ns + self._offset_ns
        late = int((self._host.now_ns() - first_ns) / self._period_ns) - self._number
        if not self._host.is_virtual and late > self._queued:
            self._number += late - self._queued
        return first_ns + round(self._number * self._period_ns)

    def next(self, timeout_s: float, gone: Callable[[], bool] = _never) -> Exposure | None:
        """Wait for the next exposure; None when it is further off than the timeout, or `gone` came first."""
        now_ns, due_ns = self._host.now_ns(), self.due_ns()
        if due_ns - now_ns > timeout_s * NS_PER_S:
            wait_until(self._host, now_ns + round(timeout_s * NS_PER_S), gone)
            return None
        if not wait_until(self._host, due_ns, gone):
            return None
        self._number += 1
        return Exposure(self._number - 1, due_ns)

    def close(self) -> None:
        """Nothing to let go of."""


class Slaved:
    """Exposures at the pulses of a trigger line, one for each.

    Parameters
    ----------
    clock
        The camera's clock.
    runtime_dir, line
        The trigger line.
    shortest_s
        The camera overlooks a pulse that comes sooner than this after the last one; 0 takes every pulse.
    queued
        As for `FreeRun`; in virtual time the host is never late.
    """

    def __init__(
        self, clock: DeviceClock, runtime_dir: Path, line: str, shortest_s: float = 0.0, queued: int = 3
    ) -> None:
        self._host = clock.host
        self._line = LineReader(runtime_dir, line)
        self._shortest_ns = clock.host_interval_ns(shortest_s)
        self._queued = queued
        self._number = 0
        self._last_ns: int | None = None

    def next(self, timeout_s: float, gone: Callable[[], bool] = _never) -> Exposure | None:
        """Wait for the next pulse; None when none comes within the timeout (real seconds), or `gone`."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            while self._line.waiting == 0:
                if gone() or time.monotonic() >= deadline_s:
                    return None
                time.sleep(_POLL_S)
            exposure = self._take()
            if exposure is not None:
                return exposure if wait_until(self._host, exposure.start_ns, gone) else None

    def _take(self) -> Exposure | None:
        late = not self._host.is_virtual and self._line.waiting > self._queued
        pulse, start_ns = self._line.take()
        if self._last_ns is not None and start_ns - self._last_ns < self._shortest_ns:
            return None
        self._last_ns = start_ns
        self._number += 1
        return None if late else Exposure(self._number - 1, start_ns, pulse)

    def close(self) -> None:
        """Let go of the line."""
        self._line.close()
