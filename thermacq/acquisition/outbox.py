"""A device's mail to the writer: events, samples and pulses through a pipe, without delaying a trigger."""

from __future__ import annotations

import select
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

_LONGEST = 10_000
_WAIT_S = 0.05


class Outbox:
    """Messages wait here until the pipe takes them.

    A pipe that is ready takes at least 4096 bytes, which every event and pulse fits; only blocks of
    samples may be longer, and a probe may wait. When the writer is gone, messages are thrown away:
    the recorder has noticed by itself.
    """

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._waiting: deque[Any] = deque()
        self._broken = False
        self.thrown_away = 0

    def post(self, message: Any) -> None:
        """Leave a message; returns at once. A full box throws away the message and counts it."""
        if len(self._waiting) >= _LONGEST:
            self.thrown_away += 1
            return
        self._waiting.append(message)
        self.send(0.0)

    def post_patiently(self, message: Any, stopping: Callable[[], bool]) -> None:
        """Leave a message and wait until all are sent: slows a producer that may be slowed."""
        self._waiting.append(message)
        while self._waiting and not stopping():
            self.send(_WAIT_S)

    def send(self, wait_s: float) -> None:
        """Send what the pipe takes, waiting for its readiness at most once."""
        while self._waiting and not self._broken:
            _, ready, _ = select.select([], [self._pipe.fileno()], [], wait_s)
            if not ready:
                return
            try:
                self._pipe.send(self._waiting.popleft())
            except OSError:
                self._broken = True
        if self._broken:
            self._waiting.clear()

    def close(self, patience_s: float) -> None:
        """Send the rest within about `patience_s`, then close: the end of the file tells the writer."""
        self.send(patience_s)
        self._pipe.close()
