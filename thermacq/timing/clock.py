"""The host clock that a recording runs on: real time, or a virtual time for simulated rigs.

Host time is an integer number of nanoseconds. On a real clock it is the monotonic clock, common to all
processes of a machine. On a virtual clock it counts from 0 at the start of the recording and advances
only by waiting, so that the same rig and seed give the same file on any machine, at any speed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

NS_PER_S = 1_000_000_000
_SLEEP_STEP_NS = 50_000_000
# Sleeping ends this long before a deadline; the rest is spun, because a sleeping process wakes up late.
_SPIN_NS = 2_000_000


def _never() -> bool:
    return False


class Clock(Protocol):
    """Host time as devices and recorder see it."""

    @property
    def is_virtual(self) -> bool:
        """Whether time advances only by waiting."""
        ...

    def start(self) -> None:
        """Recording begins: virtual time is 0 now; real time takes no notice."""
        ...

    def now_ns(self) -> int:
        """Host time now, in nanoseconds."""
        ...

    def wait_until_ns(self, deadline_ns: int, stopping: Callable[[], bool] = _never) -> int:
        """Wait for a deadline, or until `stopping` says so, and return the host time reached."""
        ...


@dataclass(frozen=True)
class ClockSettings:
    """How to make the clock of a recording; travels to every process.

    Parameters
    ----------
    kind
        ``real`` or ``virtual``.
    speed
        Virtual clock only: virtual seconds per real second; 0 runs as fast as the machine can.
    """

    kind: Literal["real", "virtual"] = "real"
    speed: float = 0.0


class RealClock:
    """The machine's monotonic clock."""

    is_virtual = False

    def start(self) -> None:
        """Real time has no start."""

    def now_ns(self) -> int:
        """Host time now, in nanoseconds."""
        return time.perf_counter_ns()

    def wait_until_ns(self, deadline_ns: int, stopping: Callable[[], bool] = _never) -> int:
        """Sleep until shortly before the deadline, then spin: late by tens of nanoseconds when idle."""
        while (now := time.perf_counter_ns()) < deadline_ns - _SPIN_NS:
            if stopping():
                return now
            time.sleep(min(_SLEEP_STEP_NS, deadline_ns - _SPIN_NS - now) / NS_PER_S)
        while (now := time.perf_counter_ns()) < deadline_ns:
            pass
        return now


class VirtualClock:
    """A clock of its own for each process, advanced by waiting; optionally paced by real time."""

    is_virtual = True

    def __init__(self, speed: float = 0.0) -> None:
        self._speed = speed
        # Called with `stopping` before time passes: what is still under way in other threads ends first.
        self.holds: list[Callable[[Callable[[], bool]], None]] = []
        # Called with the shift when time is set to 0: times kept from before are moved by it.
        self.shifts: list[Callable[[int], None]] = []
        self._now_ns = 0
        self.start()

    def start(self) -> None:
        """Set virtual time to 0; pacing by real time counts from here."""
        for shift in tuple(self.shifts):
            shift(-self._now_ns)
        self._now_ns = 0
        self._real_start_ns = time.perf_counter_ns()

    def now_ns(self) -> int:
        """Virtual time now, in nanoseconds since the start of the recording."""
        return self._now_ns

    def wait_until_ns(self, deadline_ns: int, stopping: Callable[[], bool] = _never) -> int:
        """Advance to the deadline; with a speed, not before real time has caught up."""
        for hold in tuple(self.holds):
            hold(stopping)
        while self._speed > 0 and not stopping():
            ahead_ns = deadline_ns / self._speed - (time.perf_counter_ns() - self._real_start_ns)
            if ahead_ns <= 0:
                break
            time.sleep(min(_SLEEP_STEP_NS, ahead_ns) / NS_PER_S)
        self._now_ns = max(self._now_ns, deadline_ns)
        return self._now_ns


def make_clock(settings: ClockSettings) -> Clock:
    """Make the clock that the settings describe, in the process that will use it."""
    return VirtualClock(settings.speed) if settings.kind == "virtual" else RealClock()
