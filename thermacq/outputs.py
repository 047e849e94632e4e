"""Files to be written: refused before the work, not after it."""

from __future__ import annotations

import os
from pathlib import Path

from thermacq.errors import StoreError


def check_new_file(path: Path) -> None:
    """Make sure that a file can be made.

    Raises
    ------
    StoreError
        It exists, or its folder is missing or read-only.
    """
    if path.exists():
        raise StoreError(
            f"'{path}' exists already", kept="It was not touched.", remedy="Choose another name."
        )
    if not path.parent.is_dir():
        raise StoreError(f"there is no folder '{path.parent}'", remedy="Make it, or choose another.")
    if not os.access(path.parent, os.W_OK):
        raise StoreError(f"the folder '{path.parent}' is read-only", remedy="Choose another.")
