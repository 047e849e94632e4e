"""Pictures from elsewhere: folders, patterns, single files, NumPy arrays and videos, one after another.

Every source gives pictures of one size as (rows, columns) uint16 counts with 8 or 16 significant bits.
Values are never scaled. Colour becomes gray, and `PictureSource.notes` says so.
"""

from __future__ import annotations

import glob
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import Counts
from thermacq.errors import ImportDataError

_PICTURES = frozenset((".png", ".tif", ".tiff", ".jpg", ".jpeg"))
_SAME_KIND = {".tiff": ".tif", ".jpeg": ".jpg"}
_ARRAYS = frozenset((".npy", ".npz"))
_VIDEOS = frozenset((".avi", ".mp4", ".m4v", ".mkv", ".mov", ".mpg", ".mpeg", ".webm", ".wmv"))
_TIFF_BITS_PER_SAMPLE = 258
_KNOWN = "PNG, TIFF and JPEG pictures, NPY and NPZ arrays, and AVI, MP4, MKV and MOV videos can be imported."


@dataclass
class PictureSource:
    """Pictures of one camera; iterate over it once.

    Parameters
    ----------
    spec
        What the user gave: a folder, a pattern, or a file.
    files
        The files behind it, in order.
    """

    spec: str
    files: list[Path]
    bit_depth: int = 0
    """Significant bits; known after the first picture."""
    notes: list[str] = field(default_factory=list)
    """What was changed on the way."""

    @property
    def is_video(self) -> bool:
        """Whether the pictures come from a video, which brings a frame rate of its own."""
        return self.files[0].suffix.lower() in _VIDEOS

    def frame_rate_hz(self) -> float:
        """Frame rate that a video states; 0 when it states none."""
        import cv2

        capture = cv2.VideoCapture(str(self.files[0]))
        try:
            return max(0.0, float(capture.get(cv2.CAP_PROP_FPS)))
        finally:
            capture.release()

    def __iter__(self) -> Iterator[Counts]:
        """Give the pictures; raises `ImportDataError` that names the file at fault."""
        size: tuple[int, ...] = ()
        for name, picture in self._raw():
            counts = self._to_counts(name, picture)
            if size and counts.shape != size:
                raise ImportDataError(
                    f"{name} has {_size(counts.shape)} pixels, the pictures before it have {_size(size)}",
                    remedy="All pictures of a run must have the same size; remove or crop this one.",
                )
            size = counts.shape
            yield counts

    def _raw(self) -> Iterator[tuple[str, NDArray[Any]]]:
        """Name and values of each picture as stored."""
        for path in self.files:
            suffix = path.suffix.lower()
            if suffix in _VIDEOS:
                yield from _read_video(path)
            elif suffix in _ARRAYS:
                yield from _read_arrays(path)
            else:
                yield from _read_picture(path)

    def _to_counts(self, name: str, picture: NDArray[Any]) -> Counts:
        bits = {np.dtype(np.uint8): 8, np.dtype(np.uint16): 16}.get(picture.dtype)
        if bits is None:
            raise ImportDataError(
                f"{name} holds {picture.dtype} values",
                remedy="Raw counts of 8 or 16 bits without sign can be imported; convert it first.",
            )
        if self.bit_depth not in (0, bits):
            raise ImportDataError(f"{name} has {bits} bits, the pictures before it have {self.bit_depth}")
        self.bit_depth = bits
        return self._gray(picture).astype(np.uint16)

    def _gray(self, picture: NDArray[Any]) -> NDArray[Any]:
        """One channel: the common one of three equal colours, else their luminance; alpha is dropped."""
        import cv2

        if picture.ndim == 2:
            return picture
        colours = picture[..., :3] if picture.shape[-1] > 2 else picture[..., :1]
        if picture.shape[-1] in (2, 4):
            self._note("the alpha channel was dropped")
        first: NDArray[Any] = colours[..., 0]
        if all(np.array_equal(first, colours[..., other]) for other in range(1, colours.shape[-1])):
            return first
        self._note("colours were turned to gray (luminance, Rec. 601)")
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(colours), cv2.COLOR_BGR2GRAY))

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def open_source(spec: str) -> PictureSource:
    """Find the pictures that a folder, a pattern or a file name stands for.

    Raises
    ------
    ImportDataError
        There are none, or they are of kinds that cannot be imported together.
    """
    path = Path(spec)
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix.lower() in _PICTURES | _ARRAYS]
        if not files:
            raise ImportDataError(f"the folder '{spec}' holds no pictures", remedy=_KNOWN)
    elif path.is_file():
        files = [path]
    else:
        files = [Path(name) for name in glob.glob(spec) if Path(name).is_file()]  # noqa: PTH207 - any root
        if not files:
            raise ImportDataError(f"there is no folder, file or pattern match '{spec}'", remedy=_KNOWN)
    kinds = {_SAME_KIND.get(file.suffix.lower(), file.suffix.lower()) for file in files}
    if unknown := kinds - _PICTURES - _ARRAYS - _VIDEOS:
        raise ImportDataError(f"'{spec}': files named *{min(unknown)} cannot be imported", remedy=_KNOWN)
    if len(kinds) > 1 or (len(files) > 1 and kinds & _VIDEOS):
        raise ImportDataError(
            f"'{spec}' stands for {len(files)} files of kind {', '.join(sorted(kinds))}",
            remedy="Give a pattern in quotes that matches pictures of one kind, like 'folder/left*.png'.",
        )
    return PictureSource(spec, sorted(files, key=_natural_order))


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Sort key in which 2 comes before 10."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _read_video(path: Path) -> Iterator[tuple[str, NDArray[Any]]]:
    import cv2

    capture = cv2.VideoCapture(str(path))
    try:
        number = 0
        while True:
            good, picture = capture.read()
            if not good:
                break
            yield f"frame {number} of '{path}'", picture
            number += 1
    finally:
        capture.release()
    if number == 0:
        raise ImportDataError(f"the video '{path}' cannot be read", remedy="Is it complete? Is it a video?")


def _read_arrays(path: Path) -> Iterator[tuple[str, NDArray[Any]]]:
    """Arrays of (rows, columns) or (frames, rows, columns)."""
    try:
        if path.suffix.lower() == ".npz":
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
                if len(archive.files) != 1:
                    raise ImportDataError(
                        f"'{path}' holds {len(archive.files)} arrays",
                        remedy="Store the frames as its only one.",
                    )
                array = archive[archive.files[0]]
        else:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
    except ImportDataError:
        raise
    except Exception as error:  # besides NumPy, zipfile and zlib have errors of their own for damage
        raise ImportDataError(f"'{path}' cannot be read: {error}") from None
    if not isinstance(array, np.ndarray):
        raise ImportDataError(f"'{path}' cannot be read: it holds no single array")
    if array.ndim not in (2, 3) or 0 in array.shape:
        raise ImportDataError(
            f"'{path}' has the shape {array.shape}",
            remedy="Frames are (frames, rows, columns) or one picture.",
        )
    if array.ndim == 2:
        yield f"'{path}'", array
        return
    for number, picture in enumerate(array):
        yield f"frame {number} of '{path}'", picture


def _read_picture(path: Path) -> Iterator[tuple[str, NDArray[Any]]]:
    """A picture file, or the pages of a TIFF file."""
    import cv2

    try:
        content = path.read_bytes()
    except OSError as error:
        raise ImportDataError(f"'{path}' cannot be read: {error}") from None
    bits = _stated_bits(content)
    if bits and bits not in (8, 16):
        raise ImportDataError(
            f"'{path}' has {bits} bits per pixel",
            remedy="Raw counts of 8 or 16 bits can be imported; convert it first.",
        )
    pages: list[NDArray[Any]] = []
    try:
        good, found = cv2.imdecodemulti(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        pages = list(found) if good else []
    except cv2.error:
        pages = []
    if not pages:
        raise ImportDataError(
            f"the picture '{path}' cannot be read", remedy="It is empty, cut off, or no picture; replace it."
        )
    for number, page in enumerate(pages):
        yield (f"page {number} of '{path}'" if len(pages) > 1 else f"'{path}'"), page


def _stated_bits(content: bytes) -> int:
    """Bits per sample that a PNG or TIFF file states; OpenCV widens narrow ones silently. 0: not stated."""
    if content[:8] == b"\x89PNG\r\n\x1a\n" and len(content) > 25:
        colour_type = content[25]
        palette = 3
        return 8 if colour_type == palette else content[24]
    order = {b"II*\x00": "<", b"MM\x00*": ">"}.get(content[:4])
    if order is None:
        return 0
    try:
        (directory,) = struct.unpack_from(f"{order}I", content, 4)
        (entries,) = struct.unpack_from(f"{order}H", content, directory)
        for number in range(entries):
            place = directory + 2 + 12 * number
            tag, _, count, offset = struct.unpack_from(f"{order}HHII", content, place)
            if tag == _TIFF_BITS_PER_SAMPLE:
                start = place + 8 if count <= 2 else offset
                (bits,) = struct.unpack_from(f"{order}H", content, start)
                return int(bits)
    except struct.error:
        return 0
    return 1  # the default of the format: a bilevel picture need not say so


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
