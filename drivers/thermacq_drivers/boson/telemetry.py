"""The telemetry row of the FLIR Boson in its pictures over USB: where it is, how it is packed, what it says.

Sources differ in how the row is packed: two bytes of the record in each pixel, high word first (512 + 2 rows,
asked for by the driver); or one byte in each pixel, low byte first (a test for the Boson+). So it is looked for
by the camera's serial number, which the record holds and which is known from elsewhere. Not checked on hardware.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Packing: TypeAlias = Literal["16-bit", "8-bit"]
PACKINGS: tuple[Packing, ...] = ("16-bit", "8-bit")
EXTRA_ROWS = 2
"""Rows of a picture with telemetry beyond those of the sensor; all at its top, or all at its bottom."""

# Offsets in the record, in bytes.
_SERIAL, _COUNTER, _LAST_FFC, _TIME_MS = 2, 84, 88, 280


@dataclass(frozen=True)
class Telemetry:
    """What the record says: camera's serial number, frame counter, that of the last FFC, time since its start."""

    serial: int
    counter: int
    last_ffc: int
    time_ms: int


@dataclass(frozen=True)
class Place:
    """Where the record is: packing, and row of the picture; rows above the middle count from the top."""

    packing: Packing
    row: int

    @property
    def picture(self) -> slice:
        """Rows of the picture that the sensor sees."""
        return slice(EXTRA_ROWS, None) if self.row >= 0 else slice(None, -EXTRA_ROWS)


def read_telemetry(row: NDArray[np.uint16], packing: Packing) -> Telemetry:
    """Read a row, (columns,) uint16, as a record; whether it is one shows in the serial number."""
    words = _word_at_16_bit if packing == "16-bit" else _word_at_8_bit
    return Telemetry(
        serial=words(row, _SERIAL),
        counter=words(row, _COUNTER),
        last_ffc=words(row, _LAST_FFC),
        time_ms=words(row, _TIME_MS),
    )


def _word_at_16_bit(row: NDArray[np.uint16], offset: int) -> int:
    return int(row[offset // 2]) << 16 | int(row[offset // 2 + 1])


def _word_at_8_bit(row: NDArray[np.uint16], offset: int) -> int:
    return int.from_bytes(bytes(int(pixel) & 0xFF for pixel in row[offset : offset + 4]), "little")


def find_telemetry(picture: NDArray[np.uint16], serial: int, packings: tuple[Packing, ...]) -> Place | None:
    """Look for the record of the camera with this serial number.

    Parameters
    ----------
    picture
        (rows, columns) uint16, `EXTRA_ROWS` more rows than the sensor has.
    serial
        Serial number that the camera gave over its serial port.
    packings
        Those that are looked for.
    """
    for place in _places(packings):
        if serial and read_telemetry(picture[place.row], place.packing).serial == serial:
            return place
    return None


def _places(packings: tuple[Packing, ...]) -> Iterator[Place]:
    for packing in packings:
        for row in (0, -EXTRA_ROWS, 1, -1):
            yield Place(packing, row)
