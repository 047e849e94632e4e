"""``thermacq record``, ``status`` and ``stop``: clients of the recorder process."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermacq.cli.common import EXIT_FAILED, EXIT_INTERRUPTED, AsJson, err, out, print_json, show_error, warn
from thermacq.errors import AcquisitionError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from thermacq.acquisition import RecordingResult, Session


def record(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="Rig file (TOML).")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="RUN", help="Run file to make.")],
    duration_s: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="Length of the recording, seconds.")
    ] = None,
    frames: Annotated[int | None, typer.Option("--frames", metavar="N", help="Frames per camera.")] = None,
    scene: Annotated[
        Path | None, typer.Option("--scene", help="TOML file whose keys replace those of [scene].")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Stereo calibration to store with the run.")
    ] = None,
    emulate: Annotated[
        bool, typer.Option("--emulate", help="A rehearsal: emulators play the devices that have one.")
    ] = False,
    detach: Annotated[
        bool, typer.Option("--detach", help="Return once it records; see `status` and `stop`.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Record a run. Ctrl-C ends it cleanly and keeps everything; without a length it goes on until then."""
    from thermacq.acquisition import start

    session = start(
        rig,
        output,
        duration_s=duration_s,
        frames=frames,
        scene=scene,
        calibration=calibration,
        emulate=emulate,
    )
    if detach:
        _detach(session, output, as_json)
        return
    interrupted = False
    try:
        _show_progress(session)
        result = session.result()
    except KeyboardInterrupt:
        interrupted = True
        result = _end(session)
    _tell_result(result, as_json)
    if interrupted:
        raise typer.Exit(EXIT_INTERRUPTED)


def status(
    follow: Annotated[bool, typer.Option("--follow", help="Show the recording until it ends.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show the recordings that run now."""
    from thermacq.acquisition import running

    sessions = running()
    if follow:
        for session in sessions:
            _show_progress(session)
        return
    found = [answer for session in sessions if (answer := session.status()) is not None]
    if as_json:
        print_json({"recordings": found})
        return
    if not found:
        out.print("no recording is running")
    for answer in found:
        out.print(_picture(answer))


def stop(
    run: Annotated[
        Path | None, typer.Argument(metavar="[RUN]", help="Which, if several recordings run.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """End a recording; everything that was recorded is kept. Returns when the run file is closed."""
    from thermacq.acquisition import running

    sessions = [(session, answer) for session in running() if (answer := session.status()) is not None]
    if run is not None:
        sessions = [item for item in sessions if item[1]["path"] == str(run.absolute())]
    if not sessions:
        raise AcquisitionError(f"'{run}' is not being recorded" if run else "no recording is running")
    if len(sessions) > 1:
        paths = ", ".join(answer["path"] for _, answer in sessions)
        raise AcquisitionError("several recordings are running", remedy=f"Say which: {paths}")
    session, answer = sessions[0]
    session.stop()
    session.wait()
    if as_json:
        print_json({"path": answer["path"]})
    else:
        out.print(f"ended: {answer['path']}", markup=False)


def _detach(session: Session, output: Path, as_json: bool) -> None:
    """Wait until the recording runs, or tell why it does not."""
    session.follow(until="recording")
    answer = session.status()
    if answer is None:
        _tell_result(session.result(), as_json)
    elif as_json:
        print_json(answer)
    else:
        out.print(f"recording '{output}'; `thermacq status` shows it, `thermacq stop` ends it", markup=False)


def _end(session: Session) -> RecordingResult:
    """Stop after a Ctrl-C; a second one leaves the recorder to finish alone."""
    err.print("ending the recording; what was recorded is kept ...")
    try:
        session.stop()
        _show_progress(session)
        return session.result()
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        err.print("the recorder goes on saving by itself; `thermacq status` shows it")
        raise typer.Exit(EXIT_INTERRUPTED) from None


def _show_progress(session: Session) -> None:
    from rich.live import Live

    with Live(console=err, refresh_per_second=5, transient=True) as live:
        session.follow(lambda status: live.update(_picture(status)))


def _picture(status: dict[str, Any]) -> RenderableType:
    """One recording as a small table."""
    from rich.console import Group
    from rich.markup import escape
    from rich.table import Table

    length = ""
    if status["duration_s"]:
        length = f" of {status['duration_s']:g} s"
    elif status["frames"]:
        length = f" ({status['frames']} frames)"
    headline = (
        f"{status['state']}  {status['elapsed_s']:.1f} s{length}  {status['clock']} clock  "
        f"{status['disk_free_bytes'] / 1e9:.1f} GB free  {escape(status['path'])}"
    )
    lines: list[RenderableType] = [headline]
    table = Table("device", "state", "received", "written", "lost", "ring", "rate /s", box=None)
    for name, device in status["devices"].items():
        ring = f"{100 * device['ring_fill']:.0f} %" if "ring_fill" in device else ""
        table.add_row(
            name,
            device["state"],
            str(device["received"]),
            str(device.get("written", "")),
            _losses(device["lost"]),
            ring,
            f"{device['rate_hz']:.1f}",
        )
    lines.append(table)
    if status["skew_ns"]:
        lines.append("recent skew  " + _skew(status["skew_ns"]))
    lines += [f"[bold yellow]warning:[/] {escape(text)}" for text in status["warnings"]]
    return Group(*lines)


def _tell_result(result: RecordingResult, as_json: bool) -> None:
    """Say how it went; a recording that ended unasked is a failure, whatever was kept."""
    if as_json:
        print_json(result.to_dict())
    else:
        for line in sync_lines(result.summary["sync"]):
            out.print(line, markup=False)
        out.print(f"recorded: {result.path}", markup=False)
    for warning in result.warnings:
        warn(warning)
    if not result.asked_for:
        frames = ", ".join(
            f"{name} {device['written']}"
            for name, device in result.summary["sync"]["devices"].items()
            if "written" in device
        )
        kept = f"The run file is complete up to there; frames: {frames}."
        show_error(AcquisitionError(f"the recording ended early: {result.message}", kept=kept))
        raise typer.Exit(EXIT_FAILED)


def sync_lines(report: dict[str, Any]) -> list[str]:
    """The sync report in words, one line for each fact."""
    from thermacq.timing import line_rows

    lines = [f"trigger      {report['trigger_mode']}, {report['clock']} clock"]
    if report["note"]:
        lines.append(f"             {report['note']}")
    if "pairs" in report:
        unpaired = ", ".join(f"{name} {count}" for name, count in report["unpaired"].items())
        lines.append(f"pairs        {report['pairs']} by {report['paired_by']}; unpaired: {unpaired}")
        if report["skew_ns"]:
            lines.append(f"skew         {_skew(report['skew_ns'])} ({report['skew_source']})")
    if "line" in report:
        lines += [f"{'line':12} {what}: {words}" for what, words in line_rows(report["line"])]
    for name, device in report["devices"].items():
        written = f", written {device['written']}" if "written" in device else ""
        lost = _losses(device["lost"])
        lines.append(f"{name:12} received {device['received']}{written}, lost {lost}")
    lines += [f"away         {_outage(outage)}" for outage in report.get("outages", ())]
    for name, clock in report["clocks"].items():
        if clock:
            lines.append(
                f"clock        {name}: drift {clock['drift_ppm']:+.2f} ppm, "
                f"residual {clock['residual_ns'] / 1000:.3g} us, from {clock['method']}"
            )
    return lines


def _outage(outage: dict[str, Any]) -> str:
    """One time for which a device was away, in words."""
    since = f"{outage['device']}: from {outage['lost_s']:.2f} s"
    if not outage["came_back"]:
        return f"{since}, never back"
    changed = ", ".join(f"{key} = {value}" for key, value in outage["changed"].items())
    settings = f"settings changed: {changed}" if changed else "settings as before"
    return f"{since} for {outage['away_s']:.2f} s, {outage['missed']} missed, {settings}"


def _losses(lost: dict[str, int]) -> str:
    return ", ".join(f"{count} {cause}" for cause, count in lost.items()) or "0"


def _skew(figures: dict[str, float]) -> str:
    return ", ".join(f"{name} {value / 1000:.3g} us" for name, value in figures.items())
