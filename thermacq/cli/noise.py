"""``thermacq noise``: what the pictures of a uniform view say of the cameras' noise."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermacq.cli.common import UNIFORM_VIEW, AsJson, out, print_json, warn

if TYPE_CHECKING:
    from thermacq.imaging.noise_report import NoiseReport


def noise(
    run: Annotated[
        str, typer.Argument(metavar=UNIFORM_VIEW, help="Run of a uniform view, or frames A to B of it.")
    ],
    counts_per_kelvin: Annotated[
        float | None, typer.Option("--counts-per-kelvin", help="Scale of the counts, for all cameras.")
    ] = None,
    sitf: Annotated[
        list[str] | None,
        typer.Option("--sitf", metavar=UNIFORM_VIEW, help="Uniform view for the scale; give three or more."),
    ] = None,
    correction: Annotated[
        list[Path] | None,
        typer.Option(
            "--correction", help="Correction file of a camera; repeatable. Default: those stored in the run."
        ),
    ] = None,
    no_correction: Annotated[
        bool, typer.Option("--no-correction", help="Pictures as the cameras delivered them.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Report to write: .html, or .png.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Noise report: NETD, non-uniformity, 3-D noise with intervals, spectra, bad pixels, warm-up curve."""
    from thermacq.imaging.noise_drawing import check_output, save_report
    from thermacq.imaging.noise_report import noise_report
    from thermacq.imaging.references import parse_reference

    if correction and no_correction:
        raise typer.BadParameter("--correction and --no-correction contradict each other")
    if counts_per_kelvin is not None and sitf:
        raise typer.BadParameter("--counts-per-kelvin and --sitf both give the scale; choose one")
    if output is not None:
        check_output(output)
    report = noise_report(
        parse_reference(run),
        counts_per_kelvin=counts_per_kelvin,
        sitf=[parse_reference(text) for text in sitf or ()],
        correction_files=correction or (),
        correct=not no_correction,
    )
    if output is not None:
        save_report(report, output)
    if as_json:
        print_json(report.facts())
        return
    _show(report)
    if output is not None:
        out.print(f"written: {output}", markup=False)


def _show(report: NoiseReport) -> None:
    from rich.table import Table

    from thermacq.imaging.noise_tables import camera_rows, component_rows

    if report.simulated:
        out.print("simulated run: these figures judge the method and the program, not a camera\n")
    for camera in report.cameras:
        out.print(f"{camera.camera}  {camera.serial}", style="bold", markup=False)
        for name, value in camera_rows(camera):
            out.print(f"  {name:22}{value}", markup=False)
        table = Table("3-D noise", "sigma", f"{camera.noise.confidence:.0%} interval", "of", box=None)
        for row in component_rows(camera):
            table.add_row(*row)
        out.print(table)
        for warning in camera.warnings:
            warn(f"{camera.camera}: {warning}")
