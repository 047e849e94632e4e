"""The loops of a device process, run in this process with devices that do exactly what a test says."""

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from thermacq.acquisition.board import Board, Cell, Order
from thermacq.acquisition.camera_loop import CameraLoop
from thermacq.acquisition.lifeline import Lifeline
from thermacq.acquisition.messages import ArmOrder, Opened, Samples
from thermacq.acquisition.ring import FrameRing, ring_bytes
from thermacq.acquisition.ring_host import RingHost
from thermacq.acquisition.shared import SharedBlock
from thermacq.acquisition.station import Station
from thermacq.acquisition.streams import ProbeLoop, check_block
from thermacq.devices import (
    CameraCapabilities,
    DeviceIdentity,
    Frame,
    FrameFlag,
    ProbeCapabilities,
    SampleBlock,
    TriggerMode,
)
from thermacq.errors import DeviceFault, DeviceOverrun, IncompleteFrame
from thermacq.rig import ReconnectTable
from thermacq.store import Event
from thermacq.timing import VirtualClock

SIZE = (2, 4)


class Mail:
    """Outbox that keeps what is posted."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def post(self, message: Any) -> None:
        self.messages.append(message)

    def post_patiently(self, message: Any, stopping: Any) -> None:
        self.messages.append(message)

    @property
    def events(self) -> list[tuple[str, int]]:
        return [(item.kind.value, item.index) for item in self.messages if isinstance(item, Event)]


class HurriedClock(VirtualClock):
    """Real time as far as the loop can see, and late at chosen waits."""

    is_virtual = False

    def __init__(self, late: dict[int, int]) -> None:
        super().__init__()
        self.waits = 0
        self.late = late

    def wait_until_ns(self, deadline_ns: int, stopping: Any = None) -> int:
        reached = super().wait_until_ns(deadline_ns + self.late.get(self.waits, 0))
        self.waits += 1
        return reached


class ScriptedCamera:
    """Yields what a script says: counters, or faults to raise."""

    capabilities = CameraCapabilities(*SIZE, 16, 1000.0, frozenset(TriggerMode), counter_bits=8)

    def __init__(self, script: list[Any], clock: VirtualClock) -> None:
        self.script = list(script)
        self.clock = clock
        self.triggers: list[int] = []

    def trigger(self, index: int) -> None:
        self.triggers.append(index)

    def frames(self, host: RingHost) -> Iterator[Frame]:
        while self.script and not host.stopping():
            step = self.script.pop(0)
            if isinstance(step, Exception):
                raise step
            if isinstance(step, Frame):
                yield step
            else:
                counts = host.buffer()
                counts[:] = step
                yield Frame(counts, step, -1, self.clock.now_ns())


def no_way_back(device: Any, station: Station) -> Lifeline:
    """For devices that are lost for good with their first fault."""
    opened = Opened(DeviceIdentity("scripted", "scripted", "1"), {}, device.capabilities)
    return Lifeline(device, station, ReconnectTable(policy="fail"), {}, opened, lambda _: None)


class Bench:
    """A camera loop with its surroundings."""

    def __init__(self, script: list[Any], clock: VirtualClock, slots: int = 16, **order: Any) -> None:
        self.board = Board(1)
        self.mail = Mail()
        self.station = Station("cam", 0, self.board, clock, self.mail, os.getppid())  # type: ignore[arg-type]
        block = SharedBlock()
        block.allocate(ring_bytes(*SIZE, slots))
        self.ring = FrameRing(block, *SIZE, slots)
        block.close()
        self.host = RingHost(self.station, self.ring, np.zeros(SIZE, np.uint16))
        self.camera = ScriptedCamera(script, clock)
        given = {
            "mode": TriggerMode.FREE_RUN,
            "rate_hz": 100.0,
            "count": None,
            "end_ns": None,
            "late_after_ns": 1_000_000,
            "slots": slots,
        }
        self.loop = CameraLoop(
            self.camera,
            self.station,
            self.host,
            ArmOrder(**given | order),
            None,
            no_way_back(self.camera, self.station),
        )  # type: ignore[arg-type]

    def run(self) -> None:
        self.loop.run(0)

    def written(self) -> list[tuple[int, int, int]]:
        """(counter, trigger index, trigger time) of the frames in the ring."""
        frames = []
        while (item := self.ring.peek()) is not None:
            counts, meta = item
            assert np.all(counts == meta["counter"])
            frames.append((int(meta["counter"]), int(meta["trigger_index"]), int(meta["trigger_ns"])))
            self.ring.release()
        return frames


def test_software_triggers_come_at_absolute_deadlines() -> None:
    bench = Bench([0, 1, 2], VirtualClock(), mode=TriggerMode.SOFTWARE, count=3)
    bench.run()
    assert bench.written() == [(0, 0, 0), (1, 1, 10_000_000), (2, 2, 20_000_000)]
    assert bench.mail.events == []


def test_a_late_trigger_is_skipped_recorded_and_never_caught_up() -> None:
    # The second wait ends 25 ms late: triggers 1, 2 and 3 are missed, trigger 4 is on time again.
    clock = HurriedClock({1: 25_000_000})
    bench = Bench([0, 1, 2], clock, mode=TriggerMode.SOFTWARE, count=6)
    bench.run()
    assert bench.camera.triggers == [0, 4, 5]
    assert [(index, fired) for _, index, fired in bench.written()] == [
        (0, 0),
        (4, 40_000_000),
        (5, 50_000_000),
    ]
    assert bench.mail.events == [("late_trigger", 1), ("late_trigger", 2), ("late_trigger", 3)]
    assert bench.board.losses(0) == {"late_trigger": 3}


def test_a_full_ring_costs_frames_that_are_counted_and_told_once() -> None:
    bench = Bench(list(range(7)), HurriedClock({}), slots=3, count=7)
    bench.run()
    assert [counter for counter, _, _ in bench.written()] == [0, 1, 2]
    assert bench.board.losses(0) == {"ring_full": 4}
    assert bench.board.get(0, Cell.RECEIVED) == 7
    assert bench.mail.events == [("ring_full", 3)]
    assert "4 frames" in bench.mail.messages[0].detail


def test_virtual_time_waits_for_room_until_told_to_stop() -> None:
    bench = Bench(list(range(7)), VirtualClock(), slots=3, count=7)
    original = bench.ring.claim
    refused = []

    def claim() -> Any:
        counts = original()
        if counts is None:
            refused.append(1)
            if len(refused) == 3:
                bench.ring.release()
            if len(refused) > 5:
                bench.board.give(Order.STOP)
        return counts

    bench.ring.claim = claim  # type: ignore[method-assign]
    bench.run()
    assert bench.ring.filled == 3
    assert len(refused) > 5
    assert bench.ring.peek(2)[1]["counter"] == 3


def test_the_same_buffer_is_handed_out_until_it_is_delivered() -> None:
    bench = Bench([], VirtualClock())
    assert bench.host.buffer() is bench.host.buffer()


def test_gaps_of_the_counter_are_counted_across_its_wrap() -> None:
    bench = Bench([253, 254, 1, 2], VirtualClock(), count=4)
    bench.run()
    assert bench.board.losses(0) == {"device_gap": 2}
    assert bench.mail.events == [("device_gap", -1)]


def test_a_loss_that_a_fault_announced_is_not_counted_twice() -> None:
    bench = Bench([0, IncompleteFrame("cam", "acquire", "short"), 2, 5], VirtualClock(), count=3)
    bench.run()
    assert bench.board.losses(0) == {"incomplete": 1, "device_gap": 2}


def test_the_gap_after_an_overrun_is_its_size() -> None:
    bench = Bench([0, DeviceOverrun("cam", "acquire", "host late"), 8, 9], VirtualClock(), count=3)
    bench.run()
    assert bench.board.losses(0) == {"overrun": 7}


def test_a_counter_that_goes_back_is_told_and_not_counted_as_loss() -> None:
    bench = Bench([100, 7], VirtualClock(), count=2)
    bench.run()
    assert bench.board.losses(0) == {}
    assert [kind for kind, _ in bench.mail.events] == ["note"]


def test_shutter_and_damage_are_events() -> None:
    def frame(counter: int, flags: FrameFlag) -> Frame:
        return Frame(np.full(SIZE, counter, np.uint16), counter, -1, 0, flags=flags)

    script = [frame(0, FrameFlag.NONE), frame(1, FrameFlag.SHUTTER), frame(2, FrameFlag.SHUTTER)]
    bench = Bench([*script, frame(3, FrameFlag.INCOMPLETE)], VirtualClock(), count=4)
    bench.run()
    assert [kind for kind, _ in bench.mail.events] == ["shutter", "incomplete"]
    assert [counter for counter, _, _ in bench.written()] == [0, 1, 2, 3]


def test_a_stream_that_ends_unasked_is_a_fault() -> None:
    bench = Bench([0], VirtualClock(), count=5)
    with pytest.raises(DeviceFault, match="ended unasked"):
        bench.run()


@pytest.mark.parametrize("counts", [np.zeros((4, 2), np.uint16), np.zeros(SIZE, np.uint8), [[1]], None])
def test_a_picture_of_another_kind_is_a_fault(counts: Any) -> None:
    bench = Bench([Frame(counts, 0, -1, 0)], VirtualClock(), count=5)
    with pytest.raises(DeviceFault, match="instead of"):
        bench.run()


def test_a_camera_that_only_fails_is_given_up() -> None:
    script = [IncompleteFrame("cam", "acquire", "short") for _ in range(500)]
    bench = Bench(script, VirtualClock(), count=5)
    with pytest.raises(DeviceFault, match="nothing good 101 times"):
        bench.run()


def test_free_run_ends_at_its_time() -> None:
    clock = VirtualClock()
    bench = Bench([], clock, end_ns=50)

    def frames(host: RingHost) -> Iterator[Frame]:
        counter = 0
        while not host.stopping():
            yield Frame(host.buffer(), counter, -1, clock.wait_until_ns(clock.now_ns() + 10))
            counter += 1

    bench.camera.frames = frames  # type: ignore[method-assign]
    bench.station.end_ns = 50
    bench.run()
    assert bench.board.get(0, Cell.RECEIVED) == 5


class ScriptedProbe:
    capabilities = ProbeCapabilities(("a", "b"), "V", 1000.0)

    def __init__(self, blocks: list[Any], board: Board) -> None:
        self.blocks = blocks
        self.board = board

    def samples(self, host: Station) -> Iterator[SampleBlock]:
        yield from self.blocks
        self.board.give(Order.STOP)


def block(first_index: int, samples: int = 5, channels: int = 2) -> SampleBlock:
    ticks = np.arange(first_index, first_index + samples)
    return SampleBlock(np.zeros((samples, channels)), ticks, first_index, 0)


def run_probe(blocks: list[Any]) -> tuple[Board, Mail]:
    board, mail = Board(1), Mail()
    station = Station("wp", 0, board, VirtualClock(), mail, os.getppid())  # type: ignore[arg-type]
    probe = ScriptedProbe(blocks, board)
    ProbeLoop(probe, station, no_way_back(probe, station)).run()  # type: ignore[arg-type]
    return board, mail


def test_lost_samples_are_counted_and_told() -> None:
    board, mail = run_probe([block(0), block(5), block(17)])
    assert board.losses(0) == {"probe_gap": 7}
    assert mail.events == [("probe_gap", 17)]
    assert board.get(0, Cell.RECEIVED) == 15


def test_garbage_is_refused_and_the_rest_is_kept() -> None:
    nan = SampleBlock(np.full((5, 2), np.nan), np.arange(5), 5, 0)
    board, mail = run_probe([block(0), nan, block(10, channels=3), "text", block(15)])
    kept = [message.block.first_index for message in mail.messages if isinstance(message, Samples)]
    assert kept == [0, 15]
    assert board.losses(0) == {"incomplete": 3, "probe_gap": 10}


@pytest.mark.parametrize(
    "bad",
    [
        SampleBlock(np.zeros((3, 2)), np.arange(4), 0, 0),
        SampleBlock(np.zeros(3), np.arange(3), 0, 0),
        SampleBlock(np.zeros((3, 2)), np.array([3, 2, 1]), 0, 0),
        SampleBlock(np.full((3, 2), np.inf), np.arange(3), 0, 0),
        SampleBlock([["a", "b"]], np.arange(1), 0, 0),  # type: ignore[arg-type]
        SampleBlock(np.zeros((3, 2)), None, 0, 0),  # type: ignore[arg-type]
    ],
)
def test_a_bad_block_says_what_is_wrong(bad: SampleBlock) -> None:
    with pytest.raises((ValueError, TypeError), match=r"."):
        check_block(bad, 2)
