"""The stream of the TeAx grabber: frames and bytes of the camera's serial port, out of FTDI's packets.

Behind "TEAX" stands the number of 16-bit words that follow (32 bits, low byte first). The upper two bits of a word say
what it is: 11 a pixel of 14 bits, 01 and 10 synchronisation between rows, 00 nothing, or in the first word a
time stamp of unknown unit. So the layout is read by TeAx' own library (libthermalgrabber); flirpy's header of
10 bytes and pad words on both sides of a row are the same bytes. Flirpy's "width + 2 at offset 5" is the middle of
the number of words, and holds for cameras of 256 rows only.

As no two bytes of pixels can be part of "TEAX" or "UART", a mark inside a frame tells that the frame is damaged.
"""

from __future__ import annotations

import re
import struct

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import Counts

STREAM_IN, STREAM_OUT = 0x81, 0x02
PACKET_BYTES = 512
STATUS_BYTES = 2
BIT_DEPTH = 14

# FTDI's vendor requests, for interface A.
OUT = 0x40
INTERFACE_A = 1
RESET, SET_LATENCY, SET_BITMODE = 0x00, 0x09, 0x0B
RESET_ALL, PURGE_RECEIVED = 0, 1
BITMODE_RESET, BITMODE_SYNC_FIFO = 0x00FF, 0x40FF
LATENCY_MS = 2

_MARK = re.compile(rb"TEAX|UART")
_UART_BYTES = 6
_HEAD_BYTES = 8
# As in TeAx' library.
_FEWEST_WORDS, _MOST_WORDS = 20_480, 384_000
_LONGEST_NOISE_BYTES = 512
_PIXEL = 0xC000
# Pixels: (rows, columns).
SIZES = {
    rows * columns: (rows, columns)
    for rows, columns in ((512, 640), (480, 640), (256, 336), (256, 324), (256, 320), (240, 320), (128, 160))
}


def without_status(data: bytes) -> bytes:
    """Bytes of one bulk transfer without the two status bytes that begin each packet of 512."""
    full = len(data) // PACKET_BYTES
    packets = np.frombuffer(data, np.uint8, full * PACKET_BYTES).reshape(full, PACKET_BYTES)
    return packets[:, STATUS_BYTES:].tobytes() + data[full * PACKET_BYTES + STATUS_BYTES :]


def to_serial_port(data: bytes) -> bytes:
    """Wrap bytes for the camera's serial port, at most 255."""
    return b"UART" + bytes([len(data)]) + data


def picture(words: NDArray[np.uint16]) -> Counts | None:
    """Pixels among the words of a frame, (rows, columns) uint16 of 14 bits; None when it is damaged."""
    pixels = words[(words & _PIXEL) == _PIXEL]
    size = SIZES.get(pixels.size)
    return None if size is None else (pixels & ~np.uint16(_PIXEL)).reshape(size)


class StreamFinder:
    """Takes the stream apart, however it is cut: pictures, and what the camera's serial port said.

    Nothing is counted before the first good frame: the stream begins anywhere.

    Attributes
    ----------
    serial
        Bytes of the serial port so far; whoever takes them clears it.
    damaged
        Frames that came damaged, and stretches of bytes that belong to nothing.
    """

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._seen = 0
        self._skipped = 0
        # Size of the last good frame; 0 before the first.
        self._frame_bytes = 0
        self.serial = bytearray()
        self.damaged = 0

    def feed(self, data: bytes) -> list[Counts]:
        """Take bytes of the stream; returns the pictures that they complete."""
        self._bytes += data
        found: list[Counts] = []
        while True:
            mark = _MARK.search(self._bytes)
            if mark is None:
                self._pass_over(max(0, len(self._bytes) - 3))
                return found
            self._pass_over(mark.start())
            is_frame = self._bytes.startswith(b"TEAX")
            if not (self._take_frame(found) if is_frame else self._take_byte()):
                return found

    def _take_byte(self) -> bool:
        if len(self._bytes) < _UART_BYTES:
            return False
        self.serial.append(self._bytes[_UART_BYTES - 1])
        self._drop(_UART_BYTES)
        return True

    def _take_frame(self, found: list[Counts]) -> bool:
        """Take the frame at the front, good or damaged; False while it is not whole."""
        if len(self._bytes) < _HEAD_BYTES:
            return False
        words = struct.unpack_from("<I", self._bytes, 4)[0]
        if not _FEWEST_WORDS < words < _MOST_WORDS:
            self._note_damage(4)
            return True
        whole = _HEAD_BYTES + 2 * words
        next_mark = _MARK.search(self._bytes, max(4, self._seen - 3), whole + 3)
        if next_mark is not None and next_mark.start() < whole:
            self._note_damage(next_mark.start())
            return True
        self._seen = len(self._bytes)
        if len(self._bytes) < whole:
            return False
        counts = picture(np.frombuffer(bytes(self._bytes[_HEAD_BYTES:whole]), "<u2"))
        if counts is None:
            self._note_damage(whole)
        else:
            found.append(counts)
            self._frame_bytes = whole
            self._drop(whole)
        return True

    def _note_damage(self, number: int) -> None:
        self.damaged += self._frame_bytes > 0
        self._drop(number)

    def _drop(self, number: int) -> None:
        """Be done with so many bytes; long noise before them was frames whose mark was damaged."""
        if self._skipped > _LONGEST_NOISE_BYTES and self._frame_bytes:
            self.damaged += max(1, round(self._skipped / self._frame_bytes))
        self._skipped = 0
        self._forget(number)

    def _pass_over(self, number: int) -> None:
        if number:
            self._skipped += number
            self._forget(number)

    def _forget(self, number: int) -> None:
        del self._bytes[:number]
        self._seen = 0
