"""Elevation series from text files: two columns, or one and a rate; as loggers and other programs write them.

Lines that begin with ``#``, ``%`` or ``//`` are comments; one line of column names may stand above the numbers.
Columns are parted by semicolons, tabs, commas or blanks, whichever the first line of numbers uses; beside
semicolons and tabs a decimal comma is understood. Empty cells and ``nan`` are missing values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from thermacq.errors import ImportDataError
from thermacq.evaluation.series import Series

METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_COMMENTS = ("#", "%", "//")
_MAX_BYTES = 1 << 28


def read_series(
    path: Path,
    *,
    time_column: str = "",
    value_column: str = "",
    rate_hz: float | None = None,
    unit: str = "m",
) -> tuple[Series, Series]:
    """Read times (seconds) and elevations (metres).

    Parameters
    ----------
    path
        Text file.
    time_column, value_column
        Name in the line of column names, or number from 1. By default time is the first column and
        elevation the one after it; with a rate, elevation is the first column.
    rate_hz
        Sampling rate of a file without times.
    unit
        Unit of the elevations: ``m``, ``cm`` or ``mm``.

    Raises
    ------
    ImportDataError
        The file cannot be read as such a series; the message names the line.
    """
    if unit not in METRES_PER_UNIT:
        raise ImportDataError(f"unknown unit '{unit}'", remedy=f"Known: {', '.join(METRES_PER_UNIT)}.")
    if rate_hz is not None and not (math.isfinite(rate_hz) and rate_hz > 0):
        raise ImportDataError(f"a sampling rate of {rate_hz:g} Hz is impossible")
    if rate_hz is not None and time_column:
        raise ImportDataError("a rate and a column of times exclude each other")
    names, table = _read_table(path)
    if rate_hz is None:
        times = _column(path, table, names, time_column or "1")
        values = _column(path, table, names, value_column or "2")
        if not np.isfinite(times).all():
            raise ImportDataError(
                f"'{path}': the time is missing in row {int(np.argmin(np.isfinite(times))) + 1}"
            )
    else:
        values = _column(path, table, names, value_column or "1")
        times = np.arange(values.size) / rate_hz
    return times, values * METRES_PER_UNIT[unit]


def read_columns(path: Path, columns: Sequence[str]) -> list[Series]:
    """Read some columns of a table of numbers, by name or by number from 1; missing values are NaN.

    Raises
    ------
    ImportDataError
        The file cannot be read as a table of numbers, or has no such column.
    """
    names, table = _read_table(path)
    return [_column(path, table, names, column) for column in columns]


def _read_table(path: Path) -> tuple[list[str], Series]:
    """Column names (empty when there are none) and the numbers, (rows, columns)."""
    lines = [(number, line.strip()) for number, line in enumerate(_text(path).splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith(_COMMENTS)]
    if not lines:
        raise ImportDataError(f"'{path}' holds no numbers")
    names: list[str] = []
    first = lines[0][1]
    separator = _separator(first)
    if _numbers(first, separator) is None:
        names = _cells(first, separator)
        lines = lines[1:]
        separator = _separator(lines[0][1]) if lines else separator
    rows: list[list[float]] = []
    for number, line in lines:
        row = _numbers(line, separator)
        if row is None or (rows and len(row) != len(rows[0])):
            reason = (
                "is not a row of numbers" if row is None else f"has {len(row)} columns, not {len(rows[0])}"
            )
            raise ImportDataError(
                f"'{path}', line {number}: '{line[:60]}' {reason}", remedy="Comments begin with # or %."
            )
        rows.append(row)
    if not rows:
        raise ImportDataError(f"'{path}' holds no numbers")
    return names, np.array(rows)


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ImportDataError(f"'{path}' is larger than 256 MiB: hardly a series of one probe")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ImportDataError(f"there is no file '{path}'") from None
    except UnicodeDecodeError:
        raise ImportDataError(
            f"'{path}' is not a text file", remedy="Export the series as text (CSV)."
        ) from None
    except OSError as error:
        raise ImportDataError(f"'{path}' cannot be read: {error.strerror}") from None
    if "\0" in text:
        raise ImportDataError(f"'{path}' is not a text file", remedy="Export the series as text (CSV).")
    return text


def _separator(line: str) -> str | None:
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def _cells(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip("\"'") for cell in line.split(separator)]


def _numbers(line: str, separator: str | None) -> list[float] | None:
    cells = _cells(line, separator)
    if separator in (";", "\t"):
        cells = [cell.replace(",", ".") for cell in cells]
    try:
        return [float(cell) if cell else math.nan for cell in cells]
    except ValueError:
        return None


def _column(path: Path, table: Series, names: list[str], wanted: str) -> Series:
    if wanted in names:
        index = names.index(wanted)
    elif wanted.isdecimal() and 1 <= int(wanted) <= table.shape[1]:
        index = int(wanted) - 1
    else:
        known = f"its columns are named {', '.join(names)}" if names else "they have no names"
        single = " Give --rate-hz for a file without times." if table.shape[1] == 1 else ""
        raise ImportDataError(
            f"'{path}' has {table.shape[1]} column(s), none of them is '{wanted[:60]}'",
            remedy=f"Count columns from 1; {known}.{single}",
        )
    if index >= table.shape[1]:
        raise ImportDataError(f"'{path}' names more columns than it has numbers in a row")
    return table[:, index]
