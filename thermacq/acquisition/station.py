"""What every loop of a device process needs: the device's place on the board, its clock and its mail."""

from __future__ import annotations

import os
from dataclasses import dataclass

from thermacq.acquisition.board import Board, Cell, Order
from thermacq.acquisition.outbox import Outbox
from thermacq.store import Event, EventKind
from thermacq.timing import Clock


@dataclass
class Station:
    """One device's place in a recording."""

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
