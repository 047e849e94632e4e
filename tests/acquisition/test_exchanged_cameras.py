"""Two identical USB cameras on one bus, pulled and exchanged: each name keeps its own individual."""

import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from thermacq.acquisition import lifeline
from thermacq.acquisition.board import Board
from thermacq.acquisition.lifeline import Lifeline
from thermacq.acquisition.messages import Opened
from thermacq.acquisition.station import Station
from thermacq.devices import DeviceContext, TriggerMode
from thermacq.errors import DeviceDisconnected
from thermacq.hooks import Emulation
from thermacq.rig import ReconnectTable
from thermacq.store import Event
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.testing.emulators.seek import attach
from thermacq.timing import RealClock
from thermacq_drivers.seek.camera import SeekCamera

GONE = DeviceDisconnected("left", "acquire", "it is gone from USB")


class Mail:
    def __init__(self) -> None:
        self.events: list[Event] = []

    def post(self, message: Any) -> None:
        self.events.append(message)


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[EmulatedTransports]:
    """Two cameras of the same model, the second one not plugged in yet."""
    with ExitStack() as stack:
        first, second = (
            stack.enter_context(attach(Emulation(name, RealClock(), tmp_path, {"serial": serial})))
            for name, serial in (("left", "SEEK00000001"), ("right", "SEEK00000002"))
        )
        assert isinstance(first, EmulatedTransports)
        assert isinstance(second, EmulatedTransports)
        second.usb[0].unplug()
        yield first + second


def held(camera: SeekCamera, mail: Mail, give_up_after_s: float) -> Lifeline:
    """The lifeline of a camera that was opened and configured just now."""
    opened = Opened(camera.open(), dict(camera.configure({})), camera.capabilities)
    camera.arm(TriggerMode.FREE_RUN, 9.0)
    station = Station("left", 0, Board(1), RealClock(), mail, os.getppid())  # type: ignore[arg-type]
    table = ReconnectTable(give_up_after_s=give_up_after_s)
    return Lifeline(camera, station, table, {}, opened, lambda _: None)


@pytest.mark.parametrize("named_in_rig", [True, False])
def test_the_other_camera_is_not_taken_for_the_lost_one(
    bus: EmulatedTransports, named_in_rig: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lifeline, "_TRY_EVERY_S", 0.05)
    mail, (mine, other) = Mail(), bus.usb
    serial = "SEEK00000001" if named_in_rig else ""
    camera = SeekCamera(DeviceContext("left", RealClock(), transports=bus, serial=serial))
    line = held(camera, mail, 0.4)

    mine.unplug()
    other.plug()
    with pytest.raises(DeviceDisconnected, match=r"did not come back within 0\.4 s"):
        line.bring_back(GONE, 10, None, lambda: None)
    notes = [event.detail for event in mail.events if event.kind.value == "note"]
    assert any("SEEK00000002" in note for note in notes)
    # The other camera was let go of: whoever it belongs to can open it.
    right = SeekCamera(DeviceContext("right", RealClock(), transports=bus, serial="SEEK00000002"))
    assert right.open().serial == "SEEK00000002"
    right.close()


def test_with_both_plugged_in_again_each_name_finds_its_own(bus: EmulatedTransports) -> None:
    mail, (mine, other) = Mail(), bus.usb
    camera = SeekCamera(DeviceContext("left", RealClock(), transports=bus))
    line = held(camera, mail, 10.0)
    mine.unplug(0.3)
    other.plug()
    assert line.bring_back(GONE, 10, None, lambda: camera.arm(TriggerMode.FREE_RUN, 9.0))
    line.deliver(3, 13, "frames")
    assert mail.events[0].kind.value == "disconnected"
    assert mail.events[-1].kind.value == "reconnected"
    camera.close()
