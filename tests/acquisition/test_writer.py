"""The writer's loop in this process, fed by hand."""

import multiprocessing
from pathlib import Path

import numpy as np
import pytest

from thermacq.acquisition.board import Board, Cell
from thermacq.acquisition.messages import CreateOrder, DiskReserve, EndReason, FinishOrder, Pulse, Samples
from thermacq.acquisition.ring import FrameRing, ring_bytes
from thermacq.acquisition.shared import SharedBlock
from thermacq.acquisition.writer import Drain
from thermacq.devices import SampleBlock, TriggerMode
from thermacq.errors import StoreError
from thermacq.rig import StoreTable
from thermacq.store import (
    CameraStream,
    Event,
    EventKind,
    ProbeStream,
    RunHeader,
    RunWriter,
    open_run,
)

ROWS, COLUMNS, SLOTS = 16, 24, 40
NAMES = ["left", "right", "wp", "box"]


class Feed:
    """What the devices and the recorder do: rings, mail, orders."""

    def __init__(self, path: Path, mode: TriggerMode = TriggerMode.SOFTWARE) -> None:
        self.board = Board(len(NAMES))
        self.rings, blocks = {}, {}
        for name in NAMES[:2]:
            blocks[name] = SharedBlock()
            blocks[name].allocate(ring_bytes(ROWS, COLUMNS, SLOTS))
            self.rings[name] = FrameRing(blocks[name], ROWS, COLUMNS, SLOTS)
        pipes = {name: multiprocessing.Pipe(duplex=False) for name in NAMES}
        self.mail = {name: out for name, (_, out) in pipes.items()}
        self.recorder, theirs = multiprocessing.Pipe()
        header = RunHeader("id", "", "2024-01-01T00:00:00Z", 0, 0, "real", True, {"cameras": {}})
        order = CreateOrder(
            path,
            header,
            tuple(CameraStream(name, ROWS, COLUMNS) for name in NAMES[:2]),
            (ProbeStream("wp", ("a",), "V", 1000.0),),
            StoreTable(reserve_mb=0),
            SLOTS,
            mode,
        )
        self.run = RunWriter.create(path, header, order.cameras, order.probes, order.store)
        inboxes = {name: inbox for name, (inbox, _) in pipes.items()}
        self.drain = Drain(self.run, order, NAMES, self.board, blocks, inboxes, theirs)
        self._ends = [self.recorder, theirs, *inboxes.values(), *self.mail.values()]
        self._blocks = blocks

    def frame(self, camera: str, index: int, trigger_ns: int = -1) -> None:
        counts = self.rings[camera].claim()
        assert counts is not None
        counts[:] = index
        self.rings[camera].publish((index, -1, 1000 * index, index, trigger_ns, 0, float("nan")))

    def devices_end(self) -> None:
        for pipe in self.mail.values():
            pipe.close()

    def close(self) -> None:
        self.drain.close()
        for item in (*self._ends, *self._blocks.values(), self.board):
            item.close()


@pytest.fixture
def feed(tmp_path: Path, request: pytest.FixtureRequest):
    made = Feed(tmp_path / "run.h5", getattr(request, "param", TriggerMode.SOFTWARE))
    yield made
    made.close()


def test_everything_that_was_delivered_is_written(feed: Feed, tmp_path: Path) -> None:
    for index in range(SLOTS):
        feed.frame("left", index, 1000 * index)
        if index != 3:
            feed.frame("right", index, 1000 * index + 50)
    block = SampleBlock(np.arange(5.0)[:, None], np.arange(5), 0, 99, np.array([2]))
    feed.mail["wp"].send(Samples(block))
    feed.mail["left"].send(Event(5, "left", EventKind.DEVICE_GAP, 7, "gone"))
    feed.devices_end()
    feed.recorder.send(Event(6, "wp", EventKind.TIMEOUT, -1, "late news"))
    feed.recorder.send(FinishOrder(EndReason.STOPPED, "enough", {"more": 1}))
    feed.drain.empty_everything()
    summary = feed.drain.finish()
    assert summary["more"] == 1
    assert summary["sync"]["pairs"] == SLOTS - 1
    assert summary["sync"]["skew_ns"]["max"] == 50
    assert summary["events"] == {"device_gap": 1, "timeout": 1, "stopped": 1}
    with open_run(tmp_path / "run.h5") as run:
        assert run.complete
        assert run.frame_count("left") == SLOTS
        assert run.frame_count("right") == SLOTS - 1
        assert np.all(run.counts("left", 11) == 11)
        assert run.probe("wp").pulse_ticks.tolist() == [2]
        assert [event.detail for event in run.events()] == ["gone", "late news", "enough"]
    assert feed.board.get(0, Cell.WRITTEN) == SLOTS
    assert feed.rings["left"].filled == 0


def test_a_lost_recorder_does_not_keep_the_file_open(feed: Feed, tmp_path: Path) -> None:
    feed.frame("left", 0)
    feed.devices_end()
    feed.recorder.close()
    feed.drain.empty_everything()
    assert feed.drain.finish()["end_reason"] == "recorder_lost"
    with open_run(tmp_path / "run.h5") as run:
        assert run.complete
        assert run.frame_count("left") == 1


@pytest.mark.parametrize("feed", [TriggerMode.HARDWARE], indirect=True)
def test_frames_get_the_time_of_their_pulse_even_when_its_news_is_late(feed: Feed, tmp_path: Path) -> None:
    for index in range(3):
        feed.frame("left", index)
    # Pulse 1 is never told; pulses 0 and 2 are, after their frames.
    for index in (0, 2):
        feed.mail["box"].send(Pulse(index, 500 + index))
    feed.devices_end()
    feed.recorder.send(FinishOrder(EndReason.COMPLETED, ""))
    feed.drain.empty_everything()
    assert feed.drain.finish()["pulses"] == 2
    with open_run(tmp_path / "run.h5") as run:
        assert run.frames("left").trigger_ns.tolist() == [500, -1, 502]


def test_the_reserve_of_the_disk_is_told_once(feed: Feed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RunWriter, "disk_reserve_reached", property(lambda _: True))
    monkeypatch.setattr("thermacq.acquisition.writer._DISK_CHECK_S", 0.0)
    feed.frame("left", 0)
    feed.frame("left", 1)
    feed.devices_end()
    feed.recorder.send(FinishOrder(EndReason.DISK_RESERVE, "full"))
    feed.drain.empty_everything()
    assert feed.drain.finish()["events"]["disk_reserve"] == 1
    assert isinstance(feed.recorder.recv(), DiskReserve)
    assert not feed.recorder.poll(0)


def test_a_failing_disk_ends_the_writing_and_says_what_is_safe(
    feed: Feed, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("thermacq.store.operations.write_chunk", fail)
    feed.frame("left", 0)
    with pytest.raises(StoreError, match="failed") as caught:
        feed.drain.empty_everything()
    assert "safe" in caught.value.kept


def test_slow_writes_are_events(feed: Feed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("thermacq.acquisition.writer._LATE_WRITE_S", -1.0)
    feed.frame("left", 0)
    feed.devices_end()
    feed.recorder.send(FinishOrder(EndReason.COMPLETED, ""))
    feed.drain.empty_everything()
    assert feed.drain.finish()["events"]["writer_late"] >= 1
