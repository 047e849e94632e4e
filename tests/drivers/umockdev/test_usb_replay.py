"""The USB transport of the drivers through the real libusb, in front of a device that umockdev replays."""

from __future__ import annotations

import json
import struct
import subprocess

import pytest

from thermacq.testing.emulation.usb import Endpoint, Interface, UsbDescription, UsbPlug, UsbStall, UsbTimeout
from thermacq.testing.emulation.usb_backend import EmulatedBackend
from thermacq.transports import RealTransports

from .p3_session import PIXEL_BYTES, READ_MODEL, session
from .usb_replay import RecordingBackend, UsbRecording, descriptors, run_with_device

FRAME = bytes(range(256)) * (PIXEL_BYTES // 256)

CHILD = """
import lenient_libusb
from p3_session import session
from thermacq.transports import RealTransports
print(session(RealTransports(), {command}))
"""


class TinyP3:
    """As much of a P3 as one picture needs."""

    description = UsbDescription(
        vid=0x3474,
        pid=0x45A2,
        serial="P3-0001",
        product="P3",
        interfaces=(Interface(0), Interface(1), Interface(1, 1, (Endpoint(0x81),))),
    )

    def power_up(self) -> None:
        self.queue = [
            FRAME,
            struct.pack("<BBIIH", 12, 0x8C, 1, 1, 40),
            struct.pack("<BBIIH", 12, 0x8E, 1, 1, 80),
        ]
        self.answer = b""

    def control_in(self, request_type, request, value, index, length):
        if request == 0x22:
            return b"\x02"
        if request == 0x21:
            return self.answer
        raise UsbStall

    def control_out(self, request_type, request, value, index, data):
        if (request_type, request) == (0x41, 0x20) and data == READ_MODEL:
            self.answer = b"P3".ljust(30, b"\0")
        elif (request_type, request, index) != (0x40, 0xEE, 1):
            raise UsbStall

    def bulk_in(self, endpoint, length, timeout_s, gone):
        if not self.queue:
            raise UsbTimeout
        return self.queue.pop(0)[:length]

    def bulk_out(self, endpoint, data, timeout_s):
        raise UsbStall

    def clear_halt(self, endpoint):
        pass

    def select(self, interface, alternate):
        pass


class Emulated(RealTransports):
    def __init__(self, backend) -> None:
        self._backend = backend

    def usb_backend(self):
        return self._backend


@pytest.fixture
def recorded() -> tuple[str, UsbRecording]:
    """What the session says in front of the emulator, and what passed over the wire."""
    plug = UsbPlug(TinyP3())
    plug.plug()
    wire = UsbRecording()
    return session(Emulated(RecordingBackend(EmulatedBackend([plug]), wire))), wire


def test_the_real_libusb_gives_what_the_emulator_gave(recorded, tmp_path):
    said, wire = recorded
    done = run_with_device(tmp_path, TinyP3.description, wire, CHILD.format(command=READ_MODEL))
    assert done.returncode == 0, done.stderr
    found, status, model, picture = json.loads(done.stdout)
    assert found == [[0x3474, 0x45A2, "P3-0001"]]
    assert (status, model, picture[0]) == ("02", "P3", PIXEL_BYTES)
    assert json.loads(done.stdout) == json.loads(said)


def test_a_request_that_was_not_recorded_times_out(recorded, tmp_path):
    _, wire = recorded
    other = READ_MODEL.replace(b"\x1e", b"\x1f")
    done = run_with_device(tmp_path, TinyP3.description, wire, CHILD.format(command=other))
    assert done.returncode != 0
    assert "device 'left' (open)" in done.stderr


def test_a_failed_transfer_keeps_its_error(tmp_path):
    wire = UsbRecording()
    wire.bulk_in(0x81, 512, b"", status=-32)
    program = (
        "import lenient_libusb, usb.core\n"
        "device = usb.core.find(idVendor=0x3474)\n"
        "device.set_interface_altsetting(1, 1)\n"
        "try:\n    device.read(0x81, 512, 1000)\n"
        "except usb.core.USBError as error:\n    print(error.errno)\n"
    )
    done = run_with_device(tmp_path, TinyP3.description, wire, program)
    assert done.stdout.strip() == "32", done.stderr


def test_the_descriptors_are_those_that_lsusb_would_show(tmp_path):
    said = descriptors(TinyP3.description)
    assert said[:2] == bytes([18, 1])
    assert struct.unpack_from("<HH", said, 8) == (0x3474, 0x45A2)
    total = struct.unpack_from("<H", said, 20)[0]
    assert total == len(said) - 18
    assert said[22] == 2  # interfaces
    assert said.count(bytes([9, 4])) == 3  # with their alternate settings


def test_a_capture_is_one_that_libpcap_reads(tmp_path):
    wire = UsbRecording()
    wire.control_out(0x41, 0x20, 0, 0, READ_MODEL)
    wire.save(tmp_path / "wire.pcap")
    kind = subprocess.run(["file", "-b", tmp_path / "wire.pcap"], capture_output=True, text=True, check=False)
    if kind.returncode != 0:
        pytest.skip("the program `file` is not installed")
    assert "pcap capture file" in kind.stdout
