"""The writer process: empties the rings, compresses in a few threads, writes and commits the run file.

It ends by itself when every device has closed its mail and every ring is empty, or earlier when the disk
fails. When the recorder dies it still closes the file properly.
"""

from __future__ import annotations

import signal
import time
from collections import Counter, deque
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from multiprocessing.connection import Connection, wait
from typing import Any, TypeAlias

from thermacq.acquisition.board import Board, Cell
from thermacq.acquisition.logbook import FrameLog, ProbeLog, PulseLog, summarise_sync
from thermacq.acquisition.messages import (
    Created,
    CreateOrder,
    DiskReserve,
    EndReason,
    FinishOrder,
    Pulse,
    Samples,
    WriterEnded,
)
from thermacq.acquisition.ring import FrameRing
from thermacq.acquisition.shared import SharedBlock
from thermacq.devices import Counts, TriggerMode
from thermacq.errors import StoreError
from thermacq.store import Compression, Event, EventKind, FrameRow, RunWriter, encode_frame, frame_crc32
from thermacq.timing import NS_PER_S

COMPRESSION_THREADS = 2
_IN_FLIGHT = 8
_MAIL_S = 0.005
_IDLE_POLL_S = 0.005
_DISK_CHECK_S = 0.1
_LATE_WRITE_S = 0.5
_PULSE_PATIENCE_S = 0.25

Mail: TypeAlias = dict[str, Connection]


def writer_main(
    names: list[str], board: Board, blocks: dict[str, SharedBlock], mail: Mail, recorder: Connection
) -> None:
    """Write one run; the target of a spawned process.

    Parameters
    ----------
    names
        All devices, in the order of the board.
    board
        Counts shared by the recording.
    blocks
        Memory of the rings, by camera; allocated before `CreateOrder` comes.
    mail
        Pipes from the devices, by device.
    recorder
        Pipe to the recorder: `CreateOrder`, `FinishOrder` in; `Created`, `DiskReserve`, `WriterEnded` out.
    """
    # Ctrl-C is the recorder's business.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        order: CreateOrder = recorder.recv()
    except EOFError:
        return
    try:
        run = RunWriter.create(
            order.path, order.header, order.cameras, order.probes, order.store, order.corrections
        )
    except StoreError as error:
        recorder.send(WriterEnded({}, error))
        return
    recorder.send(Created())
    outcome = _write(Drain(run, order, names, board, blocks, mail, recorder))
    with suppress(OSError):
        recorder.send(outcome)


def _write(drain: Drain) -> WriterEnded:
    try:
        drain.empty_everything()
        return WriterEnded(drain.finish())
    except StoreError as error:
        return WriterEnded({}, error)
    finally:
        drain.close()


class Drain:
    """Takes everything that the devices deliver into the run file."""

    def __init__(
        self,
        run: RunWriter,
        order: CreateOrder,
        names: list[str],
        board: Board,
        blocks: dict[str, SharedBlock],
        mail: Mail,
        recorder: Connection,
    ) -> None:
        self._run = run
        self._order = order
        self._names = names
        self._board = board
        self._mail = dict(mail)
        self._senders = {pipe: name for name, pipe in mail.items()}
        self._recorder = recorder
        self._last_word: FinishOrder | None = None
        self._cameras = {camera.name: (camera, FrameLog()) for camera in order.cameras}
        self._probes = {probe.name: (probe, ProbeLog()) for probe in order.probes}
        self._pulses = PulseLog()
        self._held_since: float | None = None
        self._rings = {
            camera.name: FrameRing(blocks[camera.name], camera.rows, camera.columns, order.slots)
            for camera in order.cameras
        }
        self._threads = ThreadPoolExecutor(COMPRESSION_THREADS)
        self._in_flight: deque[tuple[str, FrameRow, Future[tuple[bytes, int]]]] = deque()
        self._submitted = dict.fromkeys(self._rings, 0)
        self._events: Counter[str] = Counter()
        self._flushed_s = self._disk_checked_s = time.monotonic()
        self._mail_read_s = self._flushed_s
        self._reserve_told = False
        self._slowest = {"write_s": 0.0, "flush_s": 0.0}

    def empty_everything(self) -> None:
        """Write until all devices have ended and nothing is left; raises `StoreError`."""
        while True:
            # Asked before looking into the rings: what an ended device left there is then seen.
            all_ended = not self._mail
            busy = self._submit() | self._write_oldest()
            now = time.monotonic()
            # Looking into the mail costs as much as writing a frame.
            if not busy or now - self._mail_read_s > _MAIL_S:
                self._mail_read_s = now
                self._read_mail(0.0 if busy else _IDLE_POLL_S)
            self._keep_house()
            if all_ended and not busy and not self._in_flight:
                return

    def finish(self) -> dict[str, Any]:
        """Wait for the recorder's last word, close the run and return its summary; raises `StoreError`."""
        while self._last_word is None:
            self._hear_recorder()
        order = self._last_word
        if order.message:
            self._append_event(Event(self._latest_ns(), "recorder", EventKind.STOPPED, -1, order.message))
        self._run.flush()
        self._tell_board()
        summary = {
            **order.summary,
            "end_reason": order.end_reason.value,
            "message": order.message,
            "sync": {**self._sync_report(), "outages": list(order.outages)},
            "events": dict(self._events),
            "pulses": int(self._pulses.host_ns.size),
            "writer": {name: round(value, 4) for name, value in self._slowest.items()},
        }
        self._run.finish(
            summary, order.end_reason.value, datetime.now(UTC).isoformat(timespec="milliseconds")
        )
        return summary

    def close(self) -> None:
        """Let go of file and threads, however it ended."""
        self._threads.shutdown(wait=True, cancel_futures=True)
        self._run.close()

    def _submit(self) -> bool:
        """Hand new frames to the compressing threads, one from each ring in turn."""
        submitted = False
        progress = True
        while progress:
            progress = False
            for name, ring in self._rings.items():
                item = ring.peek(self._submitted[name]) if len(self._in_flight) < _IN_FLIGHT else None
                if item is not None:
                    counts, meta = item
                    work = self._threads.submit(_encode, counts, self._order.store.compression)
                    self._in_flight.append((name, FrameRow(*meta.item()), work))
                    self._submitted[name] += 1
                    progress = submitted = True
        return submitted

    def _write_oldest(self) -> bool:
        """Write the oldest frame in flight, once it is compressed and its trigger known."""
        if not self._in_flight or not self._trigger_known(self._in_flight[0][1]):
            return False
        name, row, work = self._in_flight.popleft()
        encoded, crc32 = work.result()
        began = time.monotonic()
        self._run.append_encoded(name, encoded, row, crc32)
        self._note_duration("write_s", began)
        self._rings[name].release()
        self._submitted[name] -= 1
        self._cameras[name][1].note(row)
        return True

    def _trigger_known(self, row: FrameRow) -> bool:
        """Give a frame the time of its pulse; wait a little for news of a pulse that is still on its way."""
        if self._order.mode is not TriggerMode.HARDWARE or row.trigger_index < 0:
            return True
        row.trigger_ns = self._pulses.time_of(row.trigger_index)
        if row.trigger_ns < 0 and row.trigger_index > self._pulses.latest:
            self._held_since = self._held_since or time.monotonic()
            if time.monotonic() - self._held_since < _PULSE_PATIENCE_S:
                return False
        self._held_since = None
        return True

    def _read_mail(self, timeout_s: float) -> None:
        pipes = list(self._mail.values())
        if self._last_word is None:
            pipes.append(self._recorder)
        for pipe in wait(pipes, timeout_s):
            if pipe is self._recorder:
                self._hear_recorder()
                continue
            name = self._senders[pipe]  # type: ignore[index]
            try:
                self._take_message(name, self._mail[name].recv())
            # The device has ended, or was killed in the middle of a message.
            except (EOFError, OSError):
                self._mail.pop(name).close()

    def _hear_recorder(self) -> None:
        """Events of devices that cannot tell them any more, and the last word."""
        try:
            message = self._recorder.recv()
        except (EOFError, OSError):
            message = FinishOrder(EndReason.RECORDER_LOST, "the recorder process was lost")
        if isinstance(message, FinishOrder):
            self._last_word = message
        elif isinstance(message, Event):
            self._append_event(message)

    def _take_message(self, name: str, message: object) -> None:
        if isinstance(message, Event):
            self._append_event(message)
            if message.kind is EventKind.RECONNECTED and name in self._probes:
                self._probes[name][1].restarts_ns.append(message.host_ns)
        elif isinstance(message, Samples):
            block = message.block
            self._run.append_samples(
                name, block.values, block.ticks, block.first_index, block.host_ns, block.pulse_ticks
            )
            self._probes[name][1].note(block)
        elif isinstance(message, Pulse):
            self._pulses.note(message.index, message.host_ns)

    def _append_event(self, event: Event) -> None:
        self._run.append_event(event)
        self._events[event.kind.value] += 1

    def _keep_house(self) -> None:
        """Commit, look after the disk, tell the board."""
        now = time.monotonic()
        if now - self._flushed_s >= self._order.store.flush_interval_s:
            self._run.flush()
            self._note_duration("flush_s", now)
            self._flushed_s = time.monotonic()
            self._tell_board()
        if now - self._disk_checked_s >= _DISK_CHECK_S:
            self._disk_checked_s = now
            if self._run.disk_reserve_reached and not self._reserve_told:
                self._reserve_told = True
                detail = f"less than {self._order.store.reserve_mb:.0f} MB are free"
                self._append_event(Event(self._latest_ns(), "disk", EventKind.DISK_RESERVE, -1, detail))
                with suppress(OSError):
                    self._recorder.send(DiskReserve())

    def _note_duration(self, what: str, began_s: float) -> None:
        took_s = time.monotonic() - began_s
        self._slowest[what] = max(self._slowest[what], took_s)
        if took_s > _LATE_WRITE_S:
            detail = f"a {what.removesuffix('_s')} took {took_s:.2f} s"
            self._append_event(Event(self._latest_ns(), "writer", EventKind.WRITER_LATE, -1, detail))

    def _tell_board(self) -> None:
        for name, ring in self._rings.items():
            index = self._names.index(name)
            self._board.put(index, Cell.WRITTEN, self._run.committed(name))
            self._board.put(index, Cell.RING_FILLED, ring.filled)

    def _latest_ns(self) -> int:
        """Host time of the latest news: what a process without a virtual clock can know of time."""
        return max(self._board.get(index, Cell.LAST_HOST_NS) for index in range(len(self._names)))

    def _sync_report(self) -> dict[str, Any]:
        counts = {}
        for index, name in enumerate(self._names):
            counts[name] = {
                "received": self._board.get(index, Cell.RECEIVED),
                "lost": self._board.losses(index),
            }
            if name in self._rings:
                counts[name]["written"] = self._run.committed(name)
        header = self._order.header
        reckoned_ns = NS_PER_S / header.rig["trigger"]["frame_rate_hz"] if header.triggers_reckoned else None
        return summarise_sync(
            self._order.mode,
            header.clock == "virtual",
            self._cameras,
            self._probes,
            self._pulses,
            counts,
            reckoned_ns,
        )


def _encode(counts: Counts, compression: Compression) -> tuple[bytes, int]:
    return encode_frame(counts, compression), frame_crc32(counts)
