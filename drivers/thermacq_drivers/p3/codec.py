"""What the bytes of a Thermal Master P3 or P1 mean: commands, markers, frames.

Facts from jvdillon/p3-ir-camera (the newer revision; its older snapshot has a wrong frame size and wrong CRCs).

A frame is a start marker, the pixels and an end marker. The markers are laid out like the payload headers of
USB video: bit 0 of the second byte toggles from frame to frame, bit 1 is the end of a frame, and the last
counter, 40 a frame modulo 2048, would be the milliseconds of the bus (UNCERTAIN). Its steps are therefore
rounded to frames, so that neither 40 exactly nor a jitter by a millisecond is taken for a loss.
"""

from __future__ import annotations

import binascii
import math
import re
import struct
from dataclasses import dataclass

import numpy as np

from thermacq.devices import Counts

WRITE, READ, START = (0x41, 0x20), (0xC1, 0x21), (0x40, 0xEE)
STATUS = (0xC1, 0x22)
STREAM_ENDPOINT = 0x81
RATE_HZ = 25.0
MARKER_BYTES = 12

_MARKER = struct.Struct("<BBIIH")
_START_OF_FRAME = re.compile(rb"\x0c[\x8c\x8d]")
_PACKET_BYTES = 512
_PERIOD = 40
_TURN = 2048
_JITTER = _PERIOD // 2


@dataclass(frozen=True)
class Model:
    """One model: its name and the size of its picture."""

    name: str
    rows: int
    columns: int

    @property
    def pixel_bytes(self) -> int:
        """Bytes between the markers: a displayable picture, two rows of metadata, the temperatures."""
        return 2 * (2 * self.rows + 2) * self.columns

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame with both markers."""
        return self.pixel_bytes + 2 * MARKER_BYTES

    @property
    def read_bytes(self) -> int:
        """What to ask for in one read: whole packets, more than the longer transfer of a frame has."""
        return (self.pixel_bytes + MARKER_BYTES) // _PACKET_BYTES * _PACKET_BYTES + _PACKET_BYTES


MODELS = {0x45A2: Model("P3", 192, 256), 0x45C2: Model("P1", 120, 160)}


def command(kind: int, parameter: int, register: int = 0, answer_bytes: int = 0) -> bytes:
    """The 18 bytes of a command, with its CRC-16/XMODEM (which the camera does not check)."""
    body = struct.pack("<HHH6xHH", kind, parameter, register, answer_bytes, 0)
    return body + struct.pack("<H", binascii.crc_hqx(body, 0))


def read_register(register: int, length: int) -> bytes:
    """Command that asks for a text; see `NAME` and the others."""
    return command(0x0101, 0x0081, register, length)


# (register, length of the answer)
NAME, FIRMWARE, SERIAL = (1, 30), (2, 12), (7, 64)
START_STREAM = command(0x2F01, 0x0081, 0, 1)
GAIN = {"low": command(0x2F01, 0x0041, 0), "high": command(0x2F01, 0x0041, 1)}
SHUTTER = command(0x3601, 0x0043)


def parse_text(answer: bytes) -> str:
    """ASCII up to the first NUL, unprintable bytes left out."""
    text = answer.split(b"\0")[0]
    return bytes(byte for byte in text if 0x20 <= byte < 0x7F).decode("ascii").strip()


def is_ready(status: bytes) -> bool:
    """Whether the status says that a command is done: 02 after a write, 03 after a read."""
    return status[:1] in (b"\x02", b"\x03")


@dataclass(frozen=True)
class Marker:
    """A marker: `cnt1` is the same at both ends of a frame, `cnt3` counts milliseconds modulo 2048."""

    sync: int
    cnt1: int
    cnt2: int
    cnt3: int


def parse_marker(data: bytes) -> Marker | None:
    """Take 12 bytes apart; None when they are no marker."""
    if len(data) != MARKER_BYTES:
        return None
    length, sync, cnt1, cnt2, cnt3 = _MARKER.unpack(data)
    if length != MARKER_BYTES or sync & 0xFC != 0x8C or cnt3 >= _TURN:
        return None
    return Marker(sync, cnt1, cnt2, cnt3)


@dataclass(frozen=True, eq=False)
class RawFrame:
    """A whole frame, and how many bytes that belong to none were passed over before it."""

    start: Marker
    end: Marker
    pixels: bytes
    skipped: int


class FrameFinder:
    """Finds whole frames in the bytes of the camera, however they are cut into transfers.

    A frame is whole when the end marker that belongs to its start marker stands where the pixels end. All
    else is passed over, byte by byte, so that a damaged frame never costs the next one.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._bytes = bytearray()
        self._skipped = 0

    def feed(self, data: bytes) -> list[RawFrame]:
        """Take bytes; returns the frames that they complete. Fewer bytes than a frame stay for the next call."""
        self._bytes += data
        found = []
        while self._seek() and len(self._bytes) >= self._model.frame_bytes:
            frame = self._whole_frame()
            if frame is None:
                self._pass_over(1)
            else:
                found.append(frame)
                del self._bytes[: self._model.frame_bytes]
                self._skipped = 0
        return found

    def _seek(self) -> bool:
        """Go to the next place that looks like a start marker; False when there is none yet."""
        place = _START_OF_FRAME.search(self._bytes)
        if place:
            self._pass_over(place.start())
            return True
        self._pass_over(len(self._bytes) - self._bytes.endswith(b"\x0c"))
        return False

    def _pass_over(self, number: int) -> None:
        del self._bytes[:number]
        self._skipped += number

    def _whole_frame(self) -> RawFrame | None:
        size = MARKER_BYTES + self._model.pixel_bytes
        start = parse_marker(bytes(self._bytes[:MARKER_BYTES]))
        end = parse_marker(bytes(self._bytes[size : size + MARKER_BYTES]))
        if start is None or end is None or end.sync != start.sync | 2 or end.cnt1 != start.cnt1:
            return None
        # The bytes of the next frame can complete an end marker that was cut, but not its time.
        if abs((end.cnt3 - start.cnt3 - _PERIOD + _TURN // 2) % _TURN - _TURN // 2) > _JITTER:
            return None
        return RawFrame(start, end, bytes(self._bytes[MARKER_BYTES:size]), self._skipped)


def lost_frames(ended: int, begins: int, elapsed_s: float) -> int:
    """Frames that are missing between two.

    Parameters
    ----------
    ended
        `Marker.cnt3` at the end of the earlier frame.
    begins
        `Marker.cnt3` at the start of the later one; the same when none is missing.
    elapsed_s
        Host time between the two: tells how often the count turned round (every 2.048 s) when many are
        missing.
    """
    step = (begins - ended + _JITTER) % _TURN - _JITTER
    turns = max(0, math.floor((elapsed_s * 1000 - _PERIOD - step) / _TURN + 0.25))
    return max(0, round((step + turns * _TURN) / _PERIOD))


def temperatures(pixels: bytes, model: Model) -> Counts:
    """The radiometric picture, (rows, columns) uint16 in 1/64 K, a view."""
    words = np.frombuffer(pixels, "<u2").reshape(2 * model.rows + 2, model.columns)
    return words[model.rows + 2 :]
