"""``thermacq rig``: check a rig file against its devices, show it resolved, export its JSON schema."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermacq.cli.common import EXIT_FINDINGS, AsJson, err, out, print_json

if TYPE_CHECKING:
    from thermacq.hooks import RigFinding
    from thermacq.rig.fit import Load
    from thermacq.rig.inspection import DeviceReport
    from thermacq.rig.machine import Machine
    from thermacq.rig.model import Rig

app = typer.Typer(help="Check a rig file, show it, export its schema.", no_args_is_help=True)

RigFile = Annotated[Path, typer.Argument(metavar="RIG", help="Rig file (TOML).")]
SceneFile = Annotated[
    Path | None, typer.Option("--scene", help="TOML file whose keys replace those of [scene].")
]


@app.command()
def schema() -> None:
    """Print the JSON schema of the rig file."""
    from thermacq.rig import Rig

    print_json(Rig.model_json_schema())


@app.command()
def show(rig_file: RigFile, scene: SceneFile = None) -> None:
    """Print the resolved rig, every default filled in, as JSON."""
    from thermacq.rig import load_rig

    print_json(load_rig(rig_file, scene).model_dump(mode="json"))


@app.command()
def check(
    rig_file: RigFile,
    scene: SceneFile = None,
    defaults: Annotated[
        bool, typer.Option("--defaults", help="Show the settings that the rig file leaves to the device too.")
    ] = False,
    emulate: Annotated[
        bool, typer.Option("--emulate", help="Emulators play the devices that have one.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Open every device, show what it applied, and say what does not fit (then exit with 3)."""
    from thermacq.plugins import plugins
    from thermacq.rig import load_rig
    from thermacq.rig.fit import find_misfits, load_of
    from thermacq.rig.inspection import inspect_devices
    from thermacq.rig.machine import this_machine
    from thermacq.rig.rehearsal import emulated_devices

    rig = load_rig(rig_file, scene)
    with err.status("opening the devices ..."):
        reports = inspect_devices(rig, emulated=emulated_devices(rig, plugins()) if emulate else None)
    machine = this_machine(Path.cwd())
    findings = find_misfits(rig, reports, plugins(), machine)
    load = load_of(rig, reports)
    if as_json:
        print_json(
            {
                "devices": [asdict(report) for report in reports],
                "load": asdict(load),
                "machine": asdict(machine),
                "findings": [asdict(finding) for finding in findings],
            }
        )
    else:
        for report in reports:
            _show_device(report, defaults)
        _show_load(rig, load, machine)
        _show_findings(findings)
    if any(finding.severity == "error" for finding in findings):
        raise typer.Exit(EXIT_FINDINGS)


def _show_device(report: DeviceReport, with_defaults: bool) -> None:
    from rich.markup import escape

    from thermacq.rig.inspection import flat

    found = report.identity
    who = f"{found.model}, serial {found.serial}" if found else "not opened"
    proven = f", proven on: {report.evidence}" if report.evidence else ""
    emulated = "[bold yellow]EMULATED[/]  " if report.emulated else ""
    out.print(f"[bold]{escape(report.name)}[/]  {emulated}{escape(who)} ({report.driver}{proven})")
    requested, applied = flat(report.requested), flat(report.applied)
    for key, asked in requested.items():
        in_force = f"{applied[key]!r}" if key in applied else "not applied"
        note = "" if applied.get(key) == asked else f"  (asked for {asked!r})"
        out.print(f"  {escape(f'{key} = {in_force}{note}')}")
    defaults = [f"{key} = {value!r}" for key, value in applied.items() if key not in requested]
    if defaults and not with_defaults:
        out.print(f"  [dim]{len(defaults)} settings by default; --defaults shows them[/]")
    for setting in defaults if with_defaults else ():
        out.print(f"  [dim]{escape(setting)}[/]")
    if report.capabilities:
        facts = ", ".join(f"{key} {_plain(value)}" for key, value in asdict(report.capabilities).items())
        out.print(f"  [dim]can: {escape(facts)}[/]")


def _plain(value: Any) -> str:
    return "/".join(sorted(map(str, value))) if isinstance(value, frozenset | tuple) else f"{value}"


def _show_load(rig: Rig, load: Load, machine: Machine) -> None:
    usable_bytes = max(0.0, machine.disk_bytes - rig.store.reserve_mb * 1e6)
    lasts = f"{usable_bytes / load.bytes_per_s / 60:.1f} min" if load.bytes_per_s else "-"
    out.print(
        f"pictures: {load.bytes_per_s / 1e6:.1f} MB/s before compression; rings: {load.ring_bytes / 1e6:.0f} MB; "
        f"this disk holds {lasts} uncompressed"
    )


def _show_findings(findings: list[RigFinding]) -> None:
    from rich.markup import escape

    for finding in findings:
        colour = "red" if finding.severity == "error" else "yellow"
        out.print(f"[bold {colour}]{escape(finding.severity)}:[/] {escape(finding.message)}")
    if not findings:
        out.print("everything fits")
