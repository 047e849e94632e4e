"""A backend of pyusb over emulated devices: ``usb.core.find(backend=...)`` finds them and talks to them.

The backend keeps the rules of the bus (a device has to be opened, its interface claimed by one host only,
a device that was pulled is gone for every handle that was open) and turns what the device logic raises into
the errors of libusb.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import usb.backend
import usb.core

from thermacq.testing.emulation.usb import Interface, UsbDescription, UsbPlug, UsbStall, UsbTimeout

_LIBUSB = {errno.EIO: -1, errno.ENODEV: -4, errno.EBUSY: -6, errno.ETIMEDOUT: -7, errno.EPIPE: -9}
_WORDS = {
    errno.EIO: "Input/Output Error",
    errno.ENODEV: "No such device (it may have been disconnected)",
    errno.EBUSY: "Resource busy",
    errno.ETIMEDOUT: "Operation timed out",
    errno.EPIPE: "Pipe error",
}
_GET_DESCRIPTOR, _STRING = 0x06, 0x03
_ENGLISH = 0x0409


@dataclass(eq=False)
class _Handle:
    plug: UsbPlug
    life: int
    closed: bool = False
    interfaces: set[int] = field(default_factory=set)

    def gone(self) -> bool:
        return self.closed or not self.plug.plugged or self.plug.life != self.life


def usb_error(code: int) -> usb.core.USBError:
    """The error that pyusb raises over libusb for this errno."""
    kind = usb.core.USBTimeoutError if code == errno.ETIMEDOUT else usb.core.USBError
    return kind(_WORDS[code], _LIBUSB[code], code)


class EmulatedBackend(usb.backend.IBackend):  # type: ignore[misc]
    """A bus with emulated devices; hand it to ``usb.core.find(backend=...)``."""

    def __init__(self, plugs: Sequence[UsbPlug]) -> None:
        super().__init__()
        self._plugs = tuple(plugs)

    def enumerate_devices(self) -> list[tuple[UsbPlug, int]]:
        """Devices that are plugged in, each with the life that it lives now."""
        return [(plug, plug.life) for plug in self._plugs if plug.plugged]

    def get_parent(self, dev: Any) -> None:  # noqa: ARG002
        """No hubs here."""
        return

    def get_device_descriptor(self, dev: tuple[UsbPlug, int]) -> SimpleNamespace:
        """Device descriptor, and where on the bus it is."""
        plug, life = dev
        said = plug.device.description
        port = self._plugs.index(plug) + 1
        return SimpleNamespace(
            bLength=18,
            bDescriptorType=1,
            bcdUSB=0x0200,
            bDeviceClass=said.device_class,
            bDeviceSubClass=0,
            bDeviceProtocol=0,
            bMaxPacketSize0=64,
            idVendor=said.vid,
            idProduct=said.pid,
            bcdDevice=said.bcd_device,
            iManufacturer=1 if said.manufacturer else 0,
            iProduct=2 if said.product else 0,
            iSerialNumber=3 if said.serial else 0,
            bNumConfigurations=1,
            # A device gets a new address each time it is plugged in.
            address=(10 * port + life) % 128,
            bus=1,
            port_number=port,
            port_numbers=(port,),
            speed=3,
        )

    def get_configuration_descriptor(self, dev: tuple[UsbPlug, int], config: int) -> SimpleNamespace:
        """The one configuration."""
        if config != 0:
            raise IndexError(f"there is no configuration {config}")
        return SimpleNamespace(
            bLength=9,
            bDescriptorType=2,
            wTotalLength=0,
            bNumInterfaces=len(_numbers(dev[0])),
            bConfigurationValue=1,
            iConfiguration=0,
            bmAttributes=0x80,
            bMaxPower=250,
            extra_descriptors=b"",
        )

    def get_interface_descriptor(
        self, dev: tuple[UsbPlug, int], intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Descriptor of an alternate setting, both by their place in the list."""
        found = self._interface(dev[0], intf, alt, config)
        return SimpleNamespace(
            bLength=9,
            bDescriptorType=4,
            bInterfaceNumber=found.number,
            bAlternateSetting=found.alternate,
            bNumEndpoints=len(found.endpoints),
            bInterfaceClass=found.interface_class,
            bInterfaceSubClass=0,
            bInterfaceProtocol=0,
            iInterface=0,
            extra_descriptors=b"",
        )

    def get_endpoint_descriptor(
        self, dev: tuple[UsbPlug, int], ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Descriptor of an endpoint by its place in the list."""
        found = self._interface(dev[0], intf, alt, config).endpoints[ep]
        return SimpleNamespace(
            bLength=7,
            bDescriptorType=5,
            bEndpointAddress=found.address,
            bmAttributes=found.attributes,
            wMaxPacketSize=found.packet_bytes,
            bInterval=0,
            bRefresh=0,
            bSynchAddress=0,
            extra_descriptors=b"",
        )

    def _interface(self, plug: UsbPlug, place: int, alternate: int, config: int) -> Interface:
        if config != 0:
            raise IndexError(f"there is no configuration {config}")
        number = _numbers(plug)[place]
        return [item for item in plug.device.description.interfaces if item.number == number][alternate]

    def open_device(self, dev: tuple[UsbPlug, int]) -> _Handle:
        """Open; raises ENODEV when it was pulled."""
        plug, life = dev
        handle = _Handle(plug, life)
        _demand_there(handle)
        return handle

    def close_device(self, dev_handle: _Handle) -> None:
        """Close; lets go of its interfaces."""
        for number in list(dev_handle.interfaces):
            self._release(dev_handle, number)
        dev_handle.closed = True

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        """Choose the configuration; there is only 1."""
        _demand_there(dev_handle)
        if config_value not in (0, 1):
            raise usb_error(errno.EIO)
        dev_handle.plug.configuration = config_value

    def get_configuration(self, dev_handle: _Handle) -> int:
        """The configuration in force; 0 before one was chosen."""
        _demand_there(dev_handle)
        return dev_handle.plug.configuration

    def set_interface_altsetting(self, dev_handle: _Handle, intf: int, altsetting: int) -> None:
        """Choose an alternate setting of a claimed interface."""
        self._demand_claimed(dev_handle, intf)
        dev_handle.plug.device.select(intf, altsetting)

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Claim; raises EBUSY when another handle has it."""
        _demand_there(dev_handle)
        if intf not in _numbers(dev_handle.plug):
            raise usb_error(errno.EIO)
        if dev_handle.plug.claimed.setdefault(intf, dev_handle) is not dev_handle:
            raise usb_error(errno.EBUSY)
        dev_handle.interfaces.add(intf)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Let go of an interface."""
        self._release(dev_handle, intf)
        _demand_there(dev_handle)

    def _release(self, handle: _Handle, number: int) -> None:
        handle.interfaces.discard(number)
        if handle.plug.claimed.get(number) is handle:
            del handle.plug.claimed[number]

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: Any, timeout: int) -> int:
        """Fill a buffer from an endpoint and return how many bytes came; `timeout` in ms, 0 waits on."""
        self._demand_claimed(dev_handle, intf)
        length: int = len(buff) * buff.itemsize
        data: bytes = _done(
            dev_handle,
            lambda: dev_handle.plug.device.bulk_in(ep, length, _seconds(timeout), dev_handle.gone),
        )
        memoryview(buff).cast("B")[: len(data)] = data[:length]
        return min(len(data), length)

    def bulk_write(self, dev_handle: _Handle, ep: int, intf: int, data: Any, timeout: int) -> int:
        """Send to an endpoint and return how many bytes were taken."""
        self._demand_claimed(dev_handle, intf)
        sent = data.tobytes()
        taken: int = _done(dev_handle, lambda: dev_handle.plug.device.bulk_out(ep, sent, _seconds(timeout)))
        return taken

    def intr_read(self, dev_handle: _Handle, ep: int, intf: int, buff: Any, timeout: int) -> int:
        """As `bulk_read`."""
        return self.bulk_read(dev_handle, ep, intf, buff, timeout)

    def intr_write(self, dev_handle: _Handle, ep: int, intf: int, data: Any, timeout: int) -> int:
        """As `bulk_write`."""
        return self.bulk_write(dev_handle, ep, intf, data, timeout)

    def ctrl_transfer(
        self,
        dev_handle: _Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: Any,
        timeout: int,  # noqa: ARG002
    ) -> int:
        """Make a control transfer; string descriptors are answered here, all else by the device."""
        _demand_there(dev_handle)
        device = dev_handle.plug.device
        if not bmRequestType & 0x80:
            sent = data.tobytes()
            _done(dev_handle, lambda: device.control_out(bmRequestType, bRequest, wValue, wIndex, sent))
            return len(sent)
        length = len(data) * data.itemsize
        if (bmRequestType, bRequest, wValue >> 8) == (0x80, _GET_DESCRIPTOR, _STRING):
            answer = _string_descriptor(device.description, wValue & 0xFF)
        else:
            answer = _done(
                dev_handle, lambda: device.control_in(bmRequestType, bRequest, wValue, wIndex, length)
            )
        answer = answer[:length]
        memoryview(data).cast("B")[: len(answer)] = answer
        return len(answer)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        """End a stall."""
        _demand_there(dev_handle)
        dev_handle.plug.device.clear_halt(ep)

    def reset_device(self, dev_handle: _Handle) -> None:
        """Reset the device; it starts afresh."""
        _demand_there(dev_handle)
        dev_handle.plug.device.power_up()

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:  # noqa: ARG002
        """Never: no kernel knows these devices."""
        _demand_there(dev_handle)
        return False

    def detach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:  # noqa: ARG002
        """Nothing to detach."""
        _demand_there(dev_handle)

    def attach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:  # noqa: ARG002
        """Nothing to attach."""
        _demand_there(dev_handle)

    def _demand_claimed(self, handle: _Handle, number: int) -> None:
        _demand_there(handle)
        if number not in handle.interfaces:
            raise usb_error(errno.EIO)


def _numbers(plug: UsbPlug) -> list[int]:
    return sorted({item.number for item in plug.device.description.interfaces})


def _seconds(timeout_ms: int) -> float:
    return timeout_ms / 1000 if timeout_ms > 0 else float("inf")


def _demand_there(handle: _Handle) -> None:
    if handle.gone():
        raise usb_error(errno.ENODEV)


def _done(handle: _Handle, transfer: Callable[[], Any]) -> Any:
    """Do a transfer; what the device logic raises becomes the error of libusb, and being pulled wins."""
    try:
        result = transfer()
    except UsbStall:
        code = errno.EPIPE
    except UsbTimeout:
        code = errno.ETIMEDOUT
    else:
        _demand_there(handle)
        return result
    _demand_there(handle)
    raise usb_error(code)


def _string_descriptor(said: UsbDescription, index: int) -> bytes:
    texts = {1: said.manufacturer, 2: said.product, 3: said.serial}
    if index == 0:
        body = _ENGLISH.to_bytes(2, "little")
    elif texts.get(index):
        body = texts[index].encode("utf-16-le")
    else:
        raise usb_error(errno.EPIPE)
    return bytes([len(body) + 2, _STRING]) + body
