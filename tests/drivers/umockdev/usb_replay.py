"""USB devices that are not there, behind the real libusb: umockdev replays what a test recorded.

The recording is made of an emulated device: `RecordingBackend` stands between pyusb and the emulator and
keeps every transfer. Then the same code runs in a process under ``umockdev-run``, which shows the device to
libudev and libusb and answers the URBs of libusb from the recording::

    wire = UsbRecording()
    backend = RecordingBackend(EmulatedBackend([UsbPlug(device)]), wire)
    session(Emulated(backend))                       # the driver against the emulator
    done = run_with_device(tmp_path, device.description, wire, PROGRAM)   # and through the real libusb

`PROGRAM` is Python text that begins with ``import lenient_libusb`` (see there) and uses `RealTransports`.
A recording can also be written by hand, transfer by transfer.

What umockdev 0.17.16 (Debian 12) can and cannot do, as found by trying:

* ``--pcap`` replays usbmon captures of link type 220 strictly in order, control transfers too; their set-up
  bytes, and what is sent to the device, must be those of the recording. `UsbRecording` writes such captures,
  so that neither hardware nor a kernel module is needed.
* A transfer that does not match never completes: the program sees its own timeout, and umockdev says on
  standard error at which packet it is stuck.
* Claiming, releasing, clearing a halt and resetting succeed. Choosing a configuration or an alternate
  setting, and asking for the kernel's driver, fail ("Other error"): `lenient_libusb` lets them pass.
* ``--ioctl`` recordings answer in any order, but their control transfers do not serve libusb.
* Bulk reads of 200 kB pass as one URB. Streams of isochronous transfers are not replayed.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from thermacq.testing.emulation.usb import Interface, UsbDescription

BUS, NUMBER = 1, 4
SYSFS = "/devices/pci0000:00/0000:00:14.0/usb1/1-1"
_CONTROL, _BULK = 2, 3
_LINK_TYPE = 220
_SUBMIT, _COMPLETE = b"S", b"C"
_PRESENT, _ABSENT = 0, ord("-")
_IN_PROGRESS = -115
_RUNNING_S = 60


class UsbRecording:
    """What passes over the wire of a device, in order; written as a usbmon capture."""

    def __init__(self) -> None:
        self._packets: list[bytes] = []

    def control_in(
        self, request_type: int, request: int, value: int, index: int, answer: bytes, asked: int = -1
    ) -> None:
        """Data from the device; `asked` is the length that the program asks for, by default that of the answer."""
        length = len(answer) if asked < 0 else asked
        setup = struct.pack("<BBHHH", request_type, request, value, index, length)
        self._transfer(_CONTROL, 0x80, length, setup=setup, answer=answer)

    def control_out(self, request_type: int, request: int, value: int, index: int, data: bytes = b"") -> None:
        """Data to the device; the program must send the same."""
        setup = struct.pack("<BBHHH", request_type, request, value, index, len(data))
        self._transfer(_CONTROL, 0x00, len(data), setup=setup, sent=data)

    def bulk_in(self, endpoint: int, asked: int, answer: bytes, status: int = 0) -> None:
        """One bulk transfer from the device; `status` is 0 or a negative errno."""
        self._transfer(_BULK, endpoint, asked, answer=answer, status=status)

    def bulk_out(self, endpoint: int, data: bytes) -> None:
        """One bulk transfer to the device; the program must send the same."""
        self._transfer(_BULK, endpoint, len(data), sent=data)

    def save(self, path: Path) -> None:
        """Write the capture."""
        header = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 20, _LINK_TYPE)
        path.write_bytes(header + b"".join(self._packets))

    def _transfer(
        self,
        kind: int,
        endpoint: int,
        asked: int,
        *,
        setup: bytes = b"",
        sent: bytes = b"",
        answer: bytes = b"",
        status: int = 0,
    ) -> None:
        moved = len(sent) or len(answer)
        self._packet(_SUBMIT, kind, endpoint, asked, sent, setup, _IN_PROGRESS)
        self._packet(_COMPLETE, kind, endpoint, moved, answer, b"", status)

    def _packet(
        self, event: bytes, kind: int, endpoint: int, length: int, data: bytes, setup: bytes, status: int
    ) -> None:
        """One record: header of pcap, header of usbmon (64 bytes), data."""
        transfer = len(self._packets) // 2 + 1
        usbmon = struct.pack(
            "<QcBBBHBBqiiII8siiII",
            transfer,
            event,
            kind,
            endpoint,
            NUMBER,
            BUS,
            _PRESENT if setup else _ABSENT,
            _PRESENT if data else _ABSENT,
            0,  # seconds and microseconds: nothing is delayed
            0,
            status,
            length,
            len(data),
            setup,
            0,
            0,
            0,
            0,
        )
        size = len(usbmon) + len(data)
        self._packets.append(struct.pack("<IIII", 0, 0, size, size) + usbmon + data)


class RecordingBackend:
    """A backend of pyusb that keeps every transfer of another one; failed transfers are left out."""

    def __init__(self, inner: Any, recording: UsbRecording) -> None:
        self._inner = inner
        self._wire = recording

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def ctrl_transfer(
        self, handle: Any, kind: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        moved = self._inner.ctrl_transfer(handle, kind, request, value, index, data, timeout)
        if kind & 0x80:
            asked = len(data) * data.itemsize
            self._wire.control_in(kind, request, value, index, data.tobytes()[:moved], asked)
        else:
            self._wire.control_out(kind, request, value, index, data.tobytes())
        return moved

    def bulk_read(self, handle: Any, endpoint: int, interface: int, buffer: Any, timeout: int) -> int:
        moved = self._inner.bulk_read(handle, endpoint, interface, buffer, timeout)
        self._wire.bulk_in(endpoint, len(buffer) * buffer.itemsize, buffer.tobytes()[:moved])
        return moved

    def bulk_write(self, handle: Any, endpoint: int, interface: int, data: Any, timeout: int) -> int:
        moved = self._inner.bulk_write(handle, endpoint, interface, data, timeout)
        self._wire.bulk_out(endpoint, data.tobytes())
        return moved


def run_with_device(
    folder: Path, description: UsbDescription, recording: UsbRecording, program: str
) -> subprocess.CompletedProcess[str]:
    """Run Python text in a process whose only USB device is the recorded one; skips without umockdev."""
    if shutil.which("umockdev-run") is None:
        pytest.skip("umockdev-run is not installed (Debian: umockdev)")
    device, capture = folder / "device.umockdev", folder / "wire.pcap"
    device.write_text(sysfs_description(description))
    recording.save(capture)
    umockdev = ["umockdev-run", "--device", str(device), "--pcap", f"/sys{SYSFS}={capture}", "--"]
    return subprocess.run(
        [*umockdev, sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=_RUNNING_S,
        check=False,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent)},
    )


def sysfs_description(said: UsbDescription) -> str:
    """The device as ``umockdev-record`` would write it."""
    node = f"bus/usb/{BUS:03}/{NUMBER:03}"
    attributes = {
        "busnum": BUS,
        "devnum": NUMBER,
        "speed": 480,
        "bConfigurationValue": 1,
        "idVendor": f"{said.vid:04x}",
        "idProduct": f"{said.pid:04x}",
        "serial": said.serial,
        "product": said.product,
    }
    lines = [
        f"P: {SYSFS}",
        f"N: {node}",
        f"E: DEVNAME=/dev/{node}",
        "E: DEVTYPE=usb_device",
        "E: SUBSYSTEM=usb",
        f"E: BUSNUM={BUS:03}",
        f"E: DEVNUM={NUMBER:03}",
        *(f"A: {name}={value}\\n" for name, value in attributes.items() if value != ""),
        f"H: descriptors={descriptors(said).hex().upper()}",
    ]
    return "\n".join(lines) + "\n\n"


def descriptors(said: UsbDescription) -> bytes:
    """Device and configuration descriptors, as in the file ``descriptors`` of sysfs."""
    strings = (1 if said.manufacturer else 0, 2 if said.product else 0, 3 if said.serial else 0)
    kind = (said.device_class, 0, 0, 64)
    ids = (said.vid, said.pid, said.bcd_device)
    device = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x200, *kind, *ids, *strings, 1)
    parts = b"".join(_interface_descriptors(one) for one in said.interfaces)
    count = len({one.number for one in said.interfaces})
    return device + struct.pack("<BBHBBBBB", 9, 2, 9 + len(parts), count, 1, 0, 0x80, 250) + parts


def _interface_descriptors(interface: Interface) -> bytes:
    """Descriptor of one alternate setting and of its endpoints."""
    endpoints = b"".join(
        struct.pack("<BBBBHB", 7, 5, one.address, one.attributes, one.packet_bytes, 0)
        for one in interface.endpoints
    )
    numbers = (interface.number, interface.alternate, len(interface.endpoints), interface.interface_class)
    return struct.pack("<9B", 9, 4, *numbers, 0, 0, 0) + endpoints
