"""The vendor requests of one P2 Pro, sent beside the kernel's driver for USB video.

The picture must stream while they are sent: the camera is known to hang otherwise.
"""

from __future__ import annotations

import time
from typing import Any

from thermacq.errors import DeviceFault, DeviceTimeout
from thermacq.transports import Transports, VideoNode
from thermacq_drivers.p2pro import IDS, codec
from thermacq_drivers.p2pro.codec import Info, Parameter
from thermacq_drivers.transports.usb import UsbPort, find_devices, serial_of

_READY_S = 5.0
_POLL_S = 0.001


class P2ProControl:
    """Texts and parameters of a camera.

    Parameters
    ----------
    device
        Name of the device in the rig, for faults.
    transports
        Where to look.
    node
        Video node of the same camera: found by serial number, or by the socket that both hang on.
    """

    def __init__(self, device: str, transports: Transports, node: VideoNode) -> None:
        self._name = device
        found = [one for one in find_devices(transports, IDS) if _belongs(one, node)]
        self._port = UsbPort(device, transports, IDS, interfaces=(), among=found)

    def text(self, what: Info, stage: str) -> str:
        """Ask for a text."""
        self._send(codec.LAST_PART, codec.read_info(what), stage)
        self._await_ready(stage)
        return codec.parse_text(self._fetch(codec.DATA, codec.INFO_BYTES[what], stage))

    def parameter(self, what: Parameter, stage: str) -> int:
        """Ask for a parameter."""
        self._send_both(codec.read_parameter(what), stage)
        try:
            return codec.parse_number(self._fetch(codec.LONG_DATA, 2, stage))
        except ValueError as error:
            raise DeviceFault(self._name, stage, str(error)) from None

    def set_parameter(self, what: Parameter, value: int, stage: str) -> None:
        """Set a parameter and read it back."""
        self._send_both(codec.set_parameter(what, value), stage)
        there = self.parameter(what, stage)
        if there != value:
            what_happened = f"{what.name.lower()} was set to {value}, but {there} is in force"
            raise DeviceFault(self._name, stage, what_happened)

    def close(self) -> None:
        """Let go of the camera."""
        self._port.close()

    def _send_both(self, parts: tuple[bytes, bytes], stage: str) -> None:
        self._send(codec.FIRST_PART, parts[0], stage)
        self._send(codec.DATA, parts[1], stage)
        self._await_ready(stage)

    def _send(self, place: int, data: bytes, stage: str) -> None:
        self._port.control_out(*codec.WRITE, codec.VALUE, place, data, stage)

    def _fetch(self, place: int, length: int, stage: str) -> bytes:
        return self._port.control_in(*codec.READ, codec.VALUE, place, length, stage)

    def _await_ready(self, stage: str) -> None:
        deadline_s = time.monotonic() + _READY_S
        try:
            while not codec.is_ready(self._fetch(codec.STATUS, 1, stage)):
                if time.monotonic() > deadline_s:
                    what = f"it is not done with a command after {_READY_S:g} s"
                    raise DeviceTimeout(self._name, stage, what, remedy="Pull its plug and put it in again.")
                time.sleep(_POLL_S)
        except ValueError as error:
            raise DeviceFault(self._name, stage, str(error)) from None


def _belongs(device: Any, node: VideoNode) -> bool:
    """Whether a USB device and a video node are one camera."""
    serial = serial_of(device)
    if node.serial and serial:
        return serial == node.serial
    # Without a serial number, or without the right to read it.
    ports = ".".join(str(number) for number in device.port_numbers or ())
    return not node.location or f"{device.bus}-{ports}" == node.location
