"""A simulated trigger line: a memory-mapped file into which a source writes the times of its pulses.

The file is append-only: a pulse's time first, then the count, so that a reader never sees half a pulse. A
source starts a new session each time it is armed; a reader that is armed before its source gets the pulses
of the next session. Readers note how far they are, so that in virtual time a source cannot run away.
"""

from __future__ import annotations

import fcntl
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

CAPACITY: Final = 4_000_000
"""Pulses in the life of one line; the file is sparse."""

_HEADER: Final = 16
_COUNT, _SESSION, _FINISHED, _BASE = range(4)
_SLOTS: Final = range(4, _HEADER)  # readers: how many pulses each has taken, plus 1; 0 is a free slot


def _map_line(runtime_dir: Path, name: str) -> tuple[Path, NDArray[np.int64]]:
    """Map the file of a line, made on first use."""
    path = runtime_dir / f"{name}.line"
    with path.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        if file.tell() == 0:
            file.truncate((_HEADER + CAPACITY) * 8)
    return path, np.memmap(path, np.int64, "r+", shape=(_HEADER + CAPACITY,))


class LineWriter:
    """The source's end of a line.

    Parameters
    ----------
    runtime_dir
        Directory shared by the devices of a recording.
    name
        Name of the line.
    """

    def __init__(self, runtime_dir: Path, name: str) -> None:
        _, self._words = _map_line(runtime_dir, name)

    def start_session(self) -> None:
        """Begin a new series of pulses, counted from 0."""
        self._words[_BASE] = self._words[_COUNT]
        self._words[_SESSION] += 1

    def emit(self, host_ns: int) -> None:
        """Write one pulse; raises `OverflowError` when the line's file is full."""
        count = int(self._words[_COUNT])
        if count >= CAPACITY:
            raise OverflowError(f"the simulated trigger line holds {CAPACITY} pulses and is full")
        self._words[_HEADER + count] = host_ns
        self._words[_COUNT] = count + 1

    def finish_session(self) -> None:
        """Say that no more pulses come in this session."""
        self._words[_FINISHED] = self._words[_SESSION]

    def lead(self) -> int:
        """Pulses by which the line is ahead of its slowest reader; 0 without readers."""
        taken = self._words[_SLOTS.start : _SLOTS.stop]
        readers = taken[taken > 0]
        return int(self._words[_COUNT] - (readers.min() - 1)) if readers.size else 0


class LineReader:
    """A follower's end of a line, from the pulse after the last one emitted; `close` gives its slot back.

    Parameters
    ----------
    runtime_dir, name
        As for `LineWriter`.
    """

    def __init__(self, runtime_dir: Path, name: str) -> None:
        path, self._words = _map_line(runtime_dir, name)
        words = self._words
        self._next = int(words[_COUNT])
        running = words[_SESSION] > words[_FINISHED]
        self._session = int(words[_SESSION]) + (0 if running else 1)
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            free = [slot for slot in _SLOTS if words[slot] == 0]
            self._slot = free[0] if free else None
            self._note()

    def _note(self) -> None:
        if self._slot is not None:
            self._words[self._slot] = self._next + 1

    @property
    def waiting(self) -> int:
        """Pulses on the line that were not taken yet."""
        return int(self._words[_COUNT]) - self._next

    @property
    def finished(self) -> bool:
        """Whether all pulses of the session were taken and no more will come."""
        over = int(self._words[_FINISHED]) >= self._session
        return over and self.waiting == 0

    def peek_ns(self) -> int:
        """Host time of the next pulse; only while `waiting`."""
        return int(self._words[_HEADER + self._next])

    def take(self) -> tuple[int, int]:
        """Index in the session and host time of the next pulse; only while `waiting`."""
        pulse = self._next - int(self._words[_BASE]), self.peek_ns()
        self._next += 1
        self._note()
        return pulse

    def close(self) -> None:
        """Let go of the line; a source need not wait for this reader any more."""
        if self._slot is not None:
            self._words[self._slot] = 0
            self._slot = None
