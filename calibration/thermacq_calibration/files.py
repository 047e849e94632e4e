"""Files of records: new ones are made, and none is ever overwritten."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from thermacq_calibration.errors import CalibrationError


@contextmanager
def new_file(path: Path) -> Iterator[None]:
    """Make an empty file, to be filled within the context; it is removed again when that fails.

    Raises
    ------
    CalibrationError
        The file exists already or cannot be written.
    """
    try:
        # HDF5 itself does not say why it could not make a file; this does.
        path.open("xb").close()
        yield
    except FileExistsError:
        raise CalibrationError(
            f"'{path}' exists already", kept="It was not touched.", remedy="Choose another name."
        ) from None
    except OSError as error:
        with suppress(OSError):
            path.unlink()
        raise CalibrationError(
            f"'{path}' cannot be written: {error.strerror or error}",
            remedy="Choose a folder that exists and has room.",
        ) from None


def read_text(path: Path, what: str, max_bytes: int, remedy: str) -> str:
    """Text of a record that may come from anywhere.

    Parameters
    ----------
    path
        The file.
    what
        What it should be, for messages.
    max_bytes
        A larger file is no such record.
    remedy
        What to do when there is no file.

    Raises
    ------
    CalibrationError
        The file is missing, too large, or no text.
    """
    try:
        if path.stat().st_size > max_bytes:
            raise CalibrationError(f"'{path}' is too large to be a {what}")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise CalibrationError(f"there is no file '{path}'", remedy=remedy) from None
    except UnicodeDecodeError:
        raise CalibrationError(f"'{path}' is no {what}: it is not text") from None
    except OSError as error:
        raise CalibrationError(f"'{path}' cannot be read: {error.strerror}") from None
