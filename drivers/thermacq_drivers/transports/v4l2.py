"""Which formats a Video4Linux node offers: the list that OpenCV does not give (ioctls of videodev2.h)."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator

# Numbers of the ioctls hold direction, size of the record, letter 'V' and a number.
_ENUM_FMT = 0xC0405602
_ENUM_FRAMESIZES = 0xC02C564A
_ENUM_FRAMEINTERVALS = 0xC034564B
_CAPTURE = 1
_DISCRETE = 1
_MOST = 64

Ioctl = Callable[[int, bytearray], bytes | None]
"""Makes one ioctl with a record and returns what the kernel made of it; None when there is no more."""


def offered_formats(path: str) -> list[str]:
    """Formats of a node, such as ``160 x 120 'Y16 ' at 9 frames/s``; empty for what is no V4L2 node."""
    import fcntl

    try:
        node = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    except OSError:
        return []

    def ioctl(number: int, record: bytearray) -> bytes | None:
        try:
            fcntl.ioctl(node, number, record)
        except OSError:
            return None
        return bytes(record)

    try:
        return list(list_formats(ioctl))
    finally:
        os.close(node)


def list_formats(ioctl: Ioctl) -> Iterator[str]:
    """One line for each pixel format and size, with its rates."""
    for letters in _pixel_formats(ioctl):
        for columns, rows in _sizes(ioctl, letters):
            rates = ", ".join(f"{rate:.4g}" for rate in _rates(ioctl, letters, columns, rows))
            name = letters.decode("ascii", "replace")
            yield f"{columns} x {rows} '{name}'" + (f" at {rates} frames/s" if rates else "")


def _pixel_formats(ioctl: Ioctl) -> Iterator[bytes]:
    for index in range(_MOST):
        said = ioctl(_ENUM_FMT, bytearray(struct.pack("<II", index, _CAPTURE).ljust(64, b"\0")))
        if said is None:
            return
        yield said[44:48]


def _sizes(ioctl: Ioctl, letters: bytes) -> Iterator[tuple[int, int]]:
    for index in range(_MOST):
        said = ioctl(_ENUM_FRAMESIZES, bytearray((struct.pack("<I", index) + letters).ljust(44, b"\0")))
        if said is None:
            return
        kind, columns, rows = struct.unpack_from("<3I", said, 8)
        if kind == _DISCRETE:
            yield columns, rows


def _rates(ioctl: Ioctl, letters: bytes, columns: int, rows: int) -> Iterator[float]:
    for index in range(_MOST):
        asked = struct.pack("<I4sII", index, letters, columns, rows).ljust(52, b"\0")
        said = ioctl(_ENUM_FRAMEINTERVALS, bytearray(asked))
        if said is None:
            return
        kind, numerator, denominator = struct.unpack_from("<3I", said, 16)
        if kind == _DISCRETE and numerator:
            yield denominator / numerator
