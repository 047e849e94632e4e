"""Reading a run file, also one whose writer was killed, and also one that is not to be trusted.

Types, shapes and sizes are compared with what a run file must have before anything is read, so that a
hostile file cannot make the reader allocate more than the file itself is worth. Everything wrong is a
`StoreError`.
"""

from __future__ import annotations

import contextlib
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from thermacq.errors import StoreError
from thermacq.rig import Rig
from thermacq.store import layout, untrusted
from thermacq.store.codec import BLOSC_FILTER, Compression, compression_of, decode_frame
from thermacq.store.records import (
    CameraStream,
    Event,
    EventKind,
    FrameTable,
    ProbeSamples,
    ProbeStream,
    RunHeader,
)

if TYPE_CHECKING:
    import h5py

    from thermacq_calibration import CameraCorrection

_MAX_PIXELS = 1 << 28
_MAX_DEVICES = 256


@dataclass(frozen=True)
class _Streams:
    """The devices of a run as stored."""

    cameras: list[CameraStream]
    probes: list[ProbeStream]


@dataclass(frozen=True)
class _Table:
    """Columns of a run file and how many of their rows are committed."""

    columns: dict[str, h5py.Dataset]
    committed: int

    def read(self, name: str) -> NDArray[Any]:
        values: NDArray[Any] = self.columns[name][: self.committed]
        return values


@dataclass(frozen=True)
class _Camera:
    stream: CameraStream
    data: h5py.Dataset
    compression: Compression
    table: _Table


@dataclass(frozen=True)
class _Probe:
    stream: ProbeStream
    table: _Table
    pulses: _Table


class RunFile:
    """A run file opened for reading; make it with `open_run`.

    What was committed at the time of opening is what it shows, even while the run is still being written.
    """

    def __init__(self, path: Path, file: h5py.File) -> None:
        self.path = path
        self._file = file
        entry = untrusted.get_group(file, layout.ENTRY)
        details = untrusted.get_group(entry, layout.DETAILS)
        version = untrusted.get_scalar(details, "format_version")
        if version != layout.FORMAT_VERSION:
            raise StoreError(f"'{path}' has format version {version}; this program reads 1")
        self._details = details
        parts = {name: untrusted.get_json(details, name) for name in ("rig", "calibration", "versions")}
        header = untrusted.get_json(details, "header")
        self.header = TypeAdapter(RunHeader).validate_python({**header, **parts})
        self.complete = untrusted.get_scalar(details, "finished") == 1
        self.end_reason = untrusted.get_text(details, "end_reason")
        self.end_time = untrusted.get_text(entry, "end_time")
        file_bytes = path.stat().st_size
        streams = TypeAdapter(_Streams).validate_python(untrusted.get_json(details, "streams"))
        if len(streams.cameras) + len(streams.probes) > _MAX_DEVICES:
            raise ValueError(f"it claims more than {_MAX_DEVICES} devices")
        instrument = untrusted.get_group(entry, "instrument")
        self._cameras = {
            stream.name: _read_camera(instrument, stream, file_bytes) for stream in streams.cameras
        }
        self._probes = {stream.name: _read_probe(instrument, stream, file_bytes) for stream in streams.probes}
        self._events = _table(untrusted.get_group(entry, "events"), layout.EVENT_COLUMNS, file_bytes)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of the rig."""
        return tuple(self._cameras)

    @property
    def compression(self) -> Compression:
        """How the pictures are compressed."""
        return next((camera.compression for camera in self._cameras.values()), "none")

    @property
    def probes(self) -> tuple[str, ...]:
        """Names of the wave probes, in the order of the rig."""
        return tuple(self._probes)

    @property
    def rig(self) -> Rig:
        """The rig of this run; raises `StoreError` when this version cannot read it."""
        try:
            return Rig.model_validate(self.header.rig)
        except ValidationError as error:
            raise StoreError(f"the rig stored in '{self.path}' cannot be used: {error}") from None

    def camera(self, name: str) -> CameraStream:
        """How a camera took part."""
        return self._camera(name).stream

    def probe_stream(self, name: str) -> ProbeStream:
        """How a probe took part."""
        return self._probe(name).stream

    def frame_count(self, camera: str) -> int:
        """Number of committed frames of a camera."""
        return self._camera(camera).table.committed

    def uncommitted_frames(self, camera: str) -> int:
        """Number of frames begun but not committed when the writer died; they are not to be read."""
        found = self._camera(camera)
        return max(0, int(found.data.shape[0]) - found.table.committed)

    def frames(self, camera: str) -> FrameTable:
        """One row per committed frame."""
        table = self._camera(camera).table
        with untrusted.explained(self.path):
            return FrameTable(**{name: table.read(name) for name in layout.FRAME_COLUMNS if name != "time"})

    def counts(self, camera: str, index: int) -> NDArray[np.uint16]:
        """Raw counts of one frame, (rows, columns) uint16.

        Raises
        ------
        StoreError
            There is no such frame, or it is damaged.
        """
        found = self._camera(camera)
        chunk = self.encoded(camera, index)
        try:
            return decode_frame(chunk, found.stream.rows, found.stream.columns, found.compression)
        except StoreError as error:
            raise StoreError(
                f"frame {index} of camera '{camera}' in '{self.path}' cannot be read: {error}",
                remedy=f"`thermacq verify {self.path}` lists every damaged frame.",
            ) from None

    def encoded(self, camera: str, index: int) -> bytes:
        """Chunk of one frame as it stands in the file; raises `StoreError` like `counts`."""
        found = self._camera(camera)
        if not 0 <= index < found.table.committed:
            raise StoreError(
                f"camera '{camera}' has no frame {index} in '{self.path}': "
                f"{found.table.committed} frames are committed"
            )
        with untrusted.explained(self.path):
            place = found.data.id.get_chunk_info_by_coord((index, 0, 0))
            if place.size > found.stream.rows * found.stream.columns * 2 + 4096 or place.filter_mask:
                raise StoreError(f"frame {index} of camera '{camera}' in '{self.path}' is damaged")
            _, chunk = found.data.id.read_direct_chunk((index, 0, 0))
            return bytes(chunk)

    def probe(self, name: str) -> ProbeSamples:
        """All committed samples of a probe."""
        found = self._probe(name)
        restarts = (event for event in self.events() if event.kind is EventKind.RECONNECTED)
        with untrusted.explained(self.path):
            return ProbeSamples(
                values=found.table.read("value"),
                ticks=found.table.read("ticks"),
                index=found.table.read("index"),
                host_ns=found.table.read("host_ns"),
                pulse_ticks=found.pulses.read("ticks"),
                channels=found.stream.channels,
                unit=found.stream.unit,
                tick_rate_hz=found.stream.tick_rate_hz,
                restarts_ns=tuple(event.host_ns for event in restarts if event.device == name),
            )

    def events(self) -> list[Event]:
        """All committed events, in the order of writing."""
        with untrusted.explained(self.path):
            columns = [self._events.read(name) for name in layout.EVENT_COLUMNS]
            return [
                Event(int(host_ns), device.decode(), EventKind(kind.decode()), int(index), detail.decode())
                for host_ns, device, kind, index, detail in zip(*columns, strict=True)
            ]

    def summary(self) -> dict[str, Any] | None:
        """What the recorder wrote at the end; None when the run was not finished."""
        with untrusted.explained(self.path):
            return dict(untrusted.get_json(self._details, "summary")) if self.complete else None

    def calibration(self) -> dict[str, Any] | None:
        """The calibration that was recorded with the run."""
        return self.header.calibration

    def corrections(self) -> dict[str, CameraCorrection]:
        """The corrections that were recorded with the run, by camera; they are not applied to `counts`.

        Raises
        ------
        StoreError
            One of them is damaged.
        """
        from thermacq_calibration import CalibrationError, CameraCorrection

        if layout.CORRECTIONS not in self._details:
            return {}
        with untrusted.explained(self.path):
            group = untrusted.get_group(self._details, layout.CORRECTIONS)
            names = [name for name in self._cameras if name in group]
            try:
                return {name: CameraCorrection.from_group(untrusted.get_group(group, name)) for name in names}
            except CalibrationError as error:
                raise StoreError(
                    f"a correction stored in '{self.path}' is damaged: {error.what}",
                    kept="The raw counts are not concerned.",
                    remedy="Give the corrections as files, or go without them.",
                ) from None

    def sha256(self) -> str:
        """SHA-256 of the file, hexadecimal: its name in every derived product."""
        with self.path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()

    def close(self) -> None:
        """Let go of the file."""
        with contextlib.suppress(*untrusted.DAMAGE):
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _camera(self, name: str) -> _Camera:
        if name not in self._cameras:
            raise StoreError(
                f"there is no camera '{name}' in '{self.path}'; it has: {', '.join(self._cameras) or 'none'}"
            )
        return self._cameras[name]

    def _probe(self, name: str) -> _Probe:
        if name not in self._probes:
            raise StoreError(
                f"there is no probe '{name}' in '{self.path}'; it has: {', '.join(self._probes) or 'none'}"
            )
        return self._probes[name]


def open_run(path: Path | str) -> RunFile:
    """Open a run file for reading.

    Raises
    ------
    StoreError
        There is no such file, or it is no run file, damaged, or not to be trusted.
    """
    path = Path(path)
    if not path.is_file():
        raise StoreError(f"there is no run file '{path}'")
    file = untrusted.open_hdf5(path)
    try:
        with untrusted.explained(path):
            return RunFile(path, file)
    except StoreError:
        with contextlib.suppress(*untrusted.DAMAGE):
            file.close()
        raise


def _read_camera(instrument: h5py.Group, stream: CameraStream, file_bytes: int) -> _Camera:
    rows, columns = stream.rows, stream.columns
    if rows < 1 or columns < 1 or rows * columns > _MAX_PIXELS:
        raise ValueError(f"camera '{stream.name}' claims pictures of {rows} x {columns} pixels")
    detector = untrusted.get_group(instrument, stream.name)
    # Counts before contents: beside a writer, whatever was counted is there when it is looked at later.
    table = _table(untrusted.get_group(detector, layout.DETAILS), layout.FRAME_COLUMNS, file_bytes)
    data = untrusted.get_dataset(detector, "data")
    if data.dtype != np.uint16 or data.shape[1:] != (rows, columns) or data.chunks != (1, rows, columns):
        raise ValueError(f"the pictures of camera '{stream.name}' are not stored as they must be")
    properties = data.id.get_create_plist()
    filters = [properties.get_filter(number) for number in range(properties.get_nfilters())]
    if [number for number, *_ in filters] not in ([], [BLOSC_FILTER]):
        raise ValueError(f"the pictures of camera '{stream.name}' are compressed in an unknown way")
    compression = compression_of(filters[0][2]) if filters else "none"
    if table.committed > data.shape[0]:
        raise ValueError(f"camera '{stream.name}' claims more frames than there are")
    return _Camera(stream, data, compression, table)


def _read_probe(instrument: h5py.Group, stream: ProbeStream, file_bytes: int) -> _Probe:
    group = untrusted.get_group(instrument, f"{stream.name}_{layout.DETAILS}")
    table = _table(group, layout.SAMPLE_COLUMNS, file_bytes)
    value = untrusted.get_dataset(group, "value")
    channels = len(stream.channels)
    if value.dtype != np.float64 or value.shape[1:] != (channels,) or value.shape[0] < table.committed:
        raise ValueError(f"the samples of probe '{stream.name}' are not stored as they must be")
    if value.id.get_create_plist().get_nfilters() or table.committed * channels * 8 > file_bytes:
        raise ValueError(f"probe '{stream.name}' claims more samples than the file can hold")
    columns = {**table.columns, "value": value}
    pulses = _table(untrusted.get_group(group, "pulses"), {"ticks": ("i8", "")}, file_bytes)
    return _Probe(stream, _Table(columns, table.committed), pulses)


def _table(group: h5py.Group, columns: dict[str, tuple[str, str]], file_bytes: int) -> _Table:
    """Check the columns of a table: type, length, and that the file is large enough to hold them."""
    committed = untrusted.get_scalar(group, layout.COMMITTED)
    if committed < 0:
        raise ValueError(f"'{group.name}' claims {committed} rows")
    found = {}
    for name, (dtype, _) in columns.items():
        column = untrusted.get_dataset(group, name)
        if column.dtype != np.dtype(dtype) or column.ndim != 1 or column.shape[0] < committed:
            raise ValueError(f"the column '{column.name}' is not stored as it must be")
        if column.id.get_create_plist().get_nfilters() or committed * column.dtype.itemsize > file_bytes:
            raise ValueError(f"'{column.name}' claims more rows than the file can hold")
        found[name] = column
    return _Table(found, committed)
