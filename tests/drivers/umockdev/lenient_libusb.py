"""Lets pass what umockdev's replay cannot answer; import it before a device is looked for.

The requests still go through the real libusb and are refused by the replay; only the refusal is swallowed.
"""

from __future__ import annotations

from typing import Any

import usb.core
from usb.backend import libusb1


def _lenient(name: str, otherwise: object) -> None:
    real = getattr(libusb1._LibUSB, name)

    def call(*arguments: Any) -> Any:
        try:
            return real(*arguments)
        except usb.core.USBError:
            return otherwise

    setattr(libusb1._LibUSB, name, call)


_lenient("set_configuration", None)
_lenient("set_interface_altsetting", None)
_lenient("is_kernel_driver_active", False)
