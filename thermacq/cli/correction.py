"""``thermacq correction``: make, update, show and check the infrared corrections of cameras."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermacq.cli.common import EXIT_FINDINGS, UNIFORM_VIEW, AsJson, out, print_json, warn

if TYPE_CHECKING:
    from thermacq.imaging.making import Made
    from thermacq_calibration import CameraCorrection, Uniformity

app = typer.Typer(
    help="Infrared correction of cameras: non-uniformity, bad pixels, shading.", no_args_is_help=True
)

CorrectionFile = Annotated[Path, typer.Argument(metavar="FILE", help="Correction file.")]


@app.command()
def make(
    cold: Annotated[
        str,
        typer.Option(
            metavar=UNIFORM_VIEW, help="Run of a uniform view; the colder one, or the only one (one-point)."
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Beginning of the files' names: NAME-CAMERA.correction.h5.")
    ],
    hot: Annotated[
        str | None, typer.Option(metavar=UNIFORM_VIEW, help="Run of the warmer uniform view (two-point).")
    ] = None,
    check: Annotated[
        str | None,
        typer.Option(
            metavar=UNIFORM_VIEW, help="Run of a third temperature: judges the result, finds outliers."
        ),
    ] = None,
    uniform: Annotated[
        str | None, typer.Option(metavar=UNIFORM_VIEW, help="Run of a uniform view to find shading from.")
    ] = None,
    shutter: Annotated[
        str | None,
        typer.Option(
            metavar=UNIFORM_VIEW, help="Run of the cameras' internal shutters at the time of the views."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make the corrections of all cameras of a run from uniform views.

    A simulated run knows the temperature of its blackbody; for others write RUN@293.15.
    """
    from thermacq.imaging.making import make_corrections, save_together
    from thermacq.imaging.references import parse_reference

    given = {"hot": hot, "check": check, "uniform": uniform, "shutter": shutter}
    others = {what: parse_reference(text) for what, text in given.items() if text is not None}
    made = make_corrections(parse_reference(cold), **others)
    paths = {camera: output.with_name(f"{output.name}-{camera}.correction.h5") for camera in made}
    save_together({paths[camera]: one.correction for camera, one in made.items()})
    if as_json:
        print_json(
            {
                camera: {"file": str(paths[camera]), **_facts(one.correction), "check": _check(one)}
                for camera, one in made.items()
            }
        )
        return
    for camera, one in made.items():
        _print_correction(one.correction)
        if one.checked is not None:
            _print_uniformity(one.checked)
        out.print(f"  written: {paths[camera]}", markup=False)


@app.command()
def update(
    file: CorrectionFile,
    shutter: Annotated[
        str, typer.Option(metavar=UNIFORM_VIEW, help="Run of a later uniform view or shutter.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Correction file to write.")],
    behind_lens: Annotated[
        bool,
        typer.Option(
            "--behind-lens", help="The shutter is one between lens and sensor, not a cap before it."
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Bring the offsets of a correction up to date by a later uniform view; gains stay."""
    from thermacq.imaging.making import save_together, update_correction
    from thermacq.imaging.references import parse_reference
    from thermacq_calibration import load_correction

    old = load_correction(file)
    new = update_correction(old, parse_reference(shutter), behind_lens=behind_lens)
    save_together({output: new})
    if as_json:
        print_json({"file": str(output), **_facts(new)})
        return
    _print_correction(new)
    out.print(f"  written: {output}", markup=False)


@app.command()
def show(
    file: CorrectionFile,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Draw gain, offset, shading and bad pixels (PNG).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show a correction: whose, how old, what it knows."""
    from thermacq_calibration import load_correction

    correction = load_correction(file)
    if picture is not None:
        from thermacq.imaging.correction_picture import draw_correction
        from thermacq.outputs import check_new_file

        check_new_file(picture)
        draw_correction(correction, picture)
    if as_json:
        print_json({**_facts(correction), "made_from": correction.made_from})
        return
    _print_correction(correction)
    if picture is not None:
        out.print(f"  picture: {picture}", markup=False)


@app.command()
def check(
    file: CorrectionFile,
    runs: Annotated[
        list[str],
        typer.Argument(
            metavar=f"{UNIFORM_VIEW}...",
            help="Run of a uniform view of the same camera. Of several, at different times, the last is judged; "
            "four or more measure how fast the non-uniformity grows.",
        ),
    ],
    planned_s: Annotated[
        float, typer.Option("--planned-s", min=0, help="Length of the recording that is planned, seconds.")
    ] = 600.0,
    as_json: AsJson = False,
) -> None:
    """Judge a correction by later runs of a uniform view; exit status 3 when it no longer serves."""
    from dataclasses import asdict

    from thermacq.imaging.condition import judge_correction
    from thermacq.imaging.references import parse_reference
    from thermacq_calibration import load_correction

    correction = load_correction(file)
    judged = judge_correction(correction, [parse_reference(run) for run in runs], planned_s)
    if as_json:
        print_json({**asdict(judged), "ok": not judged.warnings})
    else:
        _print_correction(correction)
        _print_uniformity(judged.uniformity)
        for line in judged.lines():
            out.print(f"  {line}", markup=False)
        for warning in judged.warnings:
            warn(warning)
        if not judged.warnings:
            out.print("the correction serves")
    if judged.warnings:
        raise typer.Exit(EXIT_FINDINGS)


def _facts(correction: CameraCorrection) -> dict[str, Any]:
    from thermacq_calibration.infrared.correction import bad_pixel_counts

    rows, columns = correction.shape
    return {
        "camera": correction.camera,
        "serial": correction.serial,
        "rows": rows,
        "columns": columns,
        "sha256": correction.sha256,
        "created": correction.created,
        "offset_updated": correction.offset_updated,
        "fpa_temperature_k": correction.fpa_temperature_k,
        "counts_per_kelvin": correction.counts_per_kelvin,
        "kelvin_at_zero": correction.kelvin_at_zero,
        "netd_k": correction.netd_k,
        "gain_sd": float(correction.gain[correction.bad_pixels == 0].std()),
        "offset_sd_counts": float(correction.offset[correction.bad_pixels == 0].std()),
        "shading": correction.shading is not None,
        "bad_pixels": {
            "all": int((correction.bad_pixels > 0).sum()),
            **bad_pixel_counts(correction.bad_pixels),
        },
    }


def _check(made: Made) -> dict[str, float | None] | None:
    return None if made.checked is None else made.checked.as_dict()


def _print_correction(correction: CameraCorrection) -> None:
    facts = _facts(correction)
    points = "one-point (offsets only)" if facts["gain_sd"] == 0 else "two-point"
    age = f"made {correction.created}" + (
        f", offsets of {correction.offset_updated}" if correction.offset_updated else ""
    )
    out.print(
        f"camera {correction.camera} ({correction.serial or 'no serial'}): {points}, "
        f"{correction.shape[1]} x {correction.shape[0]}, {age}",
        markup=False,
    )
    scale = "unknown"
    if correction.counts_per_kelvin is not None and correction.netd_k is not None:
        scale = f"{correction.counts_per_kelvin:.2f} counts/K, NETD {1000 * correction.netd_k:.1f} mK"
    inside = "unknown"
    if correction.fpa_temperature_k is not None:
        inside = f"{correction.fpa_temperature_k:.2f} K"
    out.print(f"  scale: {scale}; focal plane at {inside}; hash {correction.sha256[:12]}", markup=False)
    out.print(
        f"  gain spread {100 * facts['gain_sd']:.2f} %, offset spread "
        f"{facts['offset_sd_counts']:.1f} counts, shading {'known' if facts['shading'] else 'none'}",
        markup=False,
    )
    counts = facts["bad_pixels"]
    listed = ", ".join(f"{count} {reason}" for reason, count in counts.items() if reason != "all")
    out.print(f"  bad pixels: {counts['all']} ({listed})", markup=False)


def _print_uniformity(found: Uniformity) -> None:
    at = "" if found.temperature_k is None else f" at {found.temperature_k:g} K"
    figures = (found.sigma_vh_counts, found.sigma_v_counts, found.sigma_h_counts, found.large_scale_counts)
    pixels, rows, columns, large = (_amount(found, counts) for counts in figures)
    out.print(
        f"  residual non-uniformity{at}: {pixels} ({found.sigma_vh_per_netd:.2f} of the temporal noise), rows "
        f"{rows}, columns {columns}, large-scale {large} peak to peak; in all {found.per_cent:.3f} % of the mean",
        markup=False,
    )


def _amount(found: Uniformity, counts: float) -> str:
    kelvin = found.kelvin(counts)
    return f"{counts:.2f} counts" if kelvin is None else f"{1000 * kelvin:.1f} mK"
