"""The infrared correction of one camera as an immutable, hashed record, and its HDF5 file.

Corrected counts are Z = gain * Y + offset - shading; bad pixels are then replaced. `Corrector` applies a
record, `thermacq_calibration.infrared.nonuniformity` makes one. Raw counts are never altered.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import IntFlag
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.fields import Fields, parse_json
from thermacq_calibration.files import new_file

if TYPE_CHECKING:
    import h5py

FORMAT = "thermacq-camera-correction"
VERSION = 1
_MAX_PIXELS = 2**24
_MAX_TEXT_BYTES = 2**20
_SMALLEST_SPAN_K = 0.1
_REMEDY = "Use the original file, or make the correction again from its reference views."

Picture: TypeAlias = NDArray[np.float32]


class BadPixel(IntFlag):
    """Why a pixel is bad; the bits of a bad-pixel map."""

    DEAD = 1
    NOISY = 2
    BLINKING = 4
    OUTLIER = 8


def bad_pixel_counts(bad_pixels: NDArray[np.uint8]) -> dict[str, int]:
    """Number of bad pixels of a map by reason, names in small letters; a pixel may have several."""
    return {str(reason.name).lower(): int(np.count_nonzero(bad_pixels & reason)) for reason in BadPixel}


@dataclass(frozen=True, eq=False)
class CameraCorrection:
    """Correction of one camera: ``corrected = gain * counts + offset - shading``.

    Parameters
    ----------
    serial, camera
        Serial number of the camera and its name in the rig.
    gain, offset
        (rows, columns) float32; the offset in counts. 1 and 0 where a pixel does not respond at all.
    bad_pixels
        (rows, columns) uint8, bits of `BadPixel`; 0: good.
    shading
        (rows, columns) float32, counts to take away when the camera has `shading_temperature_k`; None: no
        such stage.
    shading_temperature_k, shading_zero_k
        Temperature of the camera at which the shading was seen, and that at which there is none: shading
        grows linearly between the two and beyond. `shading_zero_k` None: it does not depend on it.
    counts_per_kelvin, kelvin_at_zero
        Radiometric scale: apparent temperature = kelvin_at_zero + corrected / counts_per_kelvin; None
        where unknown.
    netd_k
        Median temporal noise of the pixels; None where the scale is unknown.
    shutter
        (rows, columns) float32, mean raw counts of the camera's internal shutter when the reference views
        were taken; None when it was not seen. A later update of the offsets takes what changed since.
    made_from
        Plain values for JSON: runs, temperatures, frames, figures of the validation.
    fpa_temperature_k
        Temperature of the focal-plane array (or housing) during the reference views.
    created, offset_updated
        ISO 8601, UTC; `offset_updated` empty while the offsets are the first ones.

    Raises
    ------
    CalibrationError
        Arrays do not fit each other, or something is not finite.
    """

    serial: str
    camera: str
    gain: Picture
    offset: Picture
    bad_pixels: NDArray[np.uint8]
    shading: Picture | None = None
    shading_temperature_k: float | None = None
    shading_zero_k: float | None = None
    counts_per_kelvin: float | None = None
    kelvin_at_zero: float | None = None
    netd_k: float | None = None
    shutter: Picture | None = None
    made_from: Mapping[str, Any] = field(default_factory=dict)
    fpa_temperature_k: float | None = None
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    offset_updated: str = ""

    def __post_init__(self) -> None:
        gain = _frozen(self.gain, np.float32, "gain")
        if gain.ndim != 2 or not 0 < gain.size <= _MAX_PIXELS or gain.min() <= 0:
            raise CalibrationError("the gains of a correction must be a picture of positive numbers")
        object.__setattr__(self, "gain", gain)
        for name, kind in (("offset", np.float32), ("bad_pixels", np.uint8)):
            object.__setattr__(self, name, _frozen(getattr(self, name), kind, name, gain.shape))
        for name in ("shading", "shutter"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _frozen(getattr(self, name), np.float32, name, gain.shape))
        numbers = [getattr(self, name) for name in _NUMBERS]
        if not all(value is None or math.isfinite(value) for value in numbers):
            raise CalibrationError("a correction holds a temperature or scale that is not finite")
        if (self.counts_per_kelvin is None) != (self.kelvin_at_zero is None) or self.counts_per_kelvin == 0:
            raise CalibrationError("a radiometric scale needs both counts per kelvin, not 0, and its zero")
        if self.shading is not None and self.shading_zero_k is not None:
            if self.shading_temperature_k is None:
                raise CalibrationError("shading that depends on temperature needs the one it was seen at")
            if abs(self.shading_temperature_k - self.shading_zero_k) < _SMALLEST_SPAN_K:
                raise CalibrationError("shading was seen too near to the temperature at which it vanishes")
        object.__setattr__(self, "made_from", _plain(self.made_from))

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        rows, columns = self.gain.shape
        return rows, columns

    @property
    def sha256(self) -> str:
        """Hash of everything in the record."""
        digest = hashlib.sha256(_text(self._content()).encode())
        for name, kind in _ARRAYS.items():
            values = getattr(self, name)
            digest.update(name.encode())
            if values is not None:
                digest.update(values.astype(np.dtype(kind).newbyteorder("<")).tobytes())
        return digest.hexdigest()

    def shading_factor(self, temperature_k: float) -> float:
        """How many times `shading` applies at a temperature of the camera; 1 where that is not known."""
        if self.shading_zero_k is None or self.shading_temperature_k is None or math.isnan(temperature_k):
            return 1.0
        return (temperature_k - self.shading_zero_k) / (self.shading_temperature_k - self.shading_zero_k)

    def to_kelvin(self, corrected: Picture) -> Picture:
        """Apparent temperature of corrected counts, float32 kelvin.

        Raises
        ------
        CalibrationError
            The radiometric scale is not known.
        """
        if self.counts_per_kelvin is None or self.kelvin_at_zero is None:
            raise CalibrationError(
                f"the correction of camera '{self.camera}' does not know counts per kelvin",
                remedy="Make it from views of known temperature.",
            )
        scale, zero = np.float32(1 / self.counts_per_kelvin), np.float32(self.kelvin_at_zero)
        kelvin: Picture = np.asarray(corrected, np.float32) * scale + zero
        return kelvin

    def save(self, path: Path) -> None:
        """Write the record to a new HDF5 file; its name should end in ``.correction.h5``.

        Raises
        ------
        CalibrationError
            The file exists already or cannot be written.
        """
        import h5py

        with new_file(path), h5py.File(path, "w") as file:
            self.to_group(file)

    def to_group(self, group: h5py.Group) -> None:
        """Write the record into an empty group of an open HDF5 file."""
        content = {**self._content(), "sha256": self.sha256}
        group.create_dataset("record", data=np.bytes_(_text(content).encode()))
        for name in _ARRAYS:
            values = getattr(self, name)
            if values is not None:
                group.create_dataset(name, data=values)

    @classmethod
    def from_group(cls, group: h5py.Group) -> CameraCorrection:
        """Read what `to_group` wrote; nothing outside the file is followed.

        Raises
        ------
        CalibrationError
            It is no correction, of another version, damaged, or was altered since.
        """
        try:
            return _read(group)
        except CalibrationError as error:
            raise CalibrationError(error.what, remedy=_REMEDY) from None
        except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError) as error:
            raise CalibrationError(
                f"this is no camera correction, or it is damaged: {error}", remedy=_REMEDY
            ) from None

    def _content(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "version": VERSION,
            "rows": self.shape[0],
            "columns": self.shape[1],
            "arrays": [name for name in _ARRAYS if getattr(self, name) is not None],
            **{name: getattr(self, name) for name in (*_TEXTS, *_NUMBERS)},
            "made_from": self.made_from,
        }


_ARRAYS: dict[str, type[np.generic]] = {
    "gain": np.float32,
    "offset": np.float32,
    "bad_pixels": np.uint8,
    "shading": np.float32,
    "shutter": np.float32,
}
_TEXTS = ("serial", "camera", "created", "offset_updated")
_NUMBERS = (
    "shading_temperature_k",
    "shading_zero_k",
    "counts_per_kelvin",
    "kelvin_at_zero",
    "netd_k",
    "fpa_temperature_k",
)


def load_correction(path: Path) -> CameraCorrection:
    """Read a correction file.

    Raises
    ------
    CalibrationError
        The file is missing, no camera correction, damaged or altered.
    """
    import h5py

    try:
        with path.open("rb"), h5py.File(path, "r") as file:
            return CameraCorrection.from_group(file)
    except FileNotFoundError:
        raise CalibrationError(f"there is no file '{path}'") from None
    except CalibrationError as error:
        raise CalibrationError(f"'{path}': {error.what}", remedy=error.remedy) from None
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or "HDF5 cannot open it"
        raise CalibrationError(f"'{path}' is no camera correction: {reason}", remedy=_REMEDY) from None


def _read(group: h5py.Group) -> CameraCorrection:
    text = _dataset(group, "record")
    if text.shape != () or text.dtype.kind != "S" or text.dtype.itemsize > _MAX_TEXT_BYTES:
        raise ValueError("its description is not a text")
    values = parse_json(bytes(text[()]).decode())
    fields = Fields(values, "correction")
    if fields.value("format") != FORMAT:
        raise CalibrationError("this is no camera correction")
    if fields.integer("version") != VERSION:
        raise CalibrationError(
            f"correction version {fields.integer('version')} is not known; this program reads {VERSION}"
        )
    shape = fields.integer("rows"), fields.integer("columns")
    if min(shape) < 1 or shape[0] * shape[1] > _MAX_PIXELS:
        raise ValueError(f"a picture cannot have {shape[0]} x {shape[1]} pixels")
    parts: dict[str, Any] = {name: _array(group, name, shape) for name in _ARRAYS if name in _names(fields)}
    parts |= {name: fields.text(name) for name in _TEXTS}
    parts |= {name: fields.optional_number(name) for name in _NUMBERS}
    correction = CameraCorrection(**parts, made_from=fields.optional_mapping("made_from") or {})
    if {**correction._content(), "sha256": correction.sha256} != values:
        raise CalibrationError("the correction was altered after it was made: it does not match its hash")
    return correction


def _names(fields: Fields) -> list[Any]:
    names = fields.value("arrays")
    if not isinstance(names, list) or not {"gain", "offset", "bad_pixels"} <= {str(name) for name in names}:
        raise ValueError("gains, offsets or bad pixels are missing")
    return names


def _array(group: h5py.Group, name: str, shape: tuple[int, int]) -> NDArray[Any]:
    dataset = _dataset(group, name)
    if dataset.shape != shape or dataset.dtype != np.dtype(_ARRAYS[name]):
        raise ValueError(f"'{name}' has not the size or type that it should have")
    return np.asarray(dataset[()])


def _dataset(group: h5py.Group, name: str) -> h5py.Dataset:
    """A dataset whose values are in this very file: links and other files are not followed."""
    import h5py

    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise KeyError(f"'{name}' is missing")
    member = group[name]
    if not isinstance(member, h5py.Dataset) or member.is_virtual or member.external or member.dtype.hasobject:
        raise ValueError(f"'{name}' is not a plain dataset")
    return member


def _frozen(values: Any, kind: DTypeLike, name: str, shape: tuple[int, ...] | None = None) -> NDArray[Any]:
    """Read-only copy in the right type; refuses what is not finite or of another size."""
    array = np.array(values, dtype=kind, order="C")
    if shape is not None and array.shape != shape:
        raise CalibrationError(f"{name} of a correction has size {array.shape}, its gains {shape}")
    if not np.isfinite(array).all():
        raise CalibrationError(f"{name} of a correction is not finite everywhere")
    array.flags.writeable = False
    return array


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    try:
        plain: dict[str, Any] = json.loads(_text(dict(values)))
    except (TypeError, ValueError):
        raise CalibrationError("what a correction was made from must be plain, finite values") from None
    return plain


def _text(values: Mapping[str, Any]) -> str:
    return json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)
