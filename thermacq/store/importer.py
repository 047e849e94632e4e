"""Make a run file of pictures or videos that were taken elsewhere, so that they can be used like a recording."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from itertools import chain, zip_longest
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from thermacq import __version__
from thermacq.devices import Counts
from thermacq.errors import ImportDataError
from thermacq.rig import Rig
from thermacq.store.pictures import PictureSource, open_source
from thermacq.store.records import CameraStream, Event, EventKind, FrameRow, RunHeader
from thermacq.store.writer import RunWriter

_FRAMES_PER_FLUSH = 50
_TIME_COLUMNS = ("time", "time_s", "timestamp", "timestamp_s", "seconds", "t")
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class ImportReport:
    """Result of `import_pictures`; `notes` say what was changed or assumed."""

    output: Path
    frames: int
    rows: int
    columns: int
    bit_depth: int
    frame_rate_hz: float
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Times:
    """When the frames were taken: listed, or at a steady rate."""

    rate_hz: float
    listed_ns: tuple[int, ...] | None
    origin: str

    @property
    def first_ns(self) -> int:
        return self.listed_ns[0] if self.listed_ns else 0

    def host_ns(self, index: int) -> int:
        return self.listed_ns[index] if self.listed_ns else round(index * _NS_PER_S / self.rate_hz)


def import_pictures(
    left: str,
    right: str,
    output: Path,
    *,
    rate_hz: float | None = None,
    timestamps: Path | None = None,
    progress: Callable[[int], None] | None = None,
) -> ImportReport:
    """Make a run file with the cameras ``left`` and ``right``; the n-th pictures of both belong together.

    Parameters
    ----------
    left, right
        Folder, pattern (glob), or file: pictures, NumPy arrays, or a video.
    output
        The run file to be.
    rate_hz
        Steady frame rate.
    timestamps
        Text or CSV file with the time of each pair in seconds, one per line. With neither a rate nor
        time stamps, a video gives its own rate; a single pair needs none.
    progress
        Told the number of pairs done.

    Raises
    ------
    ImportDataError
        The pictures or times cannot be used; the message names the file.
    StoreError
        The run file cannot be written.
    """
    if left == right:
        raise ImportDataError(f"left and right are the same: '{left}'")
    sources = {"left": open_source(left), "right": open_source(right)}
    times = _choose_times(sources["left"], sources["right"], rate_hz, timestamps)
    pairs = _pairs(sources["left"], sources["right"])
    first = next(pairs)
    rows, columns = first[0].shape
    depth = sources["left"].bit_depth
    cameras = [
        CameraStream(name, rows, columns, {"driver": "imported"}, {}, {"bit_depth": depth})
        for name in sources
    ]
    writer = RunWriter.create(output, _header(times), cameras)
    complete = False
    try:
        frames = 0
        for frames, pair in enumerate(chain([first], pairs), start=1):
            _check_number(times, frames, ended=False)
            for name, counts in zip(sources, pair, strict=True):
                row = FrameRow(frames - 1, -1, times.host_ns(frames - 1), trigger_index=frames - 1)
                writer.append_frame(name, counts, row)
            if frames % _FRAMES_PER_FLUSH == 0:
                writer.flush()
            if progress is not None:
                progress(frames)
        _check_number(times, frames, ended=True)
        notes = _notes(sources, times)
        for note in notes:
            writer.append_event(Event(times.first_ns, "", EventKind.NOTE, detail=note))
        summary = {"imported": {name: source.spec for name, source in sources.items()}, "notes": notes}
        writer.finish(summary, "imported", datetime.now(UTC).isoformat())
        complete = True
    finally:
        if not complete:
            writer.close()
            output.unlink(missing_ok=True)
    return ImportReport(output, frames, rows, columns, depth, times.rate_hz, tuple(notes))


def read_timestamps(path: Path) -> tuple[int, ...]:
    """Times in nanoseconds from a text or CSV file with seconds.

    A column named time, timestamp or seconds is used where a header names one, else the first column.

    Raises
    ------
    ImportDataError
        The file cannot be read, a line holds no number, or a time is not later than the one before it.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ImportDataError(f"the time stamps '{path}' cannot be read: {error}") from None
    column = 0
    times: list[int] = []
    for number, line in enumerate(text.splitlines(), start=1):
        cells = [cell.strip().strip('"') for cell in line.replace(";", ",").replace("\t", ",").split(",")]
        if line.strip() == "" or line.lstrip().startswith("#"):
            continue
        cells = line.split() if len(cells) == 1 else cells
        time_ns = _nanoseconds(cells[column] if column < len(cells) else "")
        if time_ns is None and not times and column == 0 and _nanoseconds(cells[0]) is None:
            column = next((i for i, cell in enumerate(cells) if cell.lower() in _TIME_COLUMNS), 0)
            if column or cells[0].lower() in _TIME_COLUMNS:
                continue
        if time_ns is None:
            raise ImportDataError(f"'{path}', line {number}: '{line.strip()[:60]}' has no time in seconds")
        if times and time_ns <= times[-1]:
            raise ImportDataError(f"'{path}', line {number}: the time is not later than the one before it")
        times.append(time_ns)
    if not times:
        raise ImportDataError(f"'{path}' holds no time stamps", remedy="Write one time in seconds per line.")
    return tuple(times)


def _nanoseconds(text: str) -> int | None:
    """Exact nanoseconds of a decimal number of seconds, None when it is none or beyond 64 bits."""
    try:
        time_ns = Decimal(text) * _NS_PER_S
    except InvalidOperation:
        return None
    return round(time_ns) if time_ns.is_finite() and abs(time_ns) < 1 << 62 else None


def _choose_times(
    left: PictureSource, right: PictureSource, rate_hz: float | None, timestamps: Path | None
) -> _Times:
    if rate_hz is not None and timestamps is not None:
        raise ImportDataError("both a rate and time stamps were given", remedy="Give one of them.")
    if timestamps is not None:
        listed = read_timestamps(timestamps)
        steps = np.diff(np.asarray(listed, np.int64))
        rate = _NS_PER_S / float(np.median(steps)) if len(steps) else 1.0
        return _Times(rate, listed, f"times come from '{timestamps.name}'")
    if rate_hz is not None:
        if not 0 < rate_hz <= 10_000:
            raise ImportDataError(f"a frame rate of {rate_hz} Hz is impossible", remedy="Give 0 to 10000 Hz.")
        return _Times(rate_hz, None, f"times follow from a steady rate of {rate_hz} Hz")
    if left.is_video and right.is_video:
        rates = left.frame_rate_hz(), right.frame_rate_hz()
        if min(rates) <= 0 or abs(rates[0] - rates[1]) > 1e-3 * max(rates):
            raise ImportDataError(
                f"the videos state frame rates of {rates[0]:g} and {rates[1]:g} Hz", remedy="Give --rate-hz."
            )
        return _Times(rates[0], None, f"times follow from the rate of the left video, {rates[0]:g} Hz")
    if len(left.files) == 1 and left.files[0].suffix.lower() in (".png", ".jpg", ".jpeg"):
        return _Times(1.0, None, "a single pair: its time is zero")
    raise ImportDataError(
        "nothing says when the pictures were taken", remedy="Give --rate-hz, or --timestamps with a file."
    )


def _pairs(left: PictureSource, right: PictureSource) -> Iterator[tuple[Counts, Counts]]:
    """Pictures that belong together, checked against each other."""
    for number, (one, other) in enumerate(zip_longest(left, right)):
        if one is None or other is None:
            short, long = ("left", "right") if one is None else ("right", "left")
            raise ImportDataError(
                f"the {short} pictures end after {number}, the {long} ones go on",
                remedy="Every left picture needs a right one.",
            )
        if one.shape != other.shape:
            raise ImportDataError(
                f"the left pictures have {one.shape[1]} x {one.shape[0]} pixels, "
                f"the right ones {other.shape[1]} x {other.shape[0]}",
                remedy="Both cameras must have pictures of the same size.",
            )
        if left.bit_depth != right.bit_depth:
            raise ImportDataError(
                f"the left pictures have {left.bit_depth} bits, the right ones {right.bit_depth}",
                remedy="Both cameras must have pictures of the same depth.",
            )
        yield one, other


def _check_number(times: _Times, frames: int, *, ended: bool) -> None:
    """Compare the number of time stamps with that of the pairs seen so far."""
    listed = frames if times.listed_ns is None else len(times.listed_ns)
    if listed < frames or (ended and listed > frames):
        more = "" if ended else "at least "
        raise ImportDataError(f"there are {listed} time stamps for {more}{frames} pairs of pictures")


def _header(times: _Times) -> RunHeader:
    rig = {
        "name": "imported",
        "trigger": {"mode": "free_run", "frame_rate_hz": times.rate_hz},
        "cameras": {"left": {"driver": "imported"}, "right": {"driver": "imported"}},
    }
    try:
        resolved = Rig.model_validate(rig).model_dump(mode="json")
    except ValidationError as error:
        raise ImportDataError(f"these times cannot be used: {error.errors()[0]['msg']}") from None
    now = datetime.now(UTC)
    return RunHeader(
        run_id=str(uuid.uuid4()),
        title="imported pictures",
        start_time=now.isoformat(),
        wall_anchor_ns=round(now.timestamp() * _NS_PER_S),
        host_anchor_ns=times.first_ns,
        clock="real",
        simulated=False,
        rig=resolved,
        versions={"thermacq": __version__, "driver": "imported"},
    )


def _notes(sources: dict[str, PictureSource], times: _Times) -> list[str]:
    notes = [f"{name}: {note}" for name, source in sources.items() for note in source.notes]
    return [*notes, times.origin, "the start of the run is the time of the import"]
