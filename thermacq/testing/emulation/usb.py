"""An emulated USB device without its library: descriptors, transfers, and the socket that it is plugged into.

`thermacq.testing.emulation.usb_backend` brings it under pyusb.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from thermacq.testing.emulation.faults import FaultKind, FaultSettings, damaged


class UsbStall(Exception):
    """Raised by device logic: it refuses the request, or its endpoint is halted."""


class UsbTimeout(Exception):
    """Raised by device logic: nothing came, or nothing was taken, within the timeout."""


@dataclass(frozen=True)
class Endpoint:
    """One endpoint; `attributes` is 2 for bulk, 3 for interrupt."""

    address: int
    attributes: int = 2
    packet_bytes: int = 512


@dataclass(frozen=True)
class Interface:
    """One alternate setting of an interface."""

    number: int = 0
    alternate: int = 0
    endpoints: tuple[Endpoint, ...] = ()
    interface_class: int = 0xFF


@dataclass(frozen=True)
class UsbDescription:
    """What the descriptors of a device say; one configuration."""

    vid: int
    pid: int
    serial: str = ""
    product: str = ""
    manufacturer: str = ""
    interfaces: tuple[Interface, ...] = (Interface(),)
    device_class: int = 0
    bcd_device: int = 0x0100


class UsbDevice(Protocol):
    """Logic of an emulated USB device. Calls come one at a time for each direction of each endpoint."""

    description: UsbDescription

    def power_up(self) -> None:
        """Start afresh, as after the cable was plugged in or the bus was reset."""
        ...

    def control_in(self, request_type: int, request: int, value: int, index: int, length: int) -> bytes:
        """Answer a control request with at most `length` bytes; raises `UsbStall` for one it does not know."""
        ...

    def control_out(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """Take a control request; raises `UsbStall`."""
        ...

    def bulk_in(self, endpoint: int, length: int, timeout_s: float, gone: Callable[[], bool]) -> bytes:
        """Wait for data and return at most `length` bytes.

        Ends early when `gone` turns true (any value will do then); raises `UsbTimeout` and `UsbStall`.
        """
        ...

    def bulk_out(self, endpoint: int, data: bytes, timeout_s: float) -> int:
        """Take data; returns how many bytes were taken."""
        ...

    def clear_halt(self, endpoint: int) -> None:
        """The host ends a stall of this endpoint."""
        ...

    def select(self, interface: int, alternate: int) -> None:
        """The host chooses an alternate setting."""
        ...


class UsbPlug:
    """The socket of one emulated USB device: plugged in, pulled, and plugged in again."""

    def __init__(self, device: UsbDevice) -> None:
        self.device = device
        self._plugged = True
        self._replug_s: float | None = None
        self._lock = threading.RLock()
        # Grows each time it is plugged in; a handle of an earlier life is dead.
        self.life = 1
        self.claimed: dict[int, object] = {}
        self.configuration = 0
        device.power_up()

    @property
    def plugged(self) -> bool:
        """Whether it is plugged in now."""
        with self._lock:
            if not self._plugged and self._replug_s is not None and time.monotonic() >= self._replug_s:
                self.plug()
            return self._plugged

    def plug(self) -> None:
        """Plug it in: it starts afresh, and handles from before stay dead."""
        with self._lock:
            if not self._plugged:
                self._plugged, self._replug_s = True, None
                self.life += 1
                self.claimed.clear()
                self.configuration = 0
                self.device.power_up()

    def unplug(self, replug_after_s: float = 0.0) -> None:
        """Pull the cable; it is plugged in again after so many real seconds, or not when 0."""
        with self._lock:
            self._plugged = False
            self._replug_s = time.monotonic() + replug_after_s if replug_after_s > 0 else None


def through_wire(data: bytes, faults: Sequence[FaultSettings], plug: UsbPlug) -> bytes:
    """Bytes of an item as they arrive with these faults, for device logic to use in `UsbDevice.bulk_in`.

    Raises
    ------
    UsbStall, UsbTimeout
        A fault of that kind struck; the item is lost.
    """
    for fault in faults:
        if fault.kind is FaultKind.DISCONNECT:
            plug.unplug(fault.seconds)
        elif fault.kind is FaultKind.STALL:
            raise UsbStall
        elif fault.kind is FaultKind.TIMEOUT:
            raise UsbTimeout
        elif fault.kind is FaultKind.SLOW:
            time.sleep(fault.seconds)
        data = damaged(data, fault)
    return data
