"""Writing a run file so that whatever was committed survives a crash or a full disk.

Order of things: the chunk of a picture, then its index rows, then a flush, then the count of committed
rows, then a flush of that. Readers trust the counts, never the shapes of datasets. h5py may crash when a
file is closed after the disk was full, so a recorder runs the writer in a process of its own.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import Counts, FrameFlag
from thermacq.errors import StoreError
from thermacq.rig import StoreTable
from thermacq.store import layout, operations
from thermacq.store.codec import Compression, encode_frame, frame_crc32
from thermacq.store.disk import MEGABYTE, Ballast, free_bytes
from thermacq.store.records import CameraStream, Event, FrameRow, ProbeStream, RunHeader
from thermacq.store.tables import CameraSink, Table

if TYPE_CHECKING:
    import h5py

    from thermacq_calibration import CameraCorrection

LIBRARY_VERSIONS = ("v110", "v110")
"""File format: the oldest that knows single-writer-multiple-reader."""


class RunWriter:
    """Writes one run file; make it with `create_run`.

    Nothing is promised before `flush` returns: call it at least every 0.5 s. After a write error every
    method raises `StoreError`, what was committed stays readable, and `close` remains to be called.
    """

    def __init__(
        self,
        path: Path,
        file: h5py.File,
        header: RunHeader,
        cameras: Sequence[CameraStream],
        probes: Sequence[ProbeStream],
        settings: StoreTable,
        ballast: Ballast,
    ) -> None:
        self.path = path
        self._file = file
        self._header = header
        self._compression: Compression = settings.compression
        self._reserve_bytes = int(settings.reserve_mb * MEGABYTE)
        self._ballast = ballast
        self._failure = ""
        self._disk_is_lost = False
        self._finished = False
        entry = file[layout.ENTRY]
        self._entry = entry
        instrument = entry["instrument"]
        self._cameras = {
            camera.name: CameraSink(
                camera,
                instrument[camera.name]["data"],
                _table(instrument[camera.name][layout.DETAILS], layout.FRAME_COLUMNS),
            )
            for camera in cameras
        }
        self._probes = {probe.name: probe for probe in probes}
        self._samples: dict[str, Table] = {}
        self._pulses: dict[str, Table] = {}
        for probe in probes:
            group = instrument[f"{probe.name}_{layout.DETAILS}"]
            self._samples[probe.name] = _table(group, [*layout.SAMPLE_COLUMNS, "value"])
            self._pulses[probe.name] = _table(group["pulses"], ["ticks"])
        self._events = _table(entry["events"], layout.EVENT_COLUMNS)

    @classmethod
    def create(
        cls,
        path: Path,
        header: RunHeader,
        cameras: Sequence[CameraStream],
        probes: Sequence[ProbeStream] = (),
        settings: StoreTable | None = None,
        corrections: Mapping[str, CameraCorrection] | None = None,
    ) -> RunWriter:
        """Make a new run file and open it for writing; `corrections` are those of its cameras, by name.

        Raises
        ------
        StoreError
            The path exists, the folder is missing or read-only, the disk is full, a name is unfit.
        """
        import h5py

        settings = settings or StoreTable()
        layout.check_names(list(cameras), list(probes))
        if path.exists():
            raise StoreError(
                f"'{path}' exists already; a run file is never overwritten",
                remedy="Choose another name, or move the old file away.",
            )
        if not path.parent.is_dir():
            raise StoreError(f"there is no folder '{path.parent}'", remedy="Create it, or choose another.")
        file = None
        try:
            ballast = Ballast(path.parent)
            file = h5py.File(path, "x", libver=LIBRARY_VERSIONS)
            layout.create_layout(
                file, header, list(cameras), list(probes), settings.compression, corrections or {}
            )
            file.swmr_mode = True
            return cls(path, file, header, cameras, probes, settings, ballast)
        except (OSError, RuntimeError) as error:
            if file is not None:
                with contextlib.suppress(OSError, RuntimeError):
                    file.close()
                path.unlink(missing_ok=True)
            raise StoreError(
                f"'{path}' cannot be created: {_reason(error)}",
                remedy="Check that the folder may be written to and that its disk has room.",
            ) from None

    def append_frame(self, camera: str, counts: Counts, row: FrameRow) -> None:
        """Compress and store one picture; see `append_encoded`."""
        encoded = encode_frame(counts, self._compression)
        self.append_encoded(camera, encoded, row, frame_crc32(counts))

    def append_encoded(self, camera: str, encoded: bytes, row: FrameRow, crc32: int) -> None:
        """Store one picture that `encode_frame` has compressed with this run's compression.

        Parameters
        ----------
        camera
            Name of the camera.
        encoded
            What `encode_frame` returned.
        row
            What is stored beside the picture.
        crc32
            What `frame_crc32` returned for the raw counts.

        Raises
        ------
        StoreError
            The write failed, now or before.
        """
        target = self._cameras[camera]
        table = target.table
        with self._guard():
            operations.write_chunk(target.data, table.rows, encoded)
        moment_ns = row.trigger_ns if row.trigger_ns >= 0 else row.host_ns
        table.append(
            row.counter,
            target.next_sequence_number(row.counter, bool(row.flags & FrameFlag.RESTARTED)),
            row.ticks,
            row.host_ns,
            row.trigger_index,
            row.trigger_ns,
            row.flags,
            row.fpa_temperature_k,
            crc32,
            self._seconds(moment_ns),
        )

    def append_samples(
        self,
        probe: str,
        values: NDArray[np.float64],
        ticks: NDArray[np.int64],
        first_index: int,
        host_ns: int,
        pulse_ticks: NDArray[np.int64] | Sequence[int] = (),
    ) -> None:
        """Store a block of samples: `values` (samples, channels), `ticks` (samples,).

        Raises
        ------
        StoreError
            The run has failed before, or the block has not the probe's shape.
        """
        self._check_alive()
        stream = self._probes[probe]
        values = np.asarray(values, np.float64)
        if values.shape != (len(ticks), len(stream.channels)):
            raise StoreError(
                f"probe '{probe}' delivered a block of shape {values.shape} with {len(ticks)} ticks; "
                f"it has {len(stream.channels)} channels"
            )
        table = self._samples[probe]
        for offset, (tick, value) in enumerate(zip(ticks, values, strict=True)):
            time_s = tick / stream.tick_rate_hz if stream.tick_rate_hz > 0 else self._seconds(host_ns)
            table.append(tick, first_index + offset, host_ns, time_s, value)
        for pulse in pulse_ticks:
            self._pulses[probe].append(pulse)

    def append_event(self, event: Event) -> None:
        """Store an event; raises `StoreError` when the run has failed before."""
        self._check_alive()
        self._events.append(
            event.host_ns,
            layout.cut_text(event.device, layout.DEVICE_BYTES),
            layout.cut_text(event.kind, layout.KIND_BYTES),
            event.index,
            layout.cut_text(event.detail, layout.DETAIL_BYTES),
        )

    def flush(self) -> None:
        """Commit everything appended so far; on return it survives the death of this process.

        Raises
        ------
        StoreError
            The write failed, now or before; the message says what is safe.
        """
        with self._guard():
            self._commit()

    @property
    def disk_reserve_reached(self) -> bool:
        """Whether less than the reserve is free: the recording should end now, while it can end well."""
        return free_bytes(self.path) < self._reserve_bytes

    def committed(self, camera: str) -> int:
        """Number of frames of a camera that are safe."""
        return self._cameras[camera].table.committed

    def finish(self, summary: dict[str, Any], end_reason: str, end_time: str = "") -> None:
        """Commit everything, store summary, end time (ISO 8601) and reason, mark the run complete, close.

        Raises
        ------
        StoreError
            The write failed, now or before.
        """
        details = self._entry[layout.DETAILS]
        try:
            with self._guard():
                self._commit()
                operations.write_value(details["summary"], layout.fit_summary(summary))
                reason = layout.cut_text(end_reason, layout.END_REASON_BYTES)
                operations.write_value(details["end_reason"], reason)
                operations.write_value(self._entry["end_time"], layout.cut_text(end_time, 32))
                operations.flush_file(self._file)
                operations.write_value(details["finished"], 1)
                operations.flush_file(self._file)
                self._finished = True
        finally:
            self.close()

    def close(self) -> None:
        """Close the file without marking the run complete; legal at any time, never raises.

        A file that the disk refuses for good is left to the end of the process, where HDF5 may crash
        over it: closed here, it could crash before anybody was told.
        """
        if self._file and not self._disk_is_lost:
            if not self._failure and not self._finished:
                with contextlib.suppress(StoreError):
                    self.flush()
            self._ballast.release()
            if not self._disk_is_lost:
                with contextlib.suppress(OSError, RuntimeError):
                    self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _tables(self) -> Iterator[Table]:
        for camera in self._cameras.values():
            yield camera.table
        yield from self._samples.values()
        yield from self._pulses.values()
        yield self._events

    def _commit(self) -> None:
        for table in self._tables():
            table.write()
        operations.flush_file(self._file)
        for table in self._tables():
            table.commit()

    @contextlib.contextmanager
    def _guard(self) -> Iterator[None]:
        """Turn the first write error into a failed run whose committed part is saved."""
        self._check_alive()
        try:
            yield
        except (OSError, RuntimeError) as error:
            self._failure = _reason(error)
            self._ballast.release()
            try:
                self._commit()
            except (OSError, RuntimeError):
                self._disk_is_lost = True
            raise self._error() from error

    def _check_alive(self) -> None:
        if self._failure:
            raise self._error()
        if not self._file:
            raise StoreError(f"'{self.path}' is closed")

    def _error(self) -> StoreError:
        frames = ", ".join(f"{name} {camera.table.committed}" for name, camera in self._cameras.items())
        return StoreError(
            f"writing to '{self.path}' failed: {self._failure}",
            kept=f"Everything committed is safe; frames: {frames or 'none'}.",
            remedy=f"Make room, then `thermacq recover {self.path} -o NEW.h5` makes a clean file of it.",
        )

    def _seconds(self, host_ns: int) -> float:
        return (host_ns - self._header.host_anchor_ns) / 1e9


def _table(group: h5py.Group, columns: Sequence[str] | dict[str, Any]) -> Table:
    return Table([group[name] for name in columns], group[layout.COMMITTED])


def _reason(error: Exception) -> str:
    """What the disk said; h5py hides it in a long text, sometimes without errno."""
    text = str(error)
    for number, meaning in (("28", "no space is left on the disk"), ("30", "the file system is read-only")):
        if f"errno = {number}" in text or f"Errno {number}" in text:
            return meaning
    return text
