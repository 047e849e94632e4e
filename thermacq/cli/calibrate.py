"""``thermacq calibrate``: make calibrations. ``calibrate SOURCE`` is short for ``calibrate cameras SOURCE``.

``calibrate RIG --record RUN`` is short for ``calibrate live RIG --record RUN``.
"""

from __future__ import annotations

from contextlib import contextmanager, suppress
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from thermacq.cli import calibrate_live, calibrate_probe
from thermacq.cli.calibration import Output, write_report
from thermacq.cli.calibration_tables import advise, record_values, show_record
from thermacq.cli.common import AsJson, err, out, print_json
from thermacq.outputs import check_new_file

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from thermacq.reconstruction.views import PictureView
    from thermacq.report.calibration_page import ShownView
    from thermacq_calibration import Board, StereoCalibration, View

_LOOKED_AT = 5
"""Pictures without a board in which other boards are looked for."""
_MARKERS_OF_CHARUCO = 4


class BoardName(StrEnum):
    """The kinds of boards; spelt here too, so that the command line need not wait for numpy."""

    CHESSBOARD = "chessboard"
    CIRCLES = "circles"
    CHARUCO = "charuco"
    MARKED = "marked"


class CamerasFirst(TyperGroup):
    """Lets ``calibrate SOURCE ...`` stand for ``calibrate cameras SOURCE ...``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Anything that is neither a command of the group nor a call for help goes to ``cameras``."""
        known = not args or args[0] in self.commands or args[0] == "--help"
        command = "live" if "--record" in args else "cameras"
        return super().parse_args(ctx, args if known else [command, *args])


app = typer.Typer(cls=CamerasFirst, no_args_is_help=True)


app.command("live")(calibrate_live.live)
app.command("probe")(calibrate_probe.probe)
app.command("probe-drift")(calibrate_probe.probe_drift)


@app.callback()
def _group() -> None:
    """Make a calibration (`calibrate SOURCE -o CAL.json`: of two cameras)."""


@app.command()
def cameras(
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
    kind: Annotated[
        BoardName | None,
        typer.Option("--board", help="What the board looks like; default: the rig's, else a chessboard."),
    ] = None,
    marker_m: Annotated[float | None, typer.Option(help="Side of the border of its markers, metres.")] = None,
    dictionary: Annotated[
        str | None, typer.Option(help="OpenCV dictionary of its markers, or rows of bits: 011/110/010.")
    ] = None,
    left: Annotated[str, typer.Option(help="Pattern of the left pictures, in quotes: 'a/l*.png'.")] = "",
    right: Annotated[str, typer.Option(help="Pattern of the right pictures.")] = "",
    frames_per_view: Annotated[
        int | None,
        typer.Option(min=1, help="Run file: pairs per pose; default: whenever the board stands still."),
    ] = None,
    pair: Annotated[
        str | None, typer.Option(help="Run file: pair of the rig, or cameras LEFT,RIGHT; default: the first.")
    ] = None,
    correction: Annotated[
        list[Path] | None,
        typer.Option(help="Run file: correction of a camera; repeatable. Default: those stored in the run."),
    ] = None,
    no_correction: Annotated[
        bool, typer.Option("--no-correction", help="Run file: pictures as the cameras delivered them.")
    ] = False,
    bootstrap: Annotated[
        int, typer.Option(min=0, help="How many times views are drawn for the uncertainties; 0: none.")
    ] = 200,
    working_distance_m: Annotated[
        float, typer.Option(min=0.05, max=100, help="From the cameras to the water: where depth is judged.")
    ] = 0.65,
    counts_per_kelvin: Annotated[
        float | None,
        typer.Option(min=1e-9, help="Turns contrast into kelvin; default: the corrections of a run, if any."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Page with pictures of all this to write too (.html).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Calibrate two cameras from views of a chessboard.

    For a run file the board defaults to the one in its rig. Prints every view, the uncertainties and the
    acceptance table.
    """
    check_new_file(output)
    if report is not None:
        check_new_file(report)
    if bool(left) != bool(right) or bool(left) == bool(sources):
        raise typer.BadParameter("give a SOURCE, or both --left and --right")
    if (correction or no_correction) and (not sources or (correction and no_correction)):
        raise typer.BadParameter("--correction or --no-correction, one of them, belongs to a run file")
    judged = {"replicates": bootstrap, "working_distance_m": working_distance_m}
    given = {"columns": columns, "rows": rows, "square_m": square_m, "kind": kind, "marker_m": marker_m}
    board = _board(sources or [], {**given, "dictionary": dictionary})
    source = " ".join(map(str, sources)) if sources else f"{left} {right}"
    use = {"correction_files": correction or [], "correct": not no_correction}
    with _views(sources or [], left, right, frames_per_view, pair, **use) as pictures:
        calibration = _calibrate(pictures, board, source, as_json, **judged)
        shown = [] if report is None else _shown(pictures, calibration)
    calibration = _with_run(calibration, sources or [], pair)
    if counts_per_kelvin is not None:
        calibration = replace(calibration, counts_per_kelvin=counts_per_kelvin)
    calibration.save(output)
    if as_json:
        print_json(record_values(calibration))
    else:
        show_record(calibration)
    advise(calibration)
    err.print(f"wrote {output}")
    if report is not None:
        write_report(calibration, report, shown)


@contextmanager
def _views(
    sources: list[Path], left: str, right: str, frames_per_view: int | None, pair: str | None, **use: Any
) -> Iterator[list[PictureView]]:
    """The views of the command line, as long as the context lasts."""
    from thermacq.reconstruction.views import open_views

    if not sources:
        yield _globbed(left, right)
        return
    with open_views(sources, frames_per_view, pair, **use) as pictures:
        yield pictures


def _calibrate(
    pictures: Sequence[PictureView], board: Board, source: str, as_json: bool, **judged: Any
) -> StereoCalibration:
    from rich.progress import Progress

    from thermacq.reconstruction.views import detect_views
    from thermacq_calibration import CalibrationError, calibrate_stereo, check_board
    from thermacq_calibration.geometry.judgement import refuse_impossible_square

    check_board(board)
    refuse_impossible_square(board)
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
                **judged,
            )
        except CalibrationError as error:
            progress.stop()
            _show_detections(views, as_json)
            hint = "" if _mostly_found(views) else _miscount(pictures, board)
            remedy = f"{hint} {error.remedy}" if hint and hint not in error.remedy else error.remedy
            raise CalibrationError(error.what, kept="No file was written.", remedy=remedy) from None


def _with_run(calibration: StereoCalibration, sources: list[Path], pair: str | None) -> StereoCalibration:
    """What a run file knows about its cameras; pictures do not tell."""
    from thermacq.reconstruction.calibration_check import counts_per_kelvin, temperatures_k
    from thermacq.reconstruction.pairs import camera_serials
    from thermacq.reconstruction.views import is_run
    from thermacq.store import open_run

    if not is_run(sources):
        return calibration
    with open_run(sources[0]) as run:
        return replace(
            calibration,
            source=f"{calibration.source} (simulated)" if run.header.simulated else calibration.source,
            serials=camera_serials(run, pair),
            temperatures_k=temperatures_k(run, pair),
            counts_per_kelvin=counts_per_kelvin(run, pair),
        )


def _shown(pictures: Sequence[PictureView], calibration: StereoCalibration) -> list[ShownView]:
    """Pictures for the report: views that were left out, the worst, and the best ones."""
    from thermacq.errors import ImportDataError
    from thermacq.report.calibration_page import ShownView, views_to_show

    by_name = {view.name: view for view in pictures}
    shown = []
    for name in views_to_show(calibration):
        left, right = by_name[name].left, by_name[name].right
        if left is not None and right is not None:
            with suppress(ImportDataError):
                shown.append(ShownView(name, left(), right()))
    return shown


def _require_pairs(pictures: Sequence[PictureView], views: Sequence[View], board: Board) -> None:
    """Explain the hopeless cases better than a mere count of usable views would."""
    from thermacq_calibration import CalibrationError, Detection

    found = sum(isinstance(side, Detection) for view in views for side in (view.left, view.right))
    looked_at = sum(side is not None for picture in pictures for side in (picture.left, picture.right))
    nothing = "" if found else f"no {_named(board)} was found in any of the {looked_at} pictures"
    if not any(picture.left and picture.right for picture in pictures):
        alone = "no picture has a partner from the other camera, and a stereo calibration needs pairs"
        naming = "Name the pictures of one view alike apart from left/right, or give --left and --right."
        if nothing:
            there = _what_is_there(pictures, board)
            raise CalibrationError(f"{nothing}; moreover, {alone}", remedy=f"{there} {naming}")
        raise CalibrationError(alone, remedy=naming)
    if nothing:
        raise CalibrationError(nothing, remedy=_what_is_there(pictures, board))


def _named(board: Board) -> str:
    from thermacq_calibration import BoardKind

    if board.kind is BoardKind.CIRCLES:
        return f"asymmetric grid of {board.columns} x {board.rows} circles"
    names = {
        BoardKind.CHESSBOARD: "plain chessboard",
        BoardKind.CHARUCO: f"ChArUco board ({board.dictionary})",
        BoardKind.MARKED: f"chessboard with the marker {board.dictionary} in its middle",
    }
    return f"{names[board.kind]} of {board.columns} x {board.rows} inner corners"


def _mostly_found(views: Sequence[View]) -> bool:
    return 2 * sum(not view.problem for view in views) > len(views)


def _miscount(pictures: Sequence[PictureView], board: Board) -> str:
    """Say with which other corner counts a board is found in the first pictures; empty when with none."""
    from thermacq.errors import ImportDataError
    from thermacq_calibration.targets.targets import similar_boards

    for load in [picture.left for picture in pictures if picture.left][:_LOOKED_AT]:
        with suppress(ImportDataError):
            if sizes := similar_boards(load(), board):
                columns, rows = sizes[0]
                return f"A board of {columns} x {rows} inner corners is there: count corners, not squares."
    return ""


def _what_is_there(pictures: Sequence[PictureView], board: Board) -> str:
    """Say which other board the first pictures show, if they show one."""
    from collections import Counter

    from thermacq.errors import ImportDataError
    from thermacq_calibration.targets.targets import other_markers

    if miscount := _miscount(pictures, board):
        return miscount
    markers: Counter[str] = Counter()
    most = 0
    for load in [picture.left for picture in pictures if picture.left][:_LOOKED_AT]:
        with suppress(ImportDataError):
            seen = other_markers(load(), board)
            markers.update(seen)
            most = max(most, len(seen))
    if most >= _MARKERS_OF_CHARUCO:
        return f"There are up to {most} markers in a picture: a ChArUco board wants --board charuco."
    if markers:
        bits = markers.most_common(1)[0][0]
        return (
            "A marker stands in the board, which hides it from plain search: give --board marked, --marker-m (side "
            f"of its black border) and --dictionary {bits}. So its bits stand in the pictures, 1 for light; a board "
            "held turned turns them."
        )
    return (
        "Check --columns and --rows (inner corners, not squares), focus, and the contrast of the board. Boards "
        "with markers or circles want --board; a marker in the middle of a chessboard hides it from plain search."
    )


def _board(sources: Sequence[Path], options: dict[str, Any]) -> Board:
    """The board of the command line, completed from the rig of a run file."""
    from thermacq.reconstruction.views import board_of, is_run
    from thermacq.store import open_run
    from thermacq_calibration import Board, BoardKind

    given = {name: value for name, value in options.items() if value is not None}
    if "kind" in given:
        given["kind"] = BoardKind(given["kind"])
    if is_run(sources):
        with open_run(sources[0]) as run:
            return replace(board_of(run.rig), **given)
    if not {"columns", "rows", "square_m"} <= given.keys():
        raise typer.BadParameter(
            "pictures do not say which board they show: give --columns, --rows and --square-m"
        )
    return Board(**given)


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
