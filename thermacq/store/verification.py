"""Checking a run file: every checksum, every counter, every gap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import StoreError
from thermacq.store.codec import frame_crc32
from thermacq.store.reader import RunFile, open_run
from thermacq.store.records import LOSS_KINDS, EventKind, FrameTable, ProbeSamples

Progress = Callable[[int, int], None]
"""Told the number of frames done and to do."""

_LISTED = 10


@dataclass(frozen=True)
class Finding:
    """Something about a device (or the file, ``run``) that a user should know."""

    where: str
    what: str


@dataclass
class VerifyReport:
    """Result of `verify`.

    `findings` are faults; `notes` are gaps that the recording itself explains by an event.
    """

    path: Path
    complete: bool
    frames: dict[str, int] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    notes: list[Finding] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings


def verify(path: Path, progress: Progress | None = None) -> VerifyReport:
    """Read a whole run file and compare everything in it that can be compared.

    Raises
    ------
    StoreError
        The file cannot be opened as a run file at all.
    """
    with open_run(path) as run:
        report = VerifyReport(path, run.complete)
        if not run.complete:
            what = "the run was not closed: it is being written, or its writer died (`thermacq recover`)"
            report.findings.append(Finding("run", what))
        losses = _losses(run, report)
        _check_corrections(run, report)
        total = sum(run.frame_count(camera) for camera in run.cameras)
        done = 0
        for camera in run.cameras:
            report.frames[camera] = run.frame_count(camera)
            done = _check_pictures(run, camera, report, done, total, progress)
            _check_rows(run, camera, report, losses)
        for probe in run.probes:
            _check_samples(run, probe, report, losses)
    return report


def damaged_frames(run: RunFile, camera: str, progress: Callable[[int], None]) -> list[int]:
    """Rows of the frames that cannot be read, or whose checksum is wrong; `progress` is told each row."""
    checksums = run.frames(camera).crc32
    damaged = []
    for row, checksum in enumerate(checksums):
        try:
            sound = frame_crc32(run.counts(camera, row)) == checksum
        except StoreError:
            sound = False
        if not sound:
            damaged.append(row)
        progress(row)
    return damaged


def _check_pictures(
    run: RunFile, camera: str, report: VerifyReport, done: int, total: int, progress: Progress | None
) -> int:
    def advance(row: int) -> None:
        if progress is not None:
            progress(done + row + 1, total)

    try:
        damaged = damaged_frames(run, camera, advance)
    except StoreError as error:
        report.findings.append(Finding(camera, error.what))
        return done + run.frame_count(camera)
    if damaged:
        listed = ", ".join(str(row) for row in damaged[:_LISTED])
        more = f" and {len(damaged) - _LISTED} more" if len(damaged) > _LISTED else ""
        report.findings.append(Finding(camera, f"damaged frames: {listed}{more}"))
    if uncommitted := run.uncommitted_frames(camera):
        report.findings.append(Finding(camera, f"frames begun but never committed: {uncommitted}"))
    return done + run.frame_count(camera)


def _check_rows(run: RunFile, camera: str, report: VerifyReport, losses: set[str]) -> None:
    try:
        table = run.frames(camera)
    except StoreError:
        return  # said already: the pictures could not be checked without it
    _check_steps(report, camera, "frame counter", table.sequence_number, camera in losses)
    triggers = table.trigger_index[table.trigger_index >= 0]
    _check_steps(report, camera, "trigger index", triggers, camera in losses)
    _check_order(report, camera, "host times", table.host_ns)
    known = table.ticks >= 0
    _check_order(report, camera, "device times", table.ticks[known], _begins(table, table.host_ns[known]))


def _check_samples(run: RunFile, probe: str, report: VerifyReport, losses: set[str]) -> None:
    try:
        samples = run.probe(probe)
    except StoreError as error:
        report.findings.append(Finding(probe, error.what))
        return
    report.samples[probe] = len(samples)
    _check_steps(report, probe, "sample count", samples.index, probe in losses)
    _check_order(report, probe, "host times", samples.host_ns)
    known = samples.ticks >= 0
    begins = _begins(samples, samples.host_ns[known])
    _check_order(report, probe, "device times", samples.ticks[known], begins)
    # Pulses have no time of receipt; they may go back as often as the probe began anew.
    back = np.flatnonzero(np.diff(samples.pulse_ticks) < 0)[: len(samples.restarts_ns)] + 1
    _check_order(report, probe, "trigger pulse times", samples.pulse_ticks, back)
    if bad := int(np.count_nonzero(~np.isfinite(samples.values))):
        report.findings.append(Finding(probe, f"{bad} values are not numbers"))


def _check_steps(
    report: VerifyReport, where: str, what: str, numbers: NDArray[np.int64], explained: bool
) -> None:
    steps = np.diff(numbers)
    if missing := int(np.sum(steps[steps > 1] - 1)):
        gaps = int(np.count_nonzero(steps > 1))
        text = f"{what}: {missing} missing in {gaps} gaps"
        if explained:
            report.notes.append(Finding(where, f"{text}; the recording explains losses by events"))
        else:
            report.findings.append(Finding(where, f"{text}, and no event explains them"))
    if back := int(np.count_nonzero(steps < 1)):
        report.findings.append(Finding(where, f"{what}: stands still or goes back {back} times"))


def _begins(device: FrameTable | ProbeSamples, host_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows with which the device counts anew, among those with these times of receipt."""
    return np.searchsorted(host_ns, np.array(device.restarts_ns, np.int64))


def _check_order(
    report: VerifyReport,
    where: str,
    what: str,
    times: NDArray[np.int64],
    begins: NDArray[np.intp] | None = None,
) -> None:
    """Times must not go back, but at the rows with which the device counts anew."""
    is_back = times[1:] < times[:-1]
    if begins is not None:
        is_back[begins[(begins > 0) & (begins < times.size)] - 1] = False
    if back := int(np.count_nonzero(is_back)):
        report.findings.append(Finding(where, f"{what}: go back {back} times"))


def _check_corrections(run: RunFile, report: VerifyReport) -> None:
    try:
        run.corrections()
    except StoreError as error:
        report.findings.append(Finding("run", error.what))


def _losses(run: RunFile, report: VerifyReport) -> set[str]:
    """Devices with an event that explains missing frames or samples."""
    try:
        told = [event for event in run.events() if event.kind in LOSS_KINDS]
        explained = {event.device for event in told}
        back = {event.device for event in told if event.kind is EventKind.RECONNECTED}
        # While the trigger source is away, pulses that it is believed to have emitted are missing everywhere.
        return (
            explained | set(run.cameras)
            if back & set(run.header.rig.get("trigger_sources", ()))
            else explained
        )
    except StoreError as error:
        report.findings.append(Finding("run", f"events: {error.what}"))
        return set()
