"""Room on the disk: refuse a run that will not fit, and keep a reserve for the moment it fills up."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from thermacq.errors import StoreError

BALLAST_BYTES = 4 * 1024 * 1024
MEGABYTE = 1_000_000


def free_bytes(path: Path) -> int:
    """Free space on the file system of the folder of `path`, bytes."""
    return shutil.disk_usage(path.parent).free


def check_room(path: Path, expected_bytes: int, reserve_bytes: int) -> None:
    """Refuse a run that will not fit.

    Parameters
    ----------
    path
        The run file to be.
    expected_bytes
        How large it will be at most, as far as known.
    reserve_bytes
        What shall be left free.

    Raises
    ------
    StoreError
        The folder is missing, or expected and reserve together exceed what is free.
    """
    if not path.parent.is_dir():
        raise StoreError(f"there is no folder '{path.parent}'", remedy="Create it, or choose another.")
    free = free_bytes(path)
    if expected_bytes + reserve_bytes > free:
        raise StoreError(
            f"the run will not fit on the disk of '{path.parent}': it needs up to "
            f"{expected_bytes / MEGABYTE:.0f} MB and a reserve of {reserve_bytes / MEGABYTE:.0f} MB, "
            f"{free / MEGABYTE:.0f} MB are free",
            remedy="Free some space, record for a shorter time, or write to another disk.",
        )


class Ballast:
    """Disk space held back, and let go when the disk is full so that the file can be closed properly.

    The space belongs to a file without a name: it is freed however the process ends.
    """

    def __init__(self, folder: Path, size: int = BALLAST_BYTES) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - held until `release`
        try:
            os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError:
            self._file.close()
            raise

    def release(self) -> None:
        """Give the space back; legal at any time."""
        self._file.close()
