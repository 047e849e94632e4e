"""Compression of single frames outside HDF5, in the format of the registered Blosc filter (32001).

A free function on purpose: Blosc lets go of the interpreter lock, so a writer can compress in threads.
"""

from __future__ import annotations

import zlib
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import Counts
from thermacq.errors import StoreError

if TYPE_CHECKING:
    from numcodecs import Blosc

Compression = Literal["lz4", "zstd", "none"]

BLOSC_FILTER = 32001
_LEVELS = {"lz4": 5, "zstd": 1}
_BLOSC_ZSTD = 5
_BLOSC_HEADER_BYTES = 16


@cache
def _blosc(compression: str) -> Blosc:
    import numcodecs.blosc

    # The global state of Blosc is not safe to share between threads; contexts of their own are.
    numcodecs.blosc.use_threads = False
    return numcodecs.blosc.Blosc(
        cname=compression, clevel=_LEVELS[compression], shuffle=numcodecs.blosc.BITSHUFFLE
    )


def frame_crc32(counts: Counts) -> int:
    """CRC-32 of the raw counts in row order."""
    return zlib.crc32(np.ascontiguousarray(counts).data)


def encode_frame(counts: Counts, compression: Compression) -> bytes:
    """Compress one picture into the bytes of its HDF5 chunk.

    Parameters
    ----------
    counts
        (rows, columns) uint16, counts.
    compression
        ``lz4`` and ``zstd`` shuffle bits first; ``none`` stores the raw bytes.
    """
    contiguous = np.ascontiguousarray(counts, np.uint16)
    if compression == "none":
        return contiguous.tobytes()
    encoded: bytes = _blosc(compression).encode(contiguous)
    return encoded


def decode_frame(chunk: bytes, rows: int, columns: int, compression: Compression) -> NDArray[np.uint16]:
    """Counts of one chunk, (rows, columns) uint16.

    The sizes stated in the chunk are compared with what is expected before anything is unpacked.

    Raises
    ------
    StoreError
        The chunk is damaged.
    """
    expected = rows * columns * 2
    raw = chunk
    if compression != "none":
        stated = int.from_bytes(chunk[4:8], "little"), int.from_bytes(chunk[12:16], "little")
        if len(chunk) < _BLOSC_HEADER_BYTES or stated != (expected, len(chunk)):
            raise StoreError("its compressed data are damaged")
        try:
            raw = _blosc(compression).decode(chunk)
        except RuntimeError:
            raise StoreError("its compressed data are damaged") from None
    if len(raw) != expected:
        raise StoreError(f"it has {len(raw)} bytes instead of {expected}")
    return np.frombuffer(raw, np.uint16).reshape(rows, columns)


def filter_options(compression: Compression) -> dict[str, Any]:
    """Arguments of ``create_dataset`` that announce these chunks to every HDF5 reader."""
    if compression == "none":
        return {}
    import hdf5plugin

    return dict(hdf5plugin.Blosc(compression, _LEVELS[compression], hdf5plugin.Blosc.BITSHUFFLE))


def compression_of(options: tuple[int, ...]) -> Compression:
    """Compression that the options of the Blosc filter of a dataset name."""
    return "zstd" if len(options) > 6 and options[6] == _BLOSC_ZSTD else "lz4"
