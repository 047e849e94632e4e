"""``thermacq demo``: the main job on the simulated flume, as the commands that a user would type.

Nothing here does any work of its own: each step is one ordinary command, shown before it runs, so that
the demo is also the tutorial (`docs/tutorial/first-run.md`).
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from thermacq.cli.common import EXIT_INTERRUPTED, err, out
from thermacq.errors import ThermacqError

_MARKER = ".thermacq-demo"
_VIEWS, _FRAMES_PER_VIEW = 30, 4

# (what it is for, the command); a command that begins with ">" writes what it prints to that file.
_STEPS: list[tuple[str, str]] = [
    ("The rig file: two simulated cameras, a wave probe, a software trigger", "> rig.toml simulate rig"),
    ("What the cameras will see", "> chessboard.toml simulate scene chessboard"),
    ("", "> still.toml simulate scene still"),
    ("", "> wave.toml simulate scene T0.791-H2/25"),
    ("Does the rig fit its devices?", "rig check rig.toml --scene wave.toml"),
    (
        "Record a heated chessboard held in front of the cameras",
        f"record rig.toml --scene chessboard.toml --frames {_VIEWS * _FRAMES_PER_VIEW} -o chessboard.h5",
    ),
    (
        "Calibrate the pair from it",
        "calibrate chessboard.h5 --columns 9 --rows 6 --square-m 0.05 -o calibration.json",
    ),
    (
        "Record still water: it defines the world frame",
        "record rig.toml --scene still.toml --duration 1 --calibration calibration.json -o still.h5",
    ),
    ("Find the still-water plane", "still-water still.h5 -o world.json"),
    (
        "Record waves, H/λ = 2/25, T = 0.791 s, with the wave probe",
        "record rig.toml --scene wave.toml --duration 8 --calibration calibration.json -o wave.h5",
    ),
    ("Nothing lost, nothing damaged?", "verify wave.h5"),
    ("Turn pairs of frames into elevation", "reconstruct still.h5 -w world.json -o still.nc"),
    ("", "reconstruct wave.h5 -w world.json -o wave.nc"),
    ("Write the report", "report wave.nc --run wave.h5 --still still.nc -o report.html"),
    ("Compare with the wave probe, and with the simulated truth", "compare wave.nc wave.h5"),
]


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for everything it makes.")] = Path(
        "demo-output"
    ),
) -> None:
    """Run the main job on the simulated flume: calibrate, record, reconstruct, compare, report."""
    _fresh_folder(output)
    start = time.monotonic()
    for number, (purpose, command) in enumerate(_STEPS, start=1):
        if purpose:
            err.print(f"\n[bold]{purpose}[/]  [dim]({number}/{len(_STEPS)})[/]")
        _run(command, output)
    minutes, seconds = divmod(int(time.monotonic() - start), 60)
    out.print(
        f"\ndone in {minutes} min {seconds} s; everything is simulated. Report: {output / 'report.html'}"
    )


def _run(command: str, folder: Path) -> None:
    """Run one thermacq command in the folder; stop the demo when it fails."""
    words = shlex.split(command)
    target = None
    if words[0] == ">":
        target, words = words[1], words[2:]
    err.print(f"[cyan]$ thermacq {shlex.join(words)}{f' > {target}' if target else ''}[/]")
    arguments = [sys.executable, "-m", "thermacq", *words]
    try:
        if target:
            with (folder / target).open("wb") as file:
                status = subprocess.run(arguments, cwd=folder, stdout=file, check=False).returncode
        else:
            status = subprocess.run(arguments, cwd=folder, check=False).returncode
    except KeyboardInterrupt:
        err.print(f"interrupted; what was made so far is in '{folder}'")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if status != 0:
        raise ThermacqError(
            f"the demo stopped: `thermacq {command.lstrip('> ')}` ended with status {status}",
            kept=f"What was made so far is in '{folder}'.",
            remedy="Its message above says why.",
        )


def _fresh_folder(folder: Path) -> None:
    """Make the folder, or empty the one that an earlier demo made; never touch another."""
    if folder.exists():
        if not (folder / _MARKER).is_file():
            raise ThermacqError(
                f"'{folder}' exists and was not made by the demo", remedy="Choose another --output."
            )
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    (folder / _MARKER).write_text("made by `thermacq demo`, which may empty this folder\n")
