"""Mending a run file: copy everything committed and sound into a clean file, and say what was lost."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import FrameFlag
from thermacq.errors import StoreError
from thermacq.rig import StoreTable
from thermacq.store.reader import RunFile, open_run
from thermacq.store.records import FrameRow, FrameTable
from thermacq.store.verification import Progress, damaged_frames
from thermacq.store.writer import RunWriter

if TYPE_CHECKING:
    from thermacq_calibration import CameraCorrection

_FRAMES_PER_FLUSH = 100


@dataclass
class RecoveryReport:
    """Result of `recover`: what was saved, and what was lost, by device."""

    path: Path
    output: Path
    was_complete: bool
    frames: dict[str, int] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    events: int = 0
    uncommitted: dict[str, int] = field(default_factory=dict)
    """Frames that the writer had begun but not committed when it died."""
    damaged: dict[str, list[int]] = field(default_factory=dict)
    """Rows of committed frames whose data are damaged; they become gaps in the sequence number."""
    lost_corrections: str = ""
    """Why the cameras' corrections could not be copied; empty when they were, or there were none."""

    @property
    def lost(self) -> int:
        """Number of frames known to be lost."""
        return sum(self.uncommitted.values()) + sum(len(rows) for rows in self.damaged.values())


def recover(path: Path, output: Path, progress: Progress | None = None) -> RecoveryReport:
    """Copy what was committed to a clean run file; the original is only read.

    Raises
    ------
    StoreError
        The file cannot be opened as a run file, or the output exists or cannot be written.
    """
    with open_run(path) as run:
        report = RecoveryReport(path, output, run.complete)
        cameras = [run.camera(name) for name in run.cameras]
        probes = [run.probe_stream(name) for name in run.probes]
        settings = StoreTable(compression=run.compression)
        corrections = _corrections(run, report)
        writer = RunWriter.create(output, run.header, cameras, probes, settings, corrections)
        try:
            _copy_frames(run, writer, report, progress)
            for probe in run.probes:
                report.samples[probe] = _copy_samples(run, writer, probe)
            for event in run.events():
                writer.append_event(event)
                report.events += 1
            _finish(run, writer, report)
        except BaseException as error:
            writer.close()
            output.unlink(missing_ok=True)
            if isinstance(error, StoreError):
                kept = f"'{path}' is untouched; the unfinished '{output}' was removed."
                raise StoreError(error.what, kept=kept, remedy=error.remedy) from None
            raise
    return report


def _corrections(run: RunFile, report: RecoveryReport) -> dict[str, CameraCorrection]:
    try:
        return run.corrections()
    except StoreError as error:
        report.lost_corrections = error.what
        return {}


def _copy_frames(run: RunFile, writer: RunWriter, report: RecoveryReport, progress: Progress | None) -> None:
    total = sum(run.frame_count(camera) for camera in run.cameras)
    done = 0
    for camera in run.cameras:

        def advance(row: int, before: int = done) -> None:
            if progress is not None:
                progress(before + row + 1, total)

        damaged = damaged_frames(run, camera, advance)
        table = run.frames(camera)
        kept = np.setdiff1d(np.arange(len(table)), damaged)
        restarted = _restarted_rows(table, kept)
        for row in kept:
            stored = FrameRow(
                counter=int(table.counter[row]),
                ticks=int(table.ticks[row]),
                host_ns=int(table.host_ns[row]),
                trigger_index=int(table.trigger_index[row]),
                trigger_ns=int(table.trigger_ns[row]),
                flags=int(table.flags[row]) | (int(FrameFlag.RESTARTED) if row in restarted else 0),
                fpa_temperature_k=float(table.fpa_temperature_k[row]),
            )
            writer.append_encoded(camera, run.encoded(camera, int(row)), stored, int(table.crc32[row]))
            if row % _FRAMES_PER_FLUSH == 0:
                writer.flush()
        report.frames[camera] = len(table) - len(damaged)
        report.uncommitted[camera] = run.uncommitted_frames(camera)
        report.damaged[camera] = damaged
        done += len(table)


def _restarted_rows(table: FrameTable, kept: NDArray[np.intp]) -> set[int]:
    """First row that is kept after each restart of the camera, should the very first one be damaged."""
    restarts = np.flatnonzero(table.flags & FrameFlag.RESTARTED)
    places = np.searchsorted(kept, restarts)
    return set(kept[places[places < kept.size]].tolist())


def _copy_samples(run: RunFile, writer: RunWriter, probe: str) -> int:
    """Copy block by block: a block ends where the time of receipt changes or the index jumps."""
    samples = run.probe(probe)
    jumps = (np.diff(samples.host_ns) != 0) | (np.diff(samples.index) != 1)
    edges = [0, *(np.flatnonzero(jumps) + 1).tolist(), len(samples)] if len(samples) else [0]
    pulses = samples.pulse_ticks
    for first, last in pairwise(edges):
        writer.append_samples(
            probe,
            samples.values[first:last],
            samples.ticks[first:last],
            int(samples.index[first]),
            int(samples.host_ns[first]),
        )
    empty = samples.values[:0], samples.ticks[:0]
    writer.append_samples(probe, *empty, first_index=0, host_ns=0, pulse_ticks=pulses)
    return len(samples)


def _finish(run: RunFile, writer: RunWriter, report: RecoveryReport) -> None:
    if run.complete and not report.lost and not report.lost_corrections:
        writer.finish(run.summary() or {}, run.end_reason, run.end_time)
        return
    moments = [run.header.host_anchor_ns]
    for camera in run.cameras:
        moments.extend(run.frames(camera).host_ns[-1:].tolist())
    unix_ns = run.header.wall_anchor_ns + max(moments) - run.header.host_anchor_ns
    summary = (run.summary() or {}) | {
        "recovered": {
            "from": str(report.path.name),
            "frames": report.frames,
            "samples": report.samples,
            "uncommitted": report.uncommitted,
            "damaged": report.damaged,
            "lost_corrections": report.lost_corrections,
        }
    }
    end_time = run.end_time or datetime.fromtimestamp(unix_ns / 1e9, UTC).isoformat()
    writer.finish(summary, run.end_reason or "recovered: the writer ended before it closed the run", end_time)
