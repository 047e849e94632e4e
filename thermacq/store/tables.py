"""Rows on their way into a run file: waiting in memory, written, then committed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from thermacq.store import operations
from thermacq.store.records import CameraStream

if TYPE_CHECKING:
    import h5py


class Table:
    """Columns that grow together: rows wait in memory, are written, then committed."""

    def __init__(self, columns: Sequence[h5py.Dataset], committed: h5py.Dataset) -> None:
        self._columns = columns
        self._committed = committed
        self._waiting: list[tuple[Any, ...]] = []
        self.committed = 0

    def append(self, *values: Any) -> None:
        """Add a row that waits: one value per column."""
        self._waiting.append(values)

    @property
    def rows(self) -> int:
        """Rows committed and waiting."""
        return self.committed + len(self._waiting)

    def write(self) -> None:
        """Write the waiting rows behind the committed ones; may be repeated after a failure."""
        if self._waiting:
            for column, values in zip(self._columns, zip(*self._waiting, strict=True), strict=True):
                operations.write_rows(column, self.committed, values)

    def commit(self) -> None:
        """Count the written rows in, once they are flushed."""
        if self._waiting:
            operations.write_value(self._committed, self.rows)
            self.committed = self.rows
            self._waiting.clear()


class CameraSink:
    """Where the frames of one camera go."""

    def __init__(self, stream: CameraStream, data: h5py.Dataset, table: Table) -> None:
        self.stream = stream
        self.data = data
        self.table = table
        self._counter_bits = int(stream.capabilities.get("counter_bits", 0))
        self._last_counter = -1
        self._sequence = 0

    def next_sequence_number(self, counter: int, restarted: bool = False) -> int:
        """Counter without its wraps; a step back of less than half the range stays a step back.

        A counter that began anew, because the camera had been away, goes on from the last number.
        """
        if counter < 0:
            self._sequence = self.table.rows
        elif restarted and self.table.rows:
            self._sequence += 1
        elif self._last_counter < 0 or self._counter_bits == 0:
            self._sequence = counter
        else:
            half = 1 << (self._counter_bits - 1)
            self._sequence += (counter - self._last_counter + half) % (2 * half) - half
        self._last_counter = counter
        return self._sequence
