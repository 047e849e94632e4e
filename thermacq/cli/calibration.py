"""``thermacq calibration``: show stereo calibrations, and write one from known geometry."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermacq.cli.common import err, out, print_json, warn

if TYPE_CHECKING:
    from thermacq_calibration import StereoCalibration

app = typer.Typer(help="Show a stereo calibration, or write one from known geometry.", no_args_is_help=True)

AsJson = Annotated[bool, typer.Option("--json", help="Machine-readable output.")]
Output = Annotated[
    Path, typer.Option("--output", "-o", help="Calibration record to write; must not exist yet.")
]


@app.command()
def show(
    calibration: Annotated[Path, typer.Argument(help="Calibration record.")], as_json: AsJson = False
) -> None:
    """Show a calibration, view by view."""
    from thermacq_calibration import load_calibration

    record = load_calibration(calibration)
    if as_json:
        print_json(record.to_dict())
        return
    show_record(record)
    advise(record)


@app.command()
def rectified(
    output: Output,
    size: Annotated[str, typer.Option(help="Columns x rows of the pictures, such as 741x500.")],
    focal_px: Annotated[float, typer.Option(help="Focal length, pixels.")],
    baseline_m: Annotated[float, typer.Option(help="Distance between the optical centres, metres.")],
    doffs_px: Annotated[
        float, typer.Option(help="Column of the right principal point minus that of the left one.")
    ] = 0.0,
    principal_point: Annotated[
        str, typer.Option(help="Left principal point 'u,v', pixels; default: middle of the picture.")
    ] = "",
) -> None:
    """Write the calibration of pictures that are rectified already, from their known geometry."""
    from thermacq_calibration import StereoCalibration

    refuse_existing(output)
    columns, rows = _numbers(size.lower(), "x", "--size", "741x500")
    centre = _numbers(principal_point, ",", "--principal-point", "311.2,254.9") if principal_point else None
    if columns != int(columns) or rows != int(rows):
        raise typer.BadParameter(f"--size {size}: whole numbers of pixels are wanted")
    record = StereoCalibration.from_rectified(
        (int(columns), int(rows)), focal_px, centre, baseline_m, doffs_px
    )
    record.save(output)
    advise(record)
    err.print(f"wrote {output}")


def show_record(calibration: StereoCalibration) -> None:
    """Print a record: its views, then its figures."""
    from rich.markup import escape
    from rich.table import Table

    table = Table("view", "left px", "right px", "rows px", "held out px", "tilt", "distance", "", box=None)
    for view in calibration.views:
        numbers = (view.left_rms_px, view.right_rms_px, view.vertical_rms_px, view.held_out_vertical_rms_px)
        table.add_row(
            escape(view.name),
            *(_number(value, ".3f") for value in numbers),
            _number(view.tilt_deg, ".0f", " deg"),
            _number(view.distance_m, ".3f", " m"),
            "used" if view.used else "not used",
        )
    if calibration.views:
        out.print(table)
    for view in calibration.views:
        if view.reason:
            out.print(f"view {escape(view.name)} not used: {escape(view.reason)}")
    for name, value in _figures(calibration):
        out.print(f"{name:>24}  {escape(value)}")


def _figures(calibration: StereoCalibration) -> list[tuple[str, str]]:
    left, right = calibration.left, calibration.right
    used = sum(view.used for view in calibration.views)
    board = calibration.board
    translation = ", ".join(f"{value:.5f}" for value in calibration.translation_m)
    figures = [
        ("pictures", "{} x {} px".format(*calibration.image_size)),
        ("baseline", f"{calibration.baseline_m:.6g} m"),
        ("translation", f"({translation}) m"),
        ("focal lengths", f"{left.matrix[0, 0]:.2f}, {right.matrix[0, 0]:.2f} px (left, right)"),
        (
            "cameras",
            ", ".join(calibration.serials) + " (left, right)" if calibration.serials else "not known",
        ),
        ("source", calibration.source),
        ("created", calibration.created),
        ("sha256", calibration.sha256),
    ]
    if board is None:
        return figures
    coverage = calibration.coverage or (0.0, 0.0)
    stereo, left_alone, right_alone, rows, held_out = (
        _number(value, ".3f", " px")
        for value in (
            calibration.rms_px,
            left.rms_px,
            right.rms_px,
            calibration.vertical_rms_px,
            calibration.held_out_vertical_rms_px,
        )
    )
    return [
        ("board", f"{board.columns} x {board.rows} inner corners, {board.square_m:g} m squares"),
        ("views used", f"{used} of {len(calibration.views)}"),
        ("RMS", f"{stereo} stereo, {left_alone} left alone, {right_alone} right alone"),
        ("rows after rectification", f"{rows}, {held_out} held out"),
        ("coverage", f"{coverage[0]:.0%} left, {coverage[1]:.0%} right"),
        *figures,
    ]


def advise(calibration: StereoCalibration) -> None:
    """Warn of what looks wrong or weak."""
    from thermacq_calibration import findings

    for sentence in findings(calibration):
        warn(sentence)


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"


def _numbers(text: str, separator: str, option: str, example: str) -> tuple[float, float]:
    try:
        first, second = (float(part) for part in text.split(separator))
    except ValueError:
        raise typer.BadParameter(f"{option} {text}: write it like {example}") from None
    return first, second


def refuse_existing(output: Path) -> None:
    """Stop before the work when its result could not be written."""
    from thermacq.errors import ThermacqError

    if output.exists():
        raise ThermacqError(
            f"'{output}' exists already", kept="It was not touched.", remedy="Choose another name."
        )
    if not output.parent.is_dir():
        raise ThermacqError(f"there is no folder '{output.parent}' to write to")
