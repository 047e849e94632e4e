"""Outages in the loops of a device process, with devices that are unplugged exactly as a test says."""

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from thermacq.acquisition import lifeline
from thermacq.acquisition.board import Board, Cell, Order
from thermacq.acquisition.camera_loop import CameraLoop
from thermacq.acquisition.lifeline import Lifeline
from thermacq.acquisition.messages import ArmOrder, Away, Back, Opened, Pulse, Samples
from thermacq.acquisition.ring import FrameRing, ring_bytes
from thermacq.acquisition.ring_host import RingHost
from thermacq.acquisition.shared import SharedBlock
from thermacq.acquisition.station import Station
from thermacq.acquisition.streams import ProbeLoop, TriggerLoop
from thermacq.devices import (
    CameraCapabilities,
    DeviceIdentity,
    Frame,
    FrameFlag,
    ProbeCapabilities,
    SampleBlock,
    TriggerCapabilities,
    TriggerMode,
    TriggerPulse,
)
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.rig import ReconnectTable
from thermacq.store import Event
from thermacq.timing import NS_PER_S, VirtualClock

SIZE = (2, 4)
PERIOD_NS = 10_000_000
GONE = DeviceDisconnected("cam", "acquire", "the cable was pulled")
SILENT = DeviceTimeout("cam", "acquire", "no frame came")
MINE = DeviceIdentity("scripted", "scripted", "1")


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tries follow each other quickly; each takes 10 ms of virtual time."""
    monkeypatch.setattr(lifeline, "_TRY_EVERY_S", 0.01)
    monkeypatch.setattr(lifeline, "_LOOK_EVERY_S", 0.001)


class Mail:
    def __init__(self) -> None:
        self.messages: list[Any] = []

    def post(self, message: Any) -> None:
        self.messages.append(message)

    def post_patiently(self, message: Any, stopping: Any) -> None:
        self.messages.append(message)

    @property
    def events(self) -> list[Event]:
        return [item for item in self.messages if isinstance(item, Event)]


class Device:
    """Opens as its script says: an identity, or a fault to raise; the last step is repeated."""

    capabilities: Any = CameraCapabilities(*SIZE, 16, 1000.0, frozenset(TriggerMode), counter_bits=8)

    def __init__(self, openings: list[Any]) -> None:
        self.openings = list(openings)
        self.settings: list[Any] = []
        self.armed: list[Any] = []
        self.is_open = True

    def open(self) -> DeviceIdentity:
        step = self.openings.pop(0) if len(self.openings) > 1 else self.openings[0]
        if isinstance(step, Exception):
            raise step
        self.is_open = True
        return step

    def configure(self, settings: Any) -> Any:
        self.settings.append(dict(settings))
        return {"gain": 1, **settings}

    def arm(self, *order: Any) -> None:
        self.armed.append(order)

    def disarm(self) -> None:
        pass

    def close(self) -> None:
        self.is_open = False


class Camera(Device):
    """A frame at each period or trigger; raises the fault that its script names for a frame, counted in all."""

    def __init__(self, clock: VirtualClock, faults: dict[int, DeviceFault], openings: list[Any]) -> None:
        super().__init__(openings)
        self.clock, self.faults = clock, faults
        self.delivered = self.counter = 0
        self.triggers: list[int] = []

    def arm(self, *order: Any) -> None:
        super().arm(*order)
        self.counter = 0

    def trigger(self, index: int) -> None:
        self.triggers.append(index)

    def frames(self, host: RingHost) -> Iterator[Frame]:
        while not host.stopping():
            # The next exposure of a camera that began at 0, or that answers a trigger at once.
            if not self.triggers:
                places = self.clock.now_ns() // PERIOD_NS + 1
                self.clock.wait_until_ns(places * PERIOD_NS)
            if self.delivered in self.faults:
                raise self.faults.pop(self.delivered)
            self.delivered += 1
            self.counter += 1
            yield Frame(host.buffer(), self.counter - 1, self.clock.now_ns(), self.clock.now_ns())


class Bench:
    """A station and what is said to writer and recorder."""

    def __init__(self, clock: VirtualClock) -> None:
        self.board = Board(1)
        self.mail = Mail()
        self.news: list[Any] = []
        self.station = Station("cam", 0, self.board, clock, self.mail, os.getppid())  # type: ignore[arg-type]

    def lifeline(self, device: Device, policy: ReconnectTable | None = None, **applied: Any) -> Lifeline:
        opened = Opened(MINE, {"gain": 1, "mode": 5, **applied}, device.capabilities)
        policy = policy or ReconnectTable()
        return Lifeline(device, self.station, policy, {"mode": 5}, opened, self.news.append)  # type: ignore[arg-type]

    def kinds(self) -> list[str]:
        return [event.kind.value for event in self.mail.events]


class CameraBench(Bench):
    """A camera loop with its surroundings."""

    def __init__(
        self,
        faults: dict[int, DeviceFault],
        openings: list[Any],
        mode: TriggerMode,
        count: int | None = 50,
        policy: ReconnectTable | None = None,
    ) -> None:
        clock = VirtualClock()
        super().__init__(clock)
        self.camera = Camera(clock, faults, openings)
        block = SharedBlock()
        block.allocate(ring_bytes(*SIZE, 64))
        self.ring = FrameRing(block, *SIZE, 64)
        block.close()
        host = RingHost(self.station, self.ring, np.zeros(SIZE, np.uint16))
        order = ArmOrder(mode, NS_PER_S / PERIOD_NS, count, None, 1_000_000, 64)
        lifeline = self.lifeline(self.camera, policy)
        self.loop = CameraLoop(self.camera, self.station, host, order, None, lifeline)  # type: ignore[arg-type]

    def run(self) -> None:
        self.loop.run(0)

    def rows(self) -> list[Any]:
        rows = []
        while (item := self.ring.peek()) is not None:
            rows.append(item[1].copy())
            self.ring.release()
        return rows


def test_software_triggers_go_on_at_the_right_index() -> None:
    away = DeviceDisconnected("cam", "open", "nothing is there")
    bench = CameraBench({10: GONE}, [away, away, away, MINE], TriggerMode.SOFTWARE)
    bench.run()
    rows = bench.rows()
    indices = [int(row["trigger_index"]) for row in rows]
    # Ten frames, then 30 ms of tries after the trigger at 100 ms: the first trigger to come is number 13.
    assert indices == [*range(10), *range(13, 50)]
    assert [int(row["trigger_ns"]) for row in rows] == [index * PERIOD_NS for index in indices]
    restarted = [int(row["trigger_index"]) for row in rows if row["flags"] & FrameFlag.RESTARTED]
    assert restarted == [13]
    assert bench.board.losses(0) == {"disconnected": 3}
    assert bench.kinds() == ["disconnected", "note", "reconnected"]
    back = bench.mail.events[-1]
    assert "3 frames missing; settings as before" in back.detail
    assert [type(one) for one in bench.news] == [Away, Away, Back]
    assert bench.news[-1].missed == 3
    assert bench.camera.settings == [{"mode": 5}]


def test_frames_missed_in_free_run_count_towards_those_asked_for() -> None:
    away = DeviceDisconnected("cam", "open", "nothing is there")
    bench = CameraBench({10: GONE}, [away, away, away, away, MINE], TriggerMode.FREE_RUN)
    bench.run()
    rows = bench.rows()
    missed = bench.board.losses(0)["disconnected"]
    assert missed == 5  # the one under way, and one for each try
    assert len(rows) + missed == 50
    assert int(rows[-1]["host_ns"]) == 50 * PERIOD_NS
    assert [int(row["counter"]) for row in rows] == [*range(10), *range(35)]
    assert bench.kinds() == ["disconnected", "note", "reconnected"]


def test_a_camera_that_opens_but_gives_nothing_is_still_away() -> None:
    bench = CameraBench({10: SILENT}, [MINE], TriggerMode.FREE_RUN)
    silent = iter([SILENT, SILENT])
    original = bench.camera.arm

    def arm(*order: Any) -> None:
        original(*order)
        if fault := next(silent, None):
            bench.camera.faults[10] = fault

    bench.camera.arm = arm  # type: ignore[method-assign]
    bench.run()
    assert bench.kinds() == ["timeout", "reconnected"]
    assert [type(one) for one in bench.news] == [Away, Back]
    assert len(bench.camera.armed) == 3


def test_several_outages_are_told_one_by_one() -> None:
    bench = CameraBench({5: GONE, 20: GONE, 30: SILENT}, [MINE], TriggerMode.SOFTWARE)
    bench.run()
    assert bench.kinds() == ["disconnected", "reconnected"] * 2 + ["timeout", "reconnected"]
    rows = bench.rows()
    assert len(rows) + bench.board.losses(0)["disconnected"] == 50
    assert sum(bool(row["flags"] & FrameFlag.RESTARTED) for row in rows) == 3


def test_another_individual_is_refused_and_let_go_of() -> None:
    other = DeviceIdentity("scripted", "scripted", "2")
    bench = CameraBench({10: GONE}, [other], TriggerMode.SOFTWARE, policy=ReconnectTable(give_up_after_s=0.2))
    with pytest.raises(DeviceDisconnected, match=r"within 0.2 s; .*pulled; .*serial number '2', not '1'"):
        bench.run()
    assert not bench.camera.is_open
    assert bench.camera.settings == []  # it was not touched
    # What was missed until then is counted.
    assert bench.board.losses(0)["disconnected"] > 1
    assert sum("another device is there" in event.detail for event in bench.mail.events) == 1


def test_a_camera_that_makes_other_pictures_now_is_refused() -> None:
    bench = CameraBench({10: GONE}, [MINE], TriggerMode.SOFTWARE, policy=ReconnectTable(give_up_after_s=0.2))
    small = CameraCapabilities(1, 2, 16, 1000.0, frozenset(TriggerMode))
    configure = bench.camera.configure

    def shrink(settings: Any) -> Any:
        bench.camera.capabilities = small
        return configure(settings)

    bench.camera.configure = shrink  # type: ignore[method-assign]
    with pytest.raises(DeviceDisconnected, match="of another kind"):
        bench.run()
    assert bench.camera.armed == []


def test_policy_fail_ends_it_at_once() -> None:
    bench = CameraBench({10: GONE}, [MINE], TriggerMode.SOFTWARE, policy=ReconnectTable(policy="fail"))
    with pytest.raises(DeviceDisconnected, match="pulled"):
        bench.run()
    assert bench.camera.armed == []
    assert bench.news == []
    assert bench.board.losses(0) == {}


def test_a_driver_that_raises_anything_is_tried_again(capsys: pytest.CaptureFixture[str]) -> None:
    bench = CameraBench({10: GONE}, [KeyError("no such port"), MINE], TriggerMode.SOFTWARE)
    bench.run()
    assert bench.kinds() == ["disconnected", "note", "reconnected"]
    assert "KeyError" in bench.mail.events[1].detail
    assert "KeyError" in capsys.readouterr().err


def test_device_wins_reads_the_settings_and_sends_none() -> None:
    bench = CameraBench({10: GONE}, [MINE], TriggerMode.SOFTWARE, policy=ReconnectTable(policy="device_wins"))
    bench.camera.adopt = lambda: {"gain": 7, "mode": 5}  # type: ignore[attr-defined]
    bench.run()
    assert bench.camera.settings == []
    assert "settings differ: gain" in bench.mail.events[-1].detail
    assert bench.news[-1].changed == ("gain",)
    assert bench.news[-1].applied == {"gain": 7, "mode": 5}


def test_a_stop_ends_the_waiting() -> None:
    away = DeviceDisconnected("cam", "open", "nothing is there")
    bench = CameraBench({10: GONE}, [away], TriggerMode.FREE_RUN, count=None)

    def stop_at_third_try() -> DeviceIdentity:
        tries.append(1)
        if len(tries) == 3:
            bench.board.give(Order.STOP)
        raise away

    tries: list[int] = []
    bench.camera.open = stop_at_third_try  # type: ignore[method-assign]
    bench.run()
    assert len(tries) == 3
    assert "still away" in bench.mail.events[-1].detail


def test_the_end_of_the_recording_ends_the_waiting() -> None:
    away = DeviceDisconnected("cam", "open", "nothing is there")
    bench = CameraBench({10: GONE}, [away], TriggerMode.SOFTWARE)
    with pytest.raises(DeviceDisconnected, match="before the end of the recording"):
        bench.run()
    assert bench.board.losses(0) == {"disconnected": 40}


class Probe(Device):
    capabilities = ProbeCapabilities(("a",), "V", 1000.0, tick_rate_hz=100.0)

    def __init__(self, clock: VirtualClock, board: Board, fails_at: int, blocks: int) -> None:
        super().__init__([DeviceDisconnected("wp", "open", "not there")] * 3 + [MINE])
        self.clock, self.board = clock, board
        self.fails_at, self.blocks = fails_at, blocks
        self.made = 0

    def samples(self, host: Station) -> Iterator[SampleBlock]:
        first = 0
        while not host.stopping():
            if self.made == self.fails_at:
                self.fails_at = -1
                raise DeviceDisconnected("wp", "acquire", "gone")
            self.clock.wait_until_ns(self.clock.now_ns() + PERIOD_NS)
            self.made += 1
            yield SampleBlock(np.zeros((5, 1)), np.arange(first, first + 5), first, self.clock.now_ns())
            first += 5
            if self.made == self.blocks:
                self.board.give(Order.STOP)


def test_samples_are_numbered_on_after_an_outage() -> None:
    clock = VirtualClock()
    bench = Bench(clock)
    probe = Probe(clock, bench.board, 20, 40)
    ProbeLoop(probe, bench.station, bench.lifeline(probe)).run()  # type: ignore[arg-type]
    blocks = [message.block for message in bench.mail.messages if isinstance(message, Samples)]
    assert [block.first_index for block in blocks] == list(range(0, 200, 5))
    assert blocks[20].ticks[0] == 0  # as delivered
    (back,) = (event for event in bench.mail.events if event.kind.value == "reconnected")
    assert blocks[19].host_ns < back.host_ns <= blocks[20].host_ns
    # Three tries of 10 ms each, at 5 samples in 10 ms.
    assert bench.board.losses(0) == {"disconnected": 15}


class Box(Device):
    capabilities = TriggerCapabilities(1000.0, 0.0)

    def __init__(self, clock: VirtualClock, fails_at: int) -> None:
        super().__init__([DeviceDisconnected("box", "open", "not there")] * 3 + [MINE])
        self.clock, self.fails_at = clock, fails_at

    def pulses(self, host: Station) -> Iterator[TriggerPulse]:
        count = self.armed[-1][1] if self.armed else 50
        start_ns = self.clock.now_ns()
        for index in range(count):
            self.clock.wait_until_ns(start_ns + index * PERIOD_NS)
            if index == self.fails_at:
                self.fails_at = -1
                raise DeviceDisconnected("box", "acquire", "gone")
            yield TriggerPulse(index, self.clock.now_ns())


def test_pulses_are_numbered_on_and_end_in_time() -> None:
    clock = VirtualClock()
    bench = Bench(clock)
    box = Box(clock, 10)
    order = ArmOrder(TriggerMode.HARDWARE, NS_PER_S / PERIOD_NS, 50, None, 0, 2)
    TriggerLoop(box, bench.station, order, bench.lifeline(box)).run(0)  # type: ignore[arg-type]
    pulses = [message for message in bench.mail.messages if isinstance(message, Pulse)]
    assert [pulse.index for pulse in pulses] == list(range(len(pulses)))
    assert box.armed == [(100.0, 50 - 13)]
    assert len(pulses) + bench.board.losses(0)["disconnected"] == 50
    assert pulses[-1].host_ns < 50 * PERIOD_NS
    assert bench.board.order(Order.PULSES_BEFORE) == 10
    assert pulses[9].host_ns < bench.board.order(Order.PULSES_SINCE_NS) <= pulses[10].host_ns


def test_a_camera_on_a_line_numbers_on_when_the_source_does() -> None:
    bench = CameraBench({}, [MINE], TriggerMode.HARDWARE, count=None)
    bench.board.give(Order.PULSES_SINCE_NS, 1000)
    bench.board.give(Order.PULSES_BEFORE, 40)
    counts = np.zeros(SIZE, np.uint16)

    def frames(host: RingHost) -> Iterator[Frame]:
        for host_ns, index in ((900, 39), (2000, 0), (3000, 1)):
            yield Frame(counts, -1, -1, host_ns, trigger_index=index)
        bench.board.give(Order.STOP)

    bench.camera.frames = frames  # type: ignore[method-assign]
    bench.run()
    assert [int(row["trigger_index"]) for row in bench.rows()] == [39, 40, 41]
    assert bench.board.get(0, Cell.RECEIVED) == 3
