"""Scheduling of device processes: pinned to a core, raised above others around each trigger."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager

_FIFO_PRIORITY = 10
_NICENESS = -10


def pin(core: int | None) -> bool:
    """Keep this process on one core; return whether that was possible."""
    if core is None:
        return False
    try:
        os.sched_setaffinity(0, {core})
    except OSError:
        return False
    return True


def core_for(place: int) -> int | None:
    """A core for the camera at this place of the rig; None when there are fewer cores than two."""
    cores = sorted(os.sched_getaffinity(0))
    return cores[place % len(cores)] if len(cores) > 1 else None


class TriggerPriority:
    """Real-time priority around each trigger only, so that slow work in between starves nobody.

    Where real-time priority is not permitted the process is made less nice, where that is not permitted
    either it stays as it is; `name` says which.
    """

    def __init__(self) -> None:
        self.name = "normal"
        try:
            self._set(os.SCHED_FIFO, _FIFO_PRIORITY)
            self._set(os.SCHED_OTHER, 0)
            self.name = "fifo"
        except OSError:
            try:
                os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
                self.name = "nice"
            except OSError:
                pass

    @staticmethod
    def _set(policy: int, priority: int) -> None:
        os.sched_setscheduler(0, policy, os.sched_param(priority))

    @contextmanager
    def raised(self) -> Iterator[None]:
        """Raise the priority for the length of the block."""
        if self.name != "fifo":
            yield
            return
        self._set(os.SCHED_FIFO, _FIFO_PRIORITY)
        try:
            yield
        finally:
            self._set(os.SCHED_OTHER, 0)


def settle() -> None:
    """Take everything alive out of the garbage collector's sight: shorter pauses from here on."""
    gc.collect()
    gc.freeze()
