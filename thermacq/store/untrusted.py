"""Access to HDF5 files that are not to be trusted, or whose writer was killed.

Only hard links to plain groups and datasets inside the file are followed, text is bounded, and whatever
HDF5 raises on damage becomes a `StoreError`; the getters are for use inside `explained`.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thermacq.errors import StoreError

if TYPE_CHECKING:
    import h5py

DAMAGE = (
    OSError,
    RuntimeError,
    KeyError,
    ValueError,
    TypeError,
    AttributeError,
    OverflowError,
    MemoryError,
    RecursionError,
    NotImplementedError,
)
"""What h5py and the parsers may raise on a damaged file; anything else is a bug of ours."""

_MAX_TEXT_BYTES = 64 * 1024 * 1024
_READ_ATTEMPTS = 25


def open_hdf5(path: Path) -> h5py.File:
    """Open plainly; a file that is being written, or whose writer died, opens only as a SWMR reader.

    Raises
    ------
    StoreError
        It is no HDF5 file, or cut off.
    """
    import h5py

    for opener in (_open_plain, _open_swmr):
        with contextlib.suppress(*DAMAGE):
            file: h5py.File = opener(path)
            return file
    remedy = "If it was cut off while copying, copy it again."
    if not h5py.is_hdf5(path):
        raise StoreError(f"'{path}' is not an HDF5 file, or its beginning is damaged", remedy=remedy)
    raise StoreError(f"'{path}' is cut off or damaged: HDF5 cannot open it", remedy=remedy)


def _open_plain(path: Path) -> h5py.File:
    import h5py

    return h5py.File(path, "r")


def _open_swmr(path: Path) -> h5py.File:
    """Open beside a writer, reading a torn block again at most for some 0.1 s.

    The waiting time doubles with each of HDF5's attempts, and its default of 100 lasts for minutes on a
    damaged block. h5py does not offer the setting, but the library that it loaded does.
    """
    import h5py

    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_fclose_degree(h5py.h5f.CLOSE_STRONG)
    library = ctypes.CDLL(h5py.h5p.__file__)
    library.H5Pset_metadata_read_attempts.argtypes = [ctypes.c_int64, ctypes.c_uint]
    library.H5Pset_metadata_read_attempts(access.id, _READ_ATTEMPTS)
    flags = h5py.h5f.ACC_RDONLY | h5py.h5f.ACC_SWMR_READ
    return h5py.File(h5py.h5f.open(bytes(path), flags, access))


@contextlib.contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file causes into a `StoreError` about it."""
    try:
        yield
    except StoreError:
        raise
    except DAMAGE as error:
        raise StoreError(f"'{path}' is not a run file, or is damaged: {error}") from None


def get_member(group: h5py.Group, name: object) -> Any:
    """A member that is really in this file; soft and external links are not followed."""
    import h5py

    if not isinstance(name, str) or "/" in name or name in ("", "."):
        raise ValueError(f"'{name}' is no name of a device")
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise TypeError(f"'{group.name}' has no member '{name}' of its own")
    return group[name]


def get_group(parent: h5py.Group, name: str) -> h5py.Group:
    """A group of this file."""
    import h5py

    member = get_member(parent, name)
    if not isinstance(member, h5py.Group):
        raise TypeError(f"'{member.name}' should be a group")
    return member


def get_dataset(parent: h5py.Group, name: str) -> h5py.Dataset:
    """A dataset whose data are in this file and are plain numbers or fixed text."""
    import h5py

    member = get_member(parent, name)
    if not isinstance(member, h5py.Dataset):
        raise TypeError(f"'{member.name}' should be a dataset")
    if member.is_virtual or member.external or member.dtype.hasobject:
        raise ValueError(f"'{member.name}' takes its data from elsewhere, or is of an unknown type")
    return member


def get_scalar(group: h5py.Group, name: str) -> int:
    """A whole number."""
    dataset = get_dataset(group, name)
    if dataset.shape != () or dataset.dtype.kind not in "iu":
        raise ValueError(f"'{dataset.name}' should be one whole number")
    return int(dataset[()])


def get_text(group: h5py.Group, name: str) -> str:
    """A text of fixed size."""
    dataset = get_dataset(group, name)
    if dataset.shape != () or dataset.dtype.kind != "S" or dataset.dtype.itemsize > _MAX_TEXT_BYTES:
        raise ValueError(f"'{dataset.name}' should be a text")
    return bytes(dataset[()]).decode()


def get_json(group: h5py.Group, name: str) -> Any:
    """A JSON document."""
    return json.loads(get_text(group, name))
