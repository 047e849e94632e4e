"""``thermacq calibration``: show, compare and check stereo calibrations, and write one from known geometry."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermacq.cli.calibration_tables import advise, record_values, show_check, show_difference, show_record
from thermacq.cli.common import EXIT_FINDINGS, AsJson, err, print_json, warn
from thermacq.outputs import check_new_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    from thermacq.report.calibration_page import ShownView
    from thermacq_calibration import StereoCalibration

app = typer.Typer(
    help="Show, compare and check stereo calibrations, or write one from known geometry.",
    no_args_is_help=True,
)

Record = Annotated[Path, typer.Argument(help="Calibration record.")]
Output = Annotated[
    Path, typer.Option("--output", "-o", help="Calibration record to write; must not exist yet.")
]


@app.command()
def show(
    calibration: Record,
    world: Annotated[
        Path | None, typer.Option(help="World frame made with it: judge its still-water plane too.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show a calibration: view by view, its figures and uncertainties, and the acceptance table."""
    from thermacq.reconstruction import load_world_frame
    from thermacq_calibration import load_calibration

    record = load_calibration(calibration)
    sigma_m = None if world is None else load_world_frame(world).sigma_m
    if as_json:
        print_json(record_values(record, sigma_m))
        return
    show_record(record, sigma_m)
    advise(record)


@app.command()
def report(
    calibration: Record,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Page to write (.html); must not exist yet.")
    ],
) -> None:
    """Write a page about a calibration: acceptance, corners, residuals, coverage, uncertainty over the picture."""
    from thermacq_calibration import load_calibration

    record = load_calibration(calibration)
    check_new_file(output)
    write_report(record, output, [])


@app.command()
def diff(
    first: Annotated[Path, typer.Argument(metavar="A", help="Calibration record.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Calibration record of the same cameras.")],
    as_json: AsJson = False,
) -> None:
    """Compare two calibrations: parameters, projections over the picture, depth at the working distance."""
    from dataclasses import asdict

    from thermacq_calibration import load_calibration
    from thermacq_calibration.geometry.bundle import Geometry
    from thermacq_calibration.geometry.differences import compare, projection_difference
    from thermacq_calibration.geometry.uncertainty import WORKING_DISTANCE_M

    one, other = load_calibration(first), load_calibration(second)
    changes = compare(one, other)
    distance_m = one.working_distance_m or WORKING_DISTANCE_M
    difference = projection_difference(Geometry.of(one), Geometry.of(other), one.image_size, distance_m)
    if as_json:
        plain = [asdict(change) | {"in_sigmas": change.in_sigmas} for change in changes]
        print_json({"changes": plain, "difference": difference.to_dict()})
    else:
        show_difference(changes, difference)
    if one.serials and other.serials and one.serials != other.serials:
        warn("These are calibrations of different cameras.")


@app.command()
def check(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="[CAL] RUN | [CAL] LEFT RIGHT", help="Calibration, then a run or two pictures."
        ),
    ],
    rectified: Annotated[
        bool, typer.Option("--rectified", help="The two pictures are rectified already: no calibration.")
    ] = False,
    pair: Annotated[
        str | None, typer.Option(help="Run file: pair of the rig, or cameras LEFT,RIGHT; default: the first.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Does a recording still fit its calibration? Status 3 when it does not.

    Texture is matched in rectified pictures: rows of the two must agree. A run alone is checked against the
    calibration stored in it.
    """
    from dataclasses import asdict

    from thermacq.reconstruction.calibration_check import check_pictures, check_run
    from thermacq.reconstruction.views import is_picture, read_picture
    from thermacq_calibration import load_calibration

    pictures = [path for path in files if is_picture(path)]
    others = [path for path in files if not is_picture(path)]
    if rectified and len(pictures) == 2 and not others:
        found = check_pictures(read_picture(pictures[0]), read_picture(pictures[1]), None)
    elif not rectified and len(pictures) == 2 and len(others) == 1:
        calibration = load_calibration(others[0])
        found = check_pictures(read_picture(pictures[0]), read_picture(pictures[1]), calibration)
    elif not rectified and not pictures and len(others) in (1, 2):
        found = check_run(others[-1], others[0] if len(others) == 2 else None, pair)
    else:
        raise typer.BadParameter("give CAL RUN, or CAL LEFT RIGHT, or --rectified LEFT RIGHT")
    if as_json:
        fits = {"fits": found.agreement.fits, "systematic_px": found.agreement.systematic_px}
        print_json(asdict(found) | fits)
    else:
        show_check(found)
    if not found.agreement.fits:
        raise typer.Exit(EXIT_FINDINGS)


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

    check_new_file(output)
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


def _numbers(text: str, separator: str, option: str, example: str) -> tuple[float, float]:
    try:
        first, second = (float(part) for part in text.split(separator))
    except ValueError:
        raise typer.BadParameter(f"{option} {text}: write it like {example}") from None
    return first, second


def write_report(calibration: StereoCalibration, output: Path, shown: Sequence[ShownView]) -> None:
    """Write the page about a calibration and say so."""
    from thermacq.report.calibration_page import write_calibration_page

    write_calibration_page(calibration, output, shown)
    err.print(f"wrote {output}")
