"""``thermacq doctor``: whether this computer is fit to record, and what to mend."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from thermacq.cli.common import EXIT_FINDINGS, AsJson, out, print_json

_COLOURS = {"ok": "green", "warning": "yellow", "problem": "red"}


def doctor(
    folder: Annotated[
        Path, typer.Option(help="Where runs will be written; a test file is written and removed.")
    ] = Path(),
    rig: Annotated[
        Path | None, typer.Option(help="Rig file: its cameras say how fast the disk must be.")
    ] = None,
    udev_rules: Annotated[
        bool,
        typer.Option("--udev-rules", help="Print the udev rules for all known devices, and do nothing else."),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Look at libraries, permissions, USB, network, clock, disk and priority; exit with 3 if one is a problem."""
    from thermacq import doctor as examination
    from thermacq.plugins import plugins

    drivers = list(plugins().drivers().values())
    if udev_rules:
        out.print(examination.udev_rules(drivers), markup=False, end="")
        return
    needed = examination.PAPER_BYTES_PER_S if rig is None else _needed(rig)
    failures = {status.name: status.error for status in plugins().statuses if status.error}
    checks = [*examination.plugin_failures(failures), *examination.examine(drivers, folder, needed)]
    if as_json:
        print_json({"checks": [asdict(check) for check in checks]})
    else:
        for check in checks:
            colour = _COLOURS[check.verdict]
            out.print(f"[{colour}]{check.verdict:8}[/]", end=" ")
            out.print(f"{check.name}: {check.found}", markup=False)
            if check.remedy and check.verdict != "ok":
                out.print(f"         {check.remedy}", markup=False)
    if any(check.verdict == "problem" for check in checks):
        raise typer.Exit(EXIT_FINDINGS)


def _needed(rig_file: Path) -> float:
    """Bytes per second of the rig's cameras, for pictures of 640 x 512 where it does not say otherwise."""
    from thermacq.rig import load_rig

    rig = load_rig(rig_file)
    sizes = [
        int(camera.settings.get("rows", 512)) * int(camera.settings.get("columns", 640))
        for camera in rig.cameras.values()
    ]
    return 2.0 * sum(sizes) * rig.trigger.frame_rate_hz
