"""The driver ``p3`` through the real libusb: a session with damaged and lost frames, replayed by umockdev."""

from __future__ import annotations

import json

from thermacq.hooks import Emulation
from thermacq.testing.emulation.usb_backend import EmulatedBackend
from thermacq.testing.emulators.p3 import attach
from thermacq.timing.clock import RealClock
from thermacq.transports import RealTransports

from .p3_driver_session import driver_session
from .usb_replay import RecordingBackend, UsbRecording, run_with_device

FRAMES = 12
FAULTS = [
    {"kind": "bad_crc", "at": 4},
    {"kind": "short_read", "at": 7, "amount": 1000},
    {"kind": "drop", "at": 10, "items": 2},
]

CHILD = f"""
import lenient_libusb
from p3_driver_session import driver_session
from thermacq.transports import RealTransports
print(driver_session(RealTransports(), {FRAMES}))
"""


class Emulated(RealTransports):
    def __init__(self, backend) -> None:
        self._backend = backend

    def usb_backend(self):
        return self._backend


def test_the_whole_session_through_the_real_libusb(tmp_path):
    wire = UsbRecording()
    with attach(Emulation("left", RealClock(), tmp_path, {"faults": FAULTS})) as transports:
        plug = transports.usb[0]
        said = driver_session(Emulated(RecordingBackend(EmulatedBackend([plug]), wire)), FRAMES)
    done = run_with_device(tmp_path, plug.device.description, wire, CHILD)
    assert done.returncode == 0, done.stderr
    found, identity, came, damaged = json.loads(done.stdout)
    assert found == [["P3", "EMU-left"]]
    assert identity == ["P3", "EMU-left", "00.00.02.17"]
    assert damaged == 2
    counters = [counter for counter, *_ in came]
    assert counters[-1] - counters[0] + 1 - len(counters) == 4  # two damaged, two dropped
    assert json.loads(done.stdout) == json.loads(said)
