"""What the bytes of a Seek camera mean: requests, frames, dead pixels; pure functions.

Facts from OpenThermal/libseek-thermal and lod/seek-thermal-documentation. CONFLICT: the frame counter of the
CompactPRO is word 1 in the one, word 4 in the other; word 1 is the default here and a setting chooses.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import Counts

OUT, IN = 0x41, 0xC1
IMAGE_ENDPOINT = 0x81
# What is added to a picture before its shutter frame is taken off, so that counts stay positive.
LEVEL = 0x4000


class Request(IntEnum):
    """Vendor requests (bRequest)."""

    READ_CHIP_ID = 0x36
    TOGGLE_SHUTTER = 0x37
    SET_OPERATION_MODE = 0x3C
    GET_OPERATION_MODE = 0x3D
    SET_IMAGE_PROCESSING_MODE = 0x3E
    GET_FIRMWARE_INFO = 0x4E
    START_GET_IMAGE_TRANSFER = 0x53
    TARGET_PLATFORM = 0x54
    SET_FIRMWARE_INFO_FEATURES = 0x55
    SET_FACTORY_SETTINGS_FEATURES = 0x56
    GET_FACTORY_SETTINGS = 0x58


class FrameType(IntEnum):
    """What a frame shows; other values are calibration frames too."""

    SHUTTER = 1
    SCENE = 3
    FIRST = 4


@dataclass(frozen=True)
class Model:
    """One model: raw size and visible part in words, where its metadata stand, and how it is read."""

    name: str
    pid: int
    raw_columns: int
    raw_rows: int
    first_row: int
    first_column: int
    rows: int
    columns: int
    chunk_bytes: int
    type_word: int
    counter_word: int
    max_frame_rate_hz: float

    @property
    def words(self) -> int:
        """Words of a raw frame."""
        return self.raw_columns * self.raw_rows


VID = 0x289D
COMPACT = Model("Seek Compact", 0x0010, 208, 156, 1, 0, 154, 207, 16_224, 10, 40, 9.0)
COMPACT_PRO = Model("Seek CompactPRO", 0x0011, 342, 260, 4, 1, 240, 320, 13_680, 2, 1, 15.0)
MODELS = {model.pid: model for model in (COMPACT, COMPACT_PRO)}

Step = tuple[Request, bytes, int]
"""A request, what is sent with it, and how many bytes are read (0: it is sent, not read)."""


def factory_read(words: int, address: int) -> list[Step]:
    """Steps that read some words of the factory settings."""
    return [
        (Request.SET_FACTORY_SETTINGS_FEATURES, struct.pack("<3H", words, address, 0), 0),
        (Request.GET_FACTORY_SETTINGS, b"", 2 * words),
    ]


SERIAL_WORDS, SERIAL_ADDRESS = 6, 8
_IDENTIFY: list[Step] = [
    (Request.SET_OPERATION_MODE, b"\x00\x00", 0),
    (Request.GET_FIRMWARE_INFO, b"", 4),
    (Request.READ_CHIP_ID, b"", 12),
]


def init_steps(model: Model) -> list[Step]:
    """Steps after the target platform was set, up to the camera running."""
    run: list[Step] = [(Request.SET_IMAGE_PROCESSING_MODE, b"\x08\x00", 0)]
    start: list[Step] = [(Request.SET_OPERATION_MODE, b"\x01\x00", 0)]
    if model is COMPACT:
        blocks = ((0x20, 0x30), (0x20, 0x50), (0x0C, 0x70), (SERIAL_WORDS, SERIAL_ADDRESS))
        factory = [step for words, address in blocks for step in factory_read(words, address)]
        mode: list[Step] = [(Request.GET_OPERATION_MODE, b"", 2)]
        return [*_IDENTIFY, *factory, *run, *mode, *run, *start, *mode]
    before = [*factory_read(SERIAL_WORDS, SERIAL_ADDRESS), *_features(0x17)]
    flags = [*factory_read(1, 0x0600), *factory_read(1, 0x0601)]
    table = [step for address in range(0, 2560, 32) for step in factory_read(32, address)]
    return [*_IDENTIFY, *before, *flags, *table, *_features(0x15), *run, *start]


def _features(number: int) -> list[Step]:
    return [
        (Request.SET_FIRMWARE_INFO_FEATURES, struct.pack("<H", number), 0),
        (Request.GET_FIRMWARE_INFO, b"", 64),
    ]


def image_request(model: Model) -> bytes:
    """Content of `Request.START_GET_IMAGE_TRANSFER`: size of a frame in words."""
    return struct.pack("<I", model.words)


def parse_serial(data: bytes) -> str:
    """Serial number in the factory settings: ASCII up to the first NUL, unprintable bytes left out."""
    text = data.split(b"\0")[0]
    return bytes(byte for byte in text if 0x21 <= byte < 0x7F).decode("ascii")


@dataclass(frozen=True, eq=False)
class RawFrame:
    """One frame as delivered: what it is, its counter, and all its words (raw rows, raw columns) uint16."""

    type: int
    counter: int
    words: Counts


def parse_frame(data: bytes, model: Model, counter_word: int) -> RawFrame:
    """Take a frame apart; `ValueError` when its length or its type cannot be."""
    if len(data) != 2 * model.words:
        raise ValueError(f"{len(data)} of {2 * model.words} bytes")
    words = np.frombuffer(data, "<u2")
    kind = int(words[model.type_word])
    if not 1 <= kind <= 10:
        raise ValueError(f"it says that it is of type {kind}")
    return RawFrame(kind, int(words[counter_word]), words.reshape(model.raw_rows, model.raw_columns))


def visible(words: NDArray[np.uint16], model: Model) -> Counts:
    """Part of a raw frame that is picture, (rows, columns) uint16, a view."""
    rows = slice(model.first_row, model.first_row + model.rows)
    return words[rows, model.first_column : model.first_column + model.columns]


def dead_pixels(first: Counts) -> NDArray[np.bool_]:
    """Dead pixels in a frame of type `FrameType.FIRST`, (rows, columns) bool.

    With m the most frequent value that is not 0: pixels of at most 2 m - max are dead (libseek-thermal).
    """
    values = first[first > 0]
    if values.size == 0:
        return np.ones(first.shape, np.bool_)
    most_frequent = int(np.bincount(values).argmax())
    limit = max(0, 2 * most_frequent - int(values.max()))
    dead: NDArray[np.bool_] = first <= limit
    return dead


def fill_order(dead: NDArray[np.bool_]) -> list[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]]:
    """How dead pixels are filled from their live 4-neighbours, in passes; the outermost come first.

    Returns
    -------
    list
        For each pass: flat places (n,), flat places of their neighbours (n, 4), and which of those count.
    """
    rows, columns = dead.shape
    live = ~dead
    passes = []
    while not live.all():
        row, column = np.nonzero(~live)
        near = np.stack([(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)])
        inside = (near[:, 0] >= 0) & (near[:, 0] < rows) & (near[:, 1] >= 0) & (near[:, 1] < columns)
        clipped = np.clip(near, 0, np.array([rows - 1, columns - 1])[None, :, None])
        counts = (inside & live[clipped[:, 0], clipped[:, 1]]).T
        ready = counts.any(axis=1)
        if not ready.any():
            break
        places = (clipped[:, 0] * columns + clipped[:, 1]).T
        passes.append(((row * columns + column)[ready], places[ready], counts[ready]))
        live[row[ready], column[ready]] = True
    return passes


def flatten(scene: Counts, shutter: Counts) -> Counts:
    """Scene minus shutter frame plus `LEVEL`, modulo 2**16 as the public programs do it."""
    return scene + np.uint16(LEVEL) - shutter


def fill(picture: Counts, passes: list[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]]) -> None:
    """Fill dead pixels in place with the mean of their live neighbours; see `fill_order`."""
    flat = picture.reshape(-1)
    for places, near, counts in passes:
        flat[places] = np.rint((flat[near] * counts).sum(axis=1) / counts.sum(axis=1)).astype(np.uint16)
