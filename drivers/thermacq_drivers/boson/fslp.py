"""FSLP, the serial protocol of the FLIR Boson: frames with a checksum, commands and replies; pure functions.

A frame is ``8E``, then channel, payload and CRC-16 (CCITT, from 0x1D0F, high byte first) with the three
special bytes escaped, then ``AE``. Facts from public SDK copies and flirpy.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from enum import IntEnum

START, ESCAPE, END = 0x8E, 0x9E, 0xAE
_ESCAPED = {START: 0x81, ESCAPE: 0x91, END: 0xA1}
_UNESCAPED = {code: byte for byte, code in _ESCAPED.items()}
_CRC_START = 0x1D0F
_LONGEST_FRAME = 2048
_NO_STATUS = 0xFFFFFFFF
COMMAND_CHANNEL = 0x00


class Function(IntEnum):
    """Functions of the camera that the driver calls; arguments and answers are big-endian."""

    CAMERA_SERIAL = 0x00050002
    CAMERA_PART = 0x00050004
    RUN_FFC = 0x00050007
    SET_FFC_MODE = 0x00050012
    FFC_MODE = 0x00050013
    SET_GAIN_MODE = 0x00050014
    GAIN_MODE = 0x00050015
    SOFTWARE_REVISION = 0x00050022
    FPA_TEMPERATURE = 0x00050030
    FFC_STATUS = 0x00050054
    SET_EXT_SYNC = 0x00050098
    SET_TELEMETRY_STATE = 0x00040001
    SET_TELEMETRY_LOCATION = 0x00040003
    SET_TELEMETRY_PACKING = 0x00040005
    SET_TELEMETRY_ORDER = 0x00040007
    FRAME_RATE = 0x000E0007
    SET_USB_16_BIT_MODE = 0x000E000D


STATUS = {
    0x0161: "it does not know this command",
    0x0162: "bad payload status",
    0x017D: "too few bytes",
    0x017E: "too many bytes",
    0x017F: "overflow",
    0x0181: "invalid input",
    0x01B0: "this feature is not enabled",
    0x0202: "it is not ready",
    0x0203: "value out of range",
    0x0283: "it is busy",
}
UNKNOWN_COMMAND, NOT_ENABLED = 0x0161, 0x01B0


@dataclass(frozen=True)
class Reply:
    """Answer to the command with the same sequence number and function; status 0 is good."""

    sequence: int
    function: int
    status: int
    data: bytes


def crc(data: bytes) -> int:
    """Checksum over channel and payload, unescaped."""
    return binascii.crc_hqx(data, _CRC_START)


def frame(channel: int, payload: bytes) -> bytes:
    """Bytes of a frame on the wire."""
    content = bytes([channel]) + payload
    content += crc(content).to_bytes(2, "big")
    escaped = b"".join(
        bytes((ESCAPE, _ESCAPED[byte])) if byte in _ESCAPED else bytes((byte,)) for byte in content
    )
    return bytes((START,)) + escaped + bytes((END,))


def command(sequence: int, function: int, arguments: bytes = b"") -> bytes:
    """Bytes that call a function of the camera."""
    return frame(COMMAND_CHANNEL, struct.pack(">III", sequence, function, _NO_STATUS) + arguments)


def parse_reply(payload: bytes) -> Reply | None:
    """Reply in the payload of a frame of the command channel; None when it is too short for one."""
    if len(payload) < 12:
        return None
    sequence, function, status = struct.unpack(">III", payload[:12])
    return Reply(sequence, function, status, payload[12:])


class FrameParser:
    """Frames out of bytes in whatever pieces they come; bytes between frames are none of ours.

    `damaged` counts frames that began and did not end well: a wrong checksum, an escape that does not exist,
    a new start inside, or too long.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._inside: bytearray | None = None

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Take bytes and return channel and payload of each complete frame."""
        frames = []
        for byte in data:
            if byte == START:
                self.damaged += self._inside is not None
                self._inside = bytearray()
            elif self._inside is None:
                continue
            elif byte == END:
                content, self._inside = _unescaped(self._inside), None
                if content is None or len(content) < 3 or crc(content) != 0:
                    self.damaged += 1
                else:
                    frames.append((content[0], content[1:-2]))
            elif len(self._inside) < _LONGEST_FRAME:
                self._inside.append(byte)
            else:
                self._inside = None
                self.damaged += 1
        return frames


def _unescaped(data: bytearray) -> bytes | None:
    """Content without escapes; None when an escape stands for nothing."""
    content = bytearray()
    position = 0
    while position < len(data):
        byte = data[position]
        if byte == ESCAPE:
            position += 1
            if position == len(data) or data[position] not in _UNESCAPED:
                return None
            byte = _UNESCAPED[data[position]]
        content.append(byte)
        position += 1
    return bytes(content)
