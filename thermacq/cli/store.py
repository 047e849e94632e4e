"""``thermacq info``, ``verify``, ``recover`` and ``import``: look at run files, mend them, make them of footage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermacq.cli.common import EXIT_FINDINGS, AsJson, err, out, print_json

if TYPE_CHECKING:
    from collections.abc import Callable

    from thermacq.store import RunFile

Run = Annotated[Path, typer.Argument(help="A run file.", metavar="RUN")]
Output = Annotated[Path, typer.Option("--output", "-o", help="The run file to be made.")]


def info(run: Run, as_json: AsJson = False) -> None:
    """Say what a run file holds."""
    from thermacq.store import open_run

    with open_run(run) as opened:
        facts = _facts(opened)
    if as_json:
        print_json(facts)
        return
    for key in ("run", "title", "run_id", "start_time", "end_time", "end_reason", "clock", "size_mb"):
        out.print(f"{key}: {facts[key]}", markup=False)
    state = (
        "complete" if facts["complete"] else "not closed: being written, or cut short (`thermacq recover`)"
    )
    out.print(f"state: {state}{', simulated' if facts['simulated'] else ''}", markup=False)
    if facts["emulated"]:
        out.print(f"EMULATED, not hardware: {', '.join(facts['emulated'])}", markup=False)
    for camera in facts["cameras"]:
        out.print(
            f"camera {camera['name']}: {camera['frames']} frames of {camera['columns']} x {camera['rows']} "
            f"in {camera['duration_s']:.3f} s",
            markup=False,
        )
    for probe in facts["probes"]:
        channels = ", ".join(probe["channels"])
        out.print(
            f"probe {probe['name']}: {probe['samples']} samples of {channels} [{probe['unit']}]", markup=False
        )
    events = ", ".join(f"{count} {kind}" for kind, count in facts["events"].items())
    out.print(f"events: {events or 'none'}", markup=False)
    out.print(f"calibration: {'stored' if facts['calibration'] else 'none'}", markup=False)
    corrections = ", ".join(f"{name} {sha256[:12]}" for name, sha256 in facts["corrections"].items())
    out.print(f"corrections: {corrections or 'none'}", markup=False)
    for line in _sync_report(facts["summary"]):
        out.print(line, markup=False)


def _sync_report(summary: dict[str, Any] | None) -> list[str]:
    """The synchronisation report in words; none where the run has none, or one of another version."""
    from thermacq.cli.recording import sync_lines

    try:
        return sync_lines((summary or {})["sync"])
    except (KeyError, TypeError, ValueError, AttributeError):
        return []


def verify(run: Run, as_json: AsJson = False) -> None:
    """Check every checksum, counter and gap of a run file; exit status 3 when something is wrong."""
    from thermacq import store

    with _progress("checking") as progress:
        report = store.verify(run, progress)
    if as_json:
        print_json({**asdict(report), "ok": report.ok})
    else:
        counts = {**report.frames, **report.samples}
        out.print(f"{run}: " + ", ".join(f"{name} {count}" for name, count in counts.items()), markup=False)
        for note in report.notes:
            out.print(f"note: {note.where}: {note.what}", markup=False)
        for finding in report.findings:
            out.print(f"wrong: {finding.where}: {finding.what}", markup=False)
        if report.ok:
            out.print("nothing is wrong")
    if not report.ok:
        raise typer.Exit(EXIT_FINDINGS)


def recover(run: Run, output: Output) -> None:
    """Copy everything committed and sound to a clean run file, and say what was lost."""
    from thermacq import store

    with _progress("copying") as progress:
        report = store.recover(run, output, progress)
    for camera, frames in report.frames.items():
        uncommitted = report.uncommitted[camera]
        damaged = len(report.damaged[camera])
        out.print(
            f"camera {camera}: {frames} frames saved, {damaged} damaged, "
            f"{uncommitted} begun but never committed",
            markup=False,
        )
    for probe, samples in report.samples.items():
        out.print(f"probe {probe}: {samples} samples saved", markup=False)
    out.print(f"events saved: {report.events}")
    if report.lost_corrections:
        out.print(f"not copied: {report.lost_corrections}", markup=False)
    if report.was_complete and not report.lost:
        out.print(f"'{run}' was sound already; '{output}' is a copy of it", markup=False)
    else:
        out.print(f"'{output}' is a clean run file; '{run}' is unchanged", markup=False)


def import_(
    left: Annotated[str, typer.Option(help="Left pictures: folder, pattern in quotes, array file or video.")],
    right: Annotated[str, typer.Option(help="Right pictures.")],
    output: Output,
    rate_hz: Annotated[float | None, typer.Option(help="Steady frame rate of the pictures.")] = None,
    timestamps: Annotated[
        Path | None, typer.Option(help="File with the time of each pair in seconds, one per line.")
    ] = None,
) -> None:
    """Make a run file of pictures or videos that were taken elsewhere."""
    from thermacq.store.importer import import_pictures

    with _progress("importing") as progress:
        report = import_pictures(
            left,
            right,
            output,
            rate_hz=rate_hz,
            timestamps=timestamps,
            progress=lambda done: progress(done, 0),
        )
    for note in report.notes:
        err.print(f"note: {note}", markup=False)
    out.print(
        f"'{output}': {report.frames} pairs of {report.columns} x {report.rows} pixels, "
        f"{report.bit_depth} bits, {report.frame_rate_hz:g} Hz",
        markup=False,
    )


def _corrections(run: RunFile) -> dict[str, str]:
    """Hash of each camera's stored correction; what a damaged one says is for `verify`."""
    from thermacq.errors import StoreError

    try:
        return {name: correction.sha256 for name, correction in run.corrections().items()}
    except StoreError:
        return {"": "damaged"}


def _facts(run: RunFile) -> dict[str, Any]:
    """What `info` shows, as plain values."""
    header = run.header
    cameras = []
    for name in run.cameras:
        stream = run.camera(name)
        host_ns = run.frames(name).host_ns
        duration_s = float(host_ns[-1] - host_ns[0]) / 1e9 if len(host_ns) else 0.0
        frames = {"frames": run.frame_count(name), "duration_s": duration_s}
        cameras.append({**asdict(stream), **frames, "uncommitted": run.uncommitted_frames(name)})
    probes = [{**asdict(run.probe_stream(name)), "samples": len(run.probe(name))} for name in run.probes]
    return {
        "run": str(run.path),
        "title": header.title,
        "run_id": header.run_id,
        "start_time": header.start_time,
        "end_time": run.end_time,
        "end_reason": run.end_reason,
        "clock": header.clock,
        "simulated": header.simulated,
        "emulated": list(header.emulated),
        "complete": run.complete,
        "size_mb": round(run.path.stat().st_size / 1e6, 3),
        "compression": run.compression,
        "cameras": cameras,
        "probes": probes,
        "events": dict(Counter(event.kind.value for event in run.events())),
        "calibration": run.calibration() is not None,
        "corrections": _corrections(run),
        "versions": header.versions,
        "summary": run.summary(),
    }


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr; a total of 0 means that the end is not known."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task(what, total=None)

        def advance(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total or None)

        yield advance
