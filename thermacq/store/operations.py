"""The few ways in which an open run file is changed: the only places where a bad disk shows itself.

Each raises what h5py raises, which after a full disk is an `OSError` or a `RuntimeError` without errno.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import h5py


def write_chunk(data: h5py.Dataset, row: int, chunk: bytes) -> None:
    """Write the finished chunk of one picture as row `row`."""
    data.resize(row + 1, axis=0)
    data.id.write_direct_chunk((row, 0, 0), chunk)


def write_rows(column: h5py.Dataset, first: int, values: Any) -> None:
    """Write consecutive rows of a column; doing it twice does no harm."""
    values = np.asarray(values, column.dtype)
    column.resize(first + len(values), axis=0)
    column[first:] = values


def write_value(dataset: h5py.Dataset, value: Any) -> None:
    """Overwrite a dataset of one value and hand it to the operating system."""
    dataset[()] = value
    dataset.flush()


def flush_file(file: h5py.File) -> None:
    """Hand everything written so far to the operating system."""
    file.flush()
