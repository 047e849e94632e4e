"""``thermacq preheat``: whether the cameras are warm enough to measure."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermacq.cli.common import EXIT_FINDINGS, AsJson, err, out, print_json, warn
from thermacq.errors import AcquisitionError

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

    from thermacq.acquisition import Session
    from thermacq.imaging.preheat import PreheatMonitor, PreheatStatus
    from thermacq_calibration.infrared.preheat import Criterion

_LOOK_S = 0.5
_RING_FRAMES = 60
_NAMES = {"fpa": "slope of the focal plane", "drift": "drift of the picture", "time": "time"}
_FAIL, _UNKNOWN = "fail", "not judged"


def preheat(
    source: Annotated[
        Path, typer.Argument(metavar="RIG|RUN", help="Rig file (.toml) to record with, or a recorded run.")
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="RUN", help="Run file to make, with a rig.")
    ] = None,
    minimum_min: Annotated[
        float, typer.Option("--minimum-min", min=0, help="Least time since the recording began, minutes.")
    ] = 30.0,
    override: Annotated[
        str, typer.Option("--override", metavar="REASON", help="Go on after the least time all the same.")
    ] = "",
    counts_per_kelvin: Annotated[
        float | None, typer.Option("--counts-per-kelvin", help="Scale of the counts, for all cameras.")
    ] = None,
    correction: Annotated[
        list[Path] | None,
        typer.Option("--correction", help="Correction file of a camera, for its scale; repeatable."),
    ] = None,
    rate_hz: Annotated[
        float,
        typer.Option(
            "--rate-hz",
            min=0.1,
            max=100,
            help="Frames per second to record; below 2 the shutter may be missed.",
        ),
    ] = 2.0,
    scene: Annotated[
        Path | None, typer.Option("--scene", help="TOML file whose keys replace those of [scene].")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Draw the warm-up to this .png file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Watch cameras warm up, live or recorded: exit status 0 for go, 3 for no-go.

    Go: the temperature of the focal plane rises by at most 50 mK/min, the picture drifts by at most 10 mK/min
    (both with two standard errors), and the least time has passed. A live recording ends with the go, or with
    Ctrl-C.
    """
    from thermacq.imaging.noise_drawing import check_output
    from thermacq.imaging.preheat import PreheatMonitor
    from thermacq_calibration.infrared.preheat import PreheatLimits

    is_live = source.suffix.lower() == ".toml"
    if is_live and output is None:
        raise typer.BadParameter("with a rig, give the run file to make: -o RUN")
    if not is_live and (output is not None or override or scene is not None):
        raise typer.BadParameter(
            "--output, --override and --scene are for a rig; a recorded run is not altered"
        )
    if picture is not None:
        if picture.suffix.lower() != ".png":
            raise typer.BadParameter(f"--picture {picture}: a name that ends with .png is wanted")
        check_output(picture)
    limits = PreheatLimits(minimum_s=60 * minimum_min)
    monitor = PreheatMonitor(output or source, counts_per_kelvin, correction or (), limits)
    if is_live and output is not None:
        status = _Watch(monitor, override).record(source, output, rate_hz, scene)
    else:
        status = monitor.update()
    if status is None:
        warn("no frame came: nothing to judge")
        raise typer.Exit(EXIT_FINDINGS)
    _tell(status, as_json)
    if picture is not None:
        from thermacq.imaging.preheat_drawing import save_warm_up

        save_warm_up(monitor, status, picture)
    if not status.is_go:
        raise typer.Exit(EXIT_FINDINGS)


class _Watch:
    """A recording that ends with the go, with an override once the least time has passed, or with Ctrl-C."""

    def __init__(self, monitor: PreheatMonitor, override: str) -> None:
        self._monitor = monitor
        self._override = override
        self._status: PreheatStatus | None = None
        self._looked_s = 0.0
        self._is_over = False

    def record(self, rig: Path, output: Path, rate_hz: float, scene: Path | None) -> PreheatStatus | None:
        """Record at a low rate without probes, watch, and judge."""
        from rich.live import Live

        from thermacq.acquisition import start
        from thermacq.rig import load_rig

        loaded = load_rig(rig, scene)
        trigger = loaded.trigger.model_copy(update={"frame_rate_hz": rate_hz})
        # Rings of a few frames would hold up virtual time until each commit.
        ring_s = max(loaded.store.ring_s, min(30.0, _RING_FRAMES / rate_hz))
        store = loaded.store.model_copy(update={"ring_s": ring_s})
        rig_now = loaded.model_copy(update={"trigger": trigger, "store": store, "probes": {}})
        session = start(rig_now, output)
        with Live(console=err, refresh_per_second=2, transient=True) as live:

            def look(news: dict[str, Any]) -> None:
                if news["state"] == "recording" and not self._is_over:
                    self._look(session, live)

            try:
                session.follow(look)
            except KeyboardInterrupt:
                err.print("ending; what was recorded is kept ...")
                if not self._is_over:
                    self._end(session)
                session.follow()
        self._check(session)
        if self._status is not None and self._status.is_ready:
            return self._status
        return self._monitor.update()

    def _look(self, session: Session, live: Live) -> None:
        now_s = time.monotonic()
        if now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        self._status = self._monitor.update()
        if self._status is None:
            return
        live.update(_table(self._status))
        waited = all(camera.time.grade != _FAIL for camera in self._status.cameras.values())
        if self._status.is_ready or (self._override and waited):
            self._end(session)

    def _end(self, session: Session) -> None:
        """Log why, and stop."""
        self._is_over = True
        verdict = "nothing to judge yet" if self._status is None else self._status.verdict
        is_ready = self._status is not None and self._status.is_ready
        if self._override and not is_ready:
            from thermacq.imaging.preheat import OVERRIDE

            session.note(f"{OVERRIDE}: {self._override}")
        session.note(f"preheat: {verdict}")
        session.stop()

    def _check(self, session: Session) -> None:
        result = session.result()
        for warning in result.warnings:
            warn(warning)
        if not result.asked_for:
            kept = f"What was recorded is in '{result.path}'."
            raise AcquisitionError(f"the recording ended early: {result.message}", kept=kept)


def _tell(status: PreheatStatus, as_json: bool) -> None:
    if as_json:
        print_json(status.facts())
        return
    out.print(_table(status))
    for name, camera in status.cameras.items():
        for one in camera.criteria:
            if one.grade == _UNKNOWN:
                out.print(f"{name}: {_NAMES[one.name]} cannot be judged: {one.note}", markup=False)
            elif one.grade == _FAIL and one.note:
                out.print(f"{name}: {_NAMES[one.name]}: {one.note}", markup=False)
    for name, fault in status.faults.items():
        out.print(f"{name}: {fault}; no criterion means anything then", markup=False)
    if status.override:
        out.print(f"override: {status.override}", markup=False)
    if status.is_go:
        out.print("[bold green]go[/]" if status.is_ready else "[bold yellow]go, by override[/]")
    else:
        out.print("[bold red]no-go[/]")


def _table(status: PreheatStatus) -> Table:
    """One row per camera and criterion."""
    from rich.table import Table

    left = "" if status.is_ready else f", ready in {_minutes(status.ready_in_s)}"
    table = Table(
        "camera", "criterion", "value", "limit", "excellent", "", "ready in", box=None, title_justify="left"
    )
    table.title = f"preheating, {status.time_s / 60:.1f} min{left}"
    for name, camera in status.cameras.items():
        for one in camera.criteria:
            table.add_row(name, _NAMES[one.name], *_values(one), one.grade.value, _minutes(one.ready_in_s))
        temperature_k = status.temperatures_k[name]
        table.add_row(
            "", "focal plane now", "unknown" if math.isnan(temperature_k) else f"{temperature_k:.3f} K"
        )
    return table


def _values(one: Criterion) -> tuple[str, str, str]:
    if one.name == "time":
        return f"{one.value / 60:.1f} min", f"{one.limit / 60:g} min", ""
    limits = f"{1000 * one.limit:g} mK/min", f"{1000 * one.excellent:g} mK/min"
    if math.isnan(one.value):
        return (one.note if one.grade == _FAIL else "unknown", *limits)
    return (f"{1000 * one.value:.1f} ± {1000 * one.standard_error:.1f} mK/min", *limits)


def _minutes(time_s: float) -> str:
    if not math.isfinite(time_s):
        return "unknown"
    return f"{time_s / 60:.1f} min" if time_s > 0 else ""
