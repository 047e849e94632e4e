"""``thermacq calibrate``, and ``thermacq calibration``: make, show and give stereo calibrations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermacq.cli.common import err, out, print_json, warn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from thermacq.reconstruction.views import PictureView
    from thermacq_calibration import Board, StereoCalibration, View

app = typer.Typer(help="Show a stereo calibration, or write one from known geometry.", no_args_is_help=True)

AsJson = Annotated[bool, typer.Option("--json", help="Machine-readable output.")]
Output = Annotated[
    Path, typer.Option("--output", "-o", help="Calibration record to write; must not exist yet.")
]


def calibrate(
    output: Output,
    sources: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SOURCE...", help="Run file, folder of left/right pictures, or pictures of both cameras."
        ),
    ] = None,
    columns: Annotated[int | None, typer.Option(min=3, help="Inner corners along the board.")] = None,
    rows: Annotated[int | None, typer.Option(min=3, help="Inner corners across the board.")] = None,
    square_m: Annotated[float | None, typer.Option(help="Side of a square, metres.")] = None,
    left: Annotated[str, typer.Option(help="Pattern of the left pictures, in quotes: 'a/l*.png'.")] = "",
    right: Annotated[str, typer.Option(help="Pattern of the right pictures.")] = "",
    frames_per_view: Annotated[
        int | None,
        typer.Option(min=1, help="Run file: pairs per pose; default: whenever the board stands still."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Calibrate two cameras from views of a chessboard.

    For a run file the board defaults to the one in its rig.
    """
    from thermacq.reconstruction.views import open_views, serials_of

    _refuse_existing(output)
    if bool(left) != bool(right) or bool(left) == bool(sources):
        raise typer.BadParameter("give a SOURCE, or both --left and --right")
    if sources:
        with open_views(sources, frames_per_view) as pictures:
            board = _board(sources, columns, rows, square_m)
            calibration = _calibrate(pictures, board, " ".join(map(str, sources)), as_json)
        calibration = replace(calibration, serials=serials_of(sources))
    else:
        board = _board([], columns, rows, square_m)
        calibration = _calibrate(_globbed(left, right), board, f"{left} {right}", as_json)
    calibration.save(output)
    if as_json:
        print_json(calibration.to_dict())
    else:
        _show(calibration)
    _advise(calibration)
    err.print(f"wrote {output}")


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
    _show(record)
    _advise(record)


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

    _refuse_existing(output)
    columns, rows = _numbers(size.lower(), "x", "--size", "741x500")
    centre = _numbers(principal_point, ",", "--principal-point", "311.2,254.9") if principal_point else None
    if columns != int(columns) or rows != int(rows):
        raise typer.BadParameter(f"--size {size}: whole numbers of pixels are wanted")
    record = StereoCalibration.from_rectified(
        (int(columns), int(rows)), focal_px, centre, baseline_m, doffs_px
    )
    record.save(output)
    _advise(record)
    err.print(f"wrote {output}")


def _calibrate(
    pictures: Sequence[PictureView], board: Board, source: str, as_json: bool
) -> StereoCalibration:
    from rich.progress import Progress

    from thermacq.reconstruction.views import detect_views
    from thermacq_calibration import CalibrationError, calibrate_stereo, check_board

    check_board(board)
    with Progress(console=err, transient=True) as progress:
        task = progress.add_task("looking for boards", total=len(pictures))
        views, image_size = detect_views(pictures, board, lambda: progress.advance(task))
        try:
            _require_pairs(pictures, views, board)
            return calibrate_stereo(
                views,
                board,
                image_size,
                source,
                lambda what: progress.update(task, description=what, total=None),
            )
        except CalibrationError as error:
            progress.stop()
            _show_detections(views, as_json)
            raise CalibrationError(error.what, kept="No file was written.", remedy=error.remedy) from None


def _require_pairs(pictures: Sequence[PictureView], views: Sequence[View], board: Board) -> None:
    """Explain the hopeless cases better than a mere count of usable views would."""
    from thermacq_calibration import CalibrationError, Detection

    found = sum(isinstance(side, Detection) for view in views for side in (view.left, view.right))
    looked_at = sum(side is not None for picture in pictures for side in (picture.left, picture.right))
    nothing = (
        ""
        if found
        else f"no plain chessboard of {board.columns} x {board.rows} inner corners was found in any of the "
        f"{looked_at} pictures"
    )
    if not any(picture.left and picture.right for picture in pictures):
        alone = "no picture has a partner from the other camera, and a stereo calibration needs pairs"
        raise CalibrationError(
            f"{nothing}; moreover, {alone}" if nothing else alone,
            remedy="Name the pictures of one view alike apart from left/right, or give --left and --right.",
        )
    if nothing:
        raise CalibrationError(nothing, remedy=_miscount(pictures, board))


def _miscount(pictures: Sequence[PictureView], board: Board) -> str:
    """Say with which corner counts boards are found in the first pictures, if with any."""
    from thermacq.errors import ImportDataError
    from thermacq_calibration.targets import similar_boards

    for load in [picture.left for picture in pictures if picture.left][:3]:
        try:
            sizes = similar_boards(load(), board)
        except ImportDataError:
            continue
        if sizes:
            columns, rows = sizes[0]
            return f"A board of {columns} x {rows} inner corners is there: count corners, not squares."
    return "Check --columns and --rows (inner corners, not squares), focus, and the contrast of the board."


def _board(sources: Sequence[Path], columns: int | None, rows: int | None, square_m: float | None) -> Board:
    """The board of the command line, completed from the rig of a run file."""
    from thermacq.reconstruction.views import is_run
    from thermacq.store import open_run
    from thermacq_calibration import Board

    if columns is not None and rows is not None and square_m is not None:
        return Board(columns, rows, square_m)
    if is_run(sources):
        with open_run(sources[0]) as run:
            known = run.rig.board
        return Board(columns or known.columns, rows or known.rows, square_m or known.square_m)
    raise typer.BadParameter(
        "pictures do not say which board they show: give --columns, --rows and --square-m"
    )


def _globbed(left: str, right: str) -> list[PictureView]:
    from thermacq.reconstruction.views import views_from_lists

    return views_from_lists(_matching(left), _matching(right))


def _matching(pattern: str) -> list[Path]:
    path = Path(pattern)
    return list(Path(path.anchor or ".").glob(str(path.relative_to(path.anchor)))) if pattern else []


def _show_detections(views: Sequence[View], as_json: bool) -> None:
    from rich.markup import escape
    from rich.table import Table

    from thermacq_calibration import NoBoard

    def said(side: object) -> str:
        return side.reason if isinstance(side, NoBoard) else "found"

    rows = [{"view": view.name, "left": said(view.left), "right": said(view.right)} for view in views]
    if as_json:
        print_json({"views": rows})
        return
    table = Table("view", "left", "right", box=None)
    for row in rows:
        table.add_row(*map(escape, row.values()))
    out.print(table)


def _show(calibration: StereoCalibration) -> None:
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


def _advise(calibration: StereoCalibration) -> None:
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


def _refuse_existing(output: Path) -> None:
    from thermacq.errors import ThermacqError

    if output.exists():
        raise ThermacqError(
            f"'{output}' exists already", kept="It was not touched.", remedy="Choose another name."
        )
    if not output.parent.is_dir():
        raise ThermacqError(f"there is no folder '{output.parent}' to write to")
