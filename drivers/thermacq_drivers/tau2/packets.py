"""The serial protocol of the Tau 2: packets with two CRC-16/XMODEM; pure functions.

Facts from flirpy. UNCERTAIN: the numbers of the FFC modes (those that are usual with FLIR), and those of the
external sync; settings override the latter.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from enum import IntEnum

_MARK = 0x6E
_HEAD_BYTES, _CRC_BYTES = 6, 2
# The longest answers carry 256 bytes (memory); more is a damaged length.
_LONGEST_DATA = 256
_ZERO_CELSIUS_K = 273.15

FFC_MODES = ("manual", "auto", "external")


class Function(IntEnum):
    """Numbers of functions."""

    SERIAL_NUMBER = 0x04
    REVISION = 0x05
    FFC_MODE = 0x0B
    DO_FFC = 0x0C
    READ_SENSOR = 0x20
    EXTERNAL_SYNC = 0x21


class Sensor(IntEnum):
    """What `Function.READ_SENSOR` can be asked for."""

    FPA = 0x00
    HOUSING = 0x0A
    STATUS = 0x11


FFC_RUNNING = 1 << 6
"""Bit of `Sensor.STATUS`."""

STATUS_WORDS = {
    0x02: "it is not ready",
    0x03: "the value is out of range",
    0x04: "undefined error",
    0x05: "undefined process",
    0x06: "it does not know this function",
    0x07: "timeout",
    0x09: "wrong number of bytes",
    0x0A: "this feature is not enabled",
}


def packet(function: int, data: bytes = b"") -> bytes:
    """Bytes of a packet to the camera; an answer that is well looks the same."""
    head = struct.pack(">4BH", _MARK, 0, 0, function, len(data))
    crcs = binascii.crc_hqx(head, 0), binascii.crc_hqx(data, 0)
    return head + struct.pack(">H", crcs[0]) + data + struct.pack(">H", crcs[1])


def word(value: int) -> bytes:
    """Argument of two bytes."""
    return struct.pack(">H", value)


def ask_sensor(sensor: Sensor) -> bytes:
    """Packet that asks for a temperature, or the status bits."""
    return packet(Function.READ_SENSOR, word(sensor))


@dataclass(frozen=True)
class Answer:
    """An answer of the camera; `status` 0 is well."""

    function: int
    status: int
    data: bytes


class AnswerFinder:
    """Finds answers in bytes that come one by one; bytes that are none are passed over and counted."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.passed_over = 0

    def feed(self, data: bytes) -> list[Answer]:
        """Take bytes; returns the answers that they complete."""
        self._bytes += data
        found: list[Answer] = []
        while len(self._bytes) >= _HEAD_BYTES + _CRC_BYTES:
            mark, status, _, function, length = struct.unpack(">4BH", self._bytes[:_HEAD_BYTES])
            head = bytes(self._bytes[: _HEAD_BYTES + _CRC_BYTES])
            # A CRC over bytes and their own CRC is 0.
            if mark != _MARK or binascii.crc_hqx(head, 0) or length > _LONGEST_DATA:
                self._pass_over()
                continue
            whole = len(head) + length + _CRC_BYTES
            if len(self._bytes) < whole:
                break
            content = bytes(self._bytes[len(head) : whole])
            if binascii.crc_hqx(content, 0):
                self._pass_over()
                continue
            del self._bytes[:whole]
            found.append(Answer(function, status, content[:-_CRC_BYTES]))
        return found

    def _pass_over(self) -> None:
        del self._bytes[:1]
        self.passed_over += 1


def parse_word(data: bytes) -> int:
    """A number of two bytes; `ValueError` for anything else."""
    if len(data) != 2:
        raise ValueError(f"2 bytes were expected, {len(data)} came")
    return int.from_bytes(data, "big")


def parse_serial(data: bytes) -> tuple[int, int]:
    """Serial numbers of camera and sensor; `ValueError` when there are none."""
    if len(data) != 8:
        raise ValueError(f"8 bytes were expected, {len(data)} came")
    camera, sensor = struct.unpack(">II", data)
    return camera, sensor


def parse_temperature(data: bytes, sensor: Sensor) -> float:
    """Kelvin; the focal-plane array is told in tenths of a degree Celsius, the housing in hundredths, signed."""
    signed = struct.unpack(">h", word(parse_word(data)))[0]
    return float(signed / (10 if sensor is Sensor.FPA else 100) + _ZERO_CELSIUS_K)
