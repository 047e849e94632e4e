"""What the bytes of a P2 Pro or TC001 mean: vendor requests, and the thermal half of its pictures.

Facts from LeoDJ/P2Pro-Viewer. That counts are 1/64 K is taken over from other cameras of the family: UNCERTAIN.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any

import numpy as np

from thermacq.devices import Counts

ROWS, COLUMNS, RATE_HZ = 192, 256, 25.0
VIDEO_ROWS, FOURCC = 2 * ROWS, "YUYV"

# (bmRequestType, bRequest) and the value that every request has.
WRITE, READ, VALUE = (0x41, 0x45), (0xC1, 0x44), 0x0078
# wIndex: where a request goes to, or comes from.
STATUS, LAST_PART, FIRST_PART = 0x0200, 0x1D00, 0x9D00
DATA, LONG_DATA = 0x1D08, 0x1D10
_SET = 0x4000
_STEPS_TO_ONE = 127


class Command(IntEnum):
    """Numbers of commands."""

    DEVICE_INFO = 0x8405
    PARAMETERS = 0x8514


class Info(IntEnum):
    """What `Command.DEVICE_INFO` can be asked for."""

    FIRMWARE_DATE = 1
    PART_NUMBER = 6
    SERIAL = 7


INFO_BYTES = {Info.FIRMWARE_DATE: 8, Info.PART_NUMBER: 48, Info.SERIAL: 16}


class Parameter(IntEnum):
    """What `Command.PARAMETERS` reads and sets."""

    EMISSIVITY = 3
    GAIN = 5


def read_info(what: Info) -> bytes:
    """The 8 bytes that ask for a text, sent to `LAST_PART`; the answer is at `DATA`."""
    return struct.pack("<HI", Command.DEVICE_INFO, what) + struct.pack(">H", INFO_BYTES[what])


def read_parameter(what: Parameter) -> tuple[bytes, bytes]:
    """What asks for a parameter, sent to `FIRST_PART` and `DATA`; the answer, 2 bytes, is at `LONG_DATA`."""
    return _long(Command.PARAMETERS, what, 0), struct.pack(">II", 0, 2)


def set_parameter(what: Parameter, value: int) -> tuple[bytes, bytes]:
    """What sets a parameter, sent to `FIRST_PART` and `DATA`."""
    return _long(Command.PARAMETERS | _SET, what, value), bytes(8)


def _long(number: int, first: int, second: int) -> bytes:
    return struct.pack("<H", number) + struct.pack(">HI", first, second)


def parse_number(answer: bytes) -> int:
    """A parameter, 16 bits, high byte first; `ValueError` for anything else."""
    if len(answer) != 2:
        raise ValueError(f"a parameter has 2 bytes, not {len(answer)}")
    return int.from_bytes(answer, "big")


def parse_text(answer: bytes) -> str:
    """ASCII up to the first NUL, unprintable bytes left out."""
    text = answer.split(b"\0")[0]
    return bytes(byte for byte in text if 0x20 <= byte < 0x7F).decode("ascii").strip()


def is_ready(status: bytes) -> bool:
    """Whether a command is done; `ValueError` when the camera refused it, or the status is no status."""
    if len(status) != 1:
        raise ValueError(f"a status has 1 byte, not {len(status)}")
    if status[0] & 0xFC:
        raise ValueError(f"it refused a command (status {status[0]:02x})")
    return not status[0] & 0x03


def emissivity_steps(emissivity: float) -> int:
    """Emissivity in the steps of 1/127 that the camera takes, at least one."""
    return max(1, round(emissivity * _STEPS_TO_ONE))


def emissivity_of(steps: int) -> float:
    """Emissivity of so many steps."""
    return steps / _STEPS_TO_ONE


def thermal(picture: np.ndarray[Any, Any]) -> Counts:
    """Lower half of a picture, (192, 256) uint16 in 1/64 K, a view.

    Parameters
    ----------
    picture
        The bytes of one picture of 256 x 384 in ``YUYV``, in whatever shape OpenCV hands them out.

    Raises
    ------
    ValueError
        It is of another size.
    """
    data = np.ascontiguousarray(picture).reshape(-1).view(np.uint8)
    if data.size != 2 * VIDEO_ROWS * COLUMNS:
        raise ValueError(f"{data.size} of {2 * VIDEO_ROWS * COLUMNS} bytes came")
    return data.view("<u2").reshape(VIDEO_ROWS, COLUMNS)[ROWS:]
