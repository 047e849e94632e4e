"""``thermacq simulate``: ready rigs and scenes of the simulated flume, runs of it, and the truth about them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup


class SceneFirst(TyperGroup):
    """Lets ``simulate SCENE.toml ...`` stand for ``simulate run SCENE.toml ...``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take a scene file in the place of a command for a run of it."""
        return super().parse_args(ctx, ["run", *args] if args and args[0].endswith(".toml") else args)


app = typer.Typer(
    cls=SceneFirst,
    help="The simulated flume: rigs, scenes, runs (`simulate SCENE.toml -o RUN`), and the truth about them.",
    no_args_is_help=True,
)


@app.command()
def rig(
    name: Annotated[str, typer.Argument(help="paper, two-pairs or mis-synchronised.")] = "paper",
) -> None:
    """Print a rig file: simulated cameras, a wave probe, virtual time."""
    from thermacq_drivers.simflume.ready_made import rig_toml

    sys.stdout.write(rig_toml(name))


@app.command()
def scene(
    name: Annotated[str, typer.Argument(help="A name that `simulate list` shows.")],
) -> None:
    """Print a scene file for `--scene`."""
    from thermacq_drivers.simflume.ready_made import scene_toml

    sys.stdout.write(scene_toml(name))


@app.command("list")
def list_scenes(
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable output.")] = False,
) -> None:
    """List the scenes, and the waves of Table II as theory has them."""
    import json

    from rich.console import Console
    from rich.table import Table

    from thermacq_drivers.simflume.cases import FLUME_DEPTH_M, TABLE_II
    from thermacq_drivers.simflume.ready_made import scene_summaries
    from thermacq_drivers.simflume.regular_wave import solve_wave

    waves = {case: solve_wave(case.period_s, case.steepness, FLUME_DEPTH_M) for case in TABLE_II.values()}
    if as_json:
        rows = [
            {
                "name": case.name,
                "period_s": case.period_s,
                "steepness": case.steepness,
                "paper_height_m": case.paper_height_m,
                "height_m": wave.height_m,
                "length_m": wave.length_m,
                "drift_m_s": wave.drift_m_s,
            }
            for case, wave in waves.items()
        ]
        json.dump(rows, sys.stdout, indent=2)
        sys.stdout.write("\n")
        return
    table = Table("scene", "T (s)", "H/λ", "H (cm)", "H in the paper (cm)", "λ (m)", "drift (cm/s)", box=None)
    for case, wave in waves.items():
        table.add_row(
            case.name,
            f"{case.period_s:.3f}",
            f"{case.steepness:.4f}",
            f"{wave.height_m * 100:.2f}",
            f"{case.paper_height_m * 100:.2f}",
            f"{wave.length_m:.3f}",
            f"{wave.drift_m_s * 100:.1f}",
        )
    scenes = Table("scene", "what it shows", box=None)
    for name, summary in scene_summaries().items():
        scenes.add_row(name, summary)
    console = Console(highlight=False, soft_wrap=True)
    console.print(scenes)
    console.print()
    console.print(table)


@app.command()
def run(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="Scene file (.toml), or a name that `simulate list` shows.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="RUN", help="Run file to make.")],
    duration_s: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="Length of the recording, seconds.")
    ] = None,
    frames: Annotated[int | None, typer.Option("--frames", metavar="N", help="Frames per camera.")] = None,
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            help="Rig file (.toml), or a name that `simulate rig` knows. "
            "[default: the one of the scene's name, else paper]",
        ),
    ] = None,
    truth: Annotated[Path | None, typer.Option("--truth", help="Truth file to make too, NetCDF-4.")] = None,
) -> None:
    """Record a scene as `thermacq record` does with a ready rig; without a length until Ctrl-C."""
    from thermacq_drivers.simflume.simulate_run import simulate

    length = [] if duration_s is None else ["--duration", str(duration_s)]
    length += [] if frames is None else ["--frames", str(frames)]
    if status := simulate(scene, rig, output, length, truth):
        raise typer.Exit(status)


@app.command()
def truth(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run file recorded with simulated cameras.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="NetCDF-4 file to make.")],
    spacing_m: Annotated[
        float, typer.Option("--spacing-m", min=0.0005, max=0.1, help="Grid spacing of the elevation.")
    ] = 0.005,
    dense: Annotated[
        list[int] | None,
        typer.Option(
            "--dense", help="Also depth and correspondence of each pixel of this frame; repeatable."
        ),
    ] = None,
    pair: Annotated[
        str | None, typer.Option("--pair", help="Pair of cameras, where the rig has several; else the first.")
    ] = None,
) -> None:
    """Write what the simulation knows about a run: elevation, dense disparity, calibration, clocks."""
    from rich.console import Console

    from thermacq_drivers.simflume.truth_file import write_truth

    facts = write_truth(run, output, spacing_m, dense or [], pair)
    Console(stderr=True, highlight=False, soft_wrap=True).print(
        f"wrote {output}: surface {facts['surface']['kind']}"
    )


@app.command()
def validate(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            file_okay=False,
            help="Folder like `docs` for the validation page and its pictures.",
        ),
    ] = None,
) -> None:
    """Check the simulator against formulas and published values; status 3 when a check does not hold."""
    from rich.console import Console

    from thermacq_drivers.simflume.validation import run_checks, write_page
    from thermacq_drivers.simflume.validation_water import failed

    err = Console(stderr=True, highlight=False, soft_wrap=True)
    checks = run_checks(tell=lambda topic: err.print(f"checking {topic}"))
    every = [check for some in checks.values() for check in some]
    out = Console(highlight=False, soft_wrap=True, markup=False)
    for check in every:
        known = f"{check.found:.5g} {check.unit}, known {check.known:.5g} +- {check.tolerance:.2g}"
        out.print(f"{'holds' if check.holds else 'FAILS'}  {check.name}: {known}")
    for path in write_page(checks, output) if output else []:
        err.print(f"wrote {path}")
    wrong = failed(every)
    out.print(f"{len(every) - len(wrong)} of {len(every)} checks hold")
    if wrong:
        raise typer.Exit(3)
