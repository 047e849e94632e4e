"""Drivers of pyusb cameras through the real libusb: sessions with damaged and lost frames, replayed by umockdev."""

from __future__ import annotations

import json
from pathlib import Path

from thermacq.hooks import Emulation
from thermacq.plugins import plugins
from thermacq.testing.emulation.usb_backend import EmulatedBackend
from thermacq.timing.clock import RealClock
from thermacq.transports import RealTransports

from .camera_session import camera_session
from .usb_replay import RecordingBackend, UsbRecording, run_with_device

CHILD = """
import lenient_libusb
from camera_session import camera_session
from thermacq.transports import RealTransports
print(camera_session({}, RealTransports()))
"""


class Emulated(RealTransports):
    def __init__(self, backend) -> None:
        self._backend = backend

    def usb_backend(self):
        return self._backend


def both_ways(
    folder: Path, driver: str, settings: dict, rate_hz: float, frames: int, emulation: dict
) -> list:
    """What the driver says of a session through the real libusb; the same as in front of the emulator."""
    wire = UsbRecording()
    emulator = plugins().emulator(driver)
    with emulator.attach(Emulation("left", RealClock(), folder, emulation)) as transports:
        plug = transports.usb[0]
        backend = RecordingBackend(EmulatedBackend([plug]), wire)
        said = camera_session(driver, settings, rate_hz, frames, Emulated(backend))
    arguments = ", ".join(map(repr, (driver, settings, rate_hz, frames)))
    done = run_with_device(folder, plug.device.description, wire, CHILD.format(arguments))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == json.loads(said)
    return json.loads(done.stdout)


def test_p3(tmp_path):
    settings = {"settle_s": 0.0, "stream_settle_s": 0.0, "gain": "high", "shutter_at_arm": True}
    faults = [
        {"kind": "bad_crc", "at": 4},
        {"kind": "short_read", "at": 7, "amount": 1000},
        {"kind": "drop", "at": 10, "items": 2},
    ]
    found, identity, came, damaged = both_ways(tmp_path, "p3", settings, 25.0, 12, {"faults": faults})
    assert found == [["P3", "EMU-left"]]
    assert identity == ["P3", "EMU-left", "00.00.02.17"]
    assert damaged == 2
    counters = [counter for counter, *_ in came]
    assert counters[-1] - counters[0] + 1 - len(counters) == 4  # two damaged, two dropped


def test_tau2(tmp_path):
    # Questions that are due by the clock would come at another place of the replay, which is faster.
    settings = {"ffc_at_arm": True, "temperature_every_s": 60.0, "own_rate_hz": 75.0}
    faults = [{"kind": "short_read", "at": 35, "amount": 1000}]
    emulation = {"size": "336", "own_rate_hz": 75.0, "ffc_s": 0.2, "faults": faults}
    found, identity, came, damaged = both_ways(tmp_path, "tau2", settings, 75.0, 40, emulation)
    assert [serial for _, serial in found] == ["EMU-left"]
    assert identity[1:] == ["EMU-left", "12.0.3.44"]
    assert damaged == 1
    assert {temperature for _, temperature, _ in came} == {str(25.3 + 273.15)}
    assert len({picture for *_, picture in came}) == 40
