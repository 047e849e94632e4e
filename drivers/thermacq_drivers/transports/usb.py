"""A USB device found by its ids and serial number, with typed faults, over pyusb."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout

if TYPE_CHECKING:
    from thermacq.transports import Transports

_GONE = (errno.ENODEV, errno.ENOENT, errno.EIO)
_REMEDY = "Check power and cable; `thermacq devices` lists what is attached."


class UsbStalled(DeviceFault):
    """The device refused a request, or halted an endpoint; `UsbPort.clear_halt` lets it go on."""


def find_devices(transports: Transports, ids: Sequence[tuple[int, int]]) -> list[Any]:
    """Devices with one of these (vid, pid), as pyusb's; nothing is opened. Empty without libusb."""
    import usb.core

    try:
        return list(
            usb.core.find(
                find_all=True,
                backend=transports.usb_backend(),
                custom_match=lambda device: (device.idVendor, device.idProduct) in ids,
            )
        )
    except usb.core.NoBackendError:
        return []


def serial_of(device: Any) -> str:
    """Serial number of a pyusb device; empty when it has none or may not be asked."""
    with suppress(Exception):
        return str(device.serial_number or "")
    return ""


class UsbPort:
    """One USB device, opened, with one interface claimed.

    Parameters
    ----------
    device
        Name of the device in the rig, for faults.
    transports
        Where to look.
    ids
        (vid, pid) that are taken.
    serial
        Serial number that the rig expects; empty accepts any, if there is only one.
    interfaces
        Interfaces to claim; a driver of the kernel that holds one is detached. None at all leaves the
        device to the kernel's driver (a camera that streams as USB video) and sends it requests beside that.
    among
        Some of `find_devices` to choose from; by default all that are attached.

    Raises
    ------
    DeviceDisconnected
        There is none, or no such one.
    DeviceFault
        There are several and nothing says which, or it may not be opened.
    """

    def __init__(
        self,
        device: str,
        transports: Transports,
        ids: Sequence[tuple[int, int]],
        serial: str = "",
        interfaces: Sequence[int] = (0,),
        among: list[Any] | None = None,
    ) -> None:
        self._name = device
        found = find_devices(transports, ids) if among is None else among
        self.device = self._choose(found, serial)
        if interfaces:
            with self._faults("open"):
                self.device.set_configuration()
            self._claim(interfaces)

    def _choose(self, found: list[Any], wanted: str) -> Any:
        serials = [serial_of(device) for device in found]
        fitting = [device for device, serial in zip(found, serials, strict=True) if wanted in ("", serial)]
        seen = ", ".join(serial or "without serial number" for serial in serials) or "none"
        if not fitting:
            what = f"no device with serial '{wanted}'" if wanted else "it was not found on USB"
            raise DeviceDisconnected(self._name, "open", f"{what}; attached: {seen}", remedy=_REMEDY)
        if len(fitting) > 1:
            raise DeviceFault(
                self._name,
                "open",
                f"several devices fit: {seen}",
                remedy="Say in the rig which one is meant: its serial.",
            )
        return fitting[0]

    def _claim(self, interfaces: Sequence[int]) -> None:
        import usb.util

        with self._faults("open"):
            for number in interfaces:
                with suppress(NotImplementedError):
                    if self.device.is_kernel_driver_active(number):
                        self.device.detach_kernel_driver(number)
                usb.util.claim_interface(self.device, number)

    @property
    def serial(self) -> str:
        """Serial number of the device; empty when it has none."""
        return serial_of(self.device)

    def control_in(
        self,
        request_type: int,
        request: int,
        value: int,
        index: int,
        length: int,
        stage: str,
        timeout_s: float = 1.0,
    ) -> bytes:
        """Ask; returns at most `length` bytes."""
        with self._faults(stage):
            return bytes(
                self.device.ctrl_transfer(request_type, request, value, index, length, _ms(timeout_s))
            )

    def control_out(
        self,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: bytes,
        stage: str,
        timeout_s: float = 1.0,
    ) -> None:
        """Tell."""
        with self._faults(stage):
            self.device.ctrl_transfer(request_type, request, value, index, data, _ms(timeout_s))

    def bulk_read(self, endpoint: int, length: int, timeout_s: float, stage: str) -> bytes:
        """Read at most `length` bytes in one transfer."""
        with self._faults(stage):
            return self.device.read(endpoint, length, _ms(timeout_s)).tobytes()  # type: ignore[no-any-return]

    def bulk_write(self, endpoint: int, data: bytes, timeout_s: float, stage: str) -> int:
        """Write in one transfer; returns how many bytes were taken."""
        with self._faults(stage):
            return int(self.device.write(endpoint, data, _ms(timeout_s)))

    def select(self, interface: int, alternate: int, stage: str) -> None:
        """Choose an alternate setting of a claimed interface."""
        with self._faults(stage):
            self.device.set_interface_altsetting(interface, alternate)

    def clear_halt(self, endpoint: int, stage: str) -> None:
        """Let a stalled endpoint go on."""
        with self._faults(stage):
            self.device.clear_halt(endpoint)

    def close(self) -> None:
        """Let go of everything; never raises, for the device may be gone."""
        import usb.util

        with suppress(Exception):
            usb.util.dispose_resources(self.device)

    @contextmanager
    def _faults(self, stage: str) -> Iterator[None]:
        """Turn what pyusb raises into the typed faults."""
        import usb.core

        try:
            yield
        except usb.core.USBTimeoutError:
            raise DeviceTimeout(self._name, stage, "it did not answer in time") from None
        except usb.core.USBError as error:
            raise self._fault(stage, error) from None

    def _fault(self, stage: str, error: OSError) -> DeviceFault:
        if error.errno in _GONE:
            return DeviceDisconnected(self._name, stage, "it is gone from USB", remedy=_REMEDY)
        if error.errno == errno.EPIPE:
            return UsbStalled(self._name, stage, "it refused a request (stall)")
        if error.errno == errno.EACCES:
            return DeviceFault(
                self._name,
                stage,
                "it may not be opened by this user",
                remedy="`thermacq doctor` says how to allow it.",
            )
        if error.errno == errno.EBUSY:
            return DeviceFault(
                self._name, stage, "another program uses it", remedy="Close the other program."
            )
        return DeviceFault(self._name, stage, f"USB error: {error.strerror}")


def _ms(seconds: float) -> int:
    return max(1, round(seconds * 1000))
