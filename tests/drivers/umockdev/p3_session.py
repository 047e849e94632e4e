"""What a driver of a Thermal Master P3 says to its camera, in little; run in a test and in its child process."""

from __future__ import annotations

import json
import zlib

from thermacq.transports import Transports
from thermacq_drivers.transports.usb import UsbPort, find_devices

IDS = [(0x3474, 0x45A2)]
PIXEL_BYTES = 197_632
# Read the model name: a worked example of the protocol, CRC included.
READ_MODEL = bytes.fromhex("0101810001000000000000001E0000004F90")


def session(transports: Transports, command: bytes = READ_MODEL) -> str:
    """Find the camera, ask its model, fetch one picture; everything that came, as JSON."""
    found = [(one.idVendor, one.idProduct, one.serial_number) for one in find_devices(transports, IDS)]
    port = UsbPort("left", transports, IDS, "P3-0001", interfaces=(0, 1))
    port.control_out(0x41, 0x20, 0, 0, command, "open")
    status = port.control_in(0xC1, 0x22, 0, 0, 1, "open")
    model = port.control_in(0xC1, 0x21, 0, 0, 30, "open")
    port.device.set_interface_altsetting(1, 1)
    port.control_out(0x40, 0xEE, 0, 1, b"", "arm")
    parts = [port.bulk_read(0x81, size, 2.0, "acquire") for size in (PIXEL_BYTES, 12, 12)]
    port.close()
    picture = [len(parts[0]), zlib.crc32(parts[0]), parts[1].hex(), parts[2].hex()]
    return json.dumps([found, status.hex(), model.decode().rstrip("\0"), picture])
