"""``thermacq calibrate RIG --record RUN``: record a board with live guidance, then calibrate from the run."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermacq.cli.calibration import Output
from thermacq.cli.common import AsJson, err, warn
from thermacq.outputs import check_new_file

if TYPE_CHECKING:
    from rich.console import RenderableType

    from thermacq.acquisition import Session
    from thermacq.reconstruction.growing_views import GrowingViews
    from thermacq_calibration import Board, View
    from thermacq_calibration.targets.guidance import Guidance

_POLL_S = 0.2
_BAR_WIDTH = 24
_BARS = {"x": "left - right", "y": "up - down", "size": "near", "skew": "tilted"}


def live(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="Rig file (TOML).")],
    output: Output,
    record: Annotated[
        Path, typer.Option("--record", metavar="RUN", help="Run file to make of what the cameras saw.")
    ],
    scene: Annotated[
        Path | None, typer.Option("--scene", help="TOML file whose keys replace those of [scene].")
    ] = None,
    pair: Annotated[
        str | None, typer.Option(help="Pair of the rig, or cameras LEFT,RIGHT; default: the first.")
    ] = None,
    bootstrap: Annotated[
        int, typer.Option(min=0, help="How many times views are drawn for the uncertainties; 0: none.")
    ] = 200,
    as_json: AsJson = False,
) -> None:
    """Record a board, saying what is covered and which view helps next; then calibrate.

    Ends when the views are enough, or with Ctrl-C. The run file is kept, whatever the calibration says.
    """
    from thermacq.acquisition import start
    from thermacq.cli.calibrate import cameras
    from thermacq.reconstruction.growing_views import GrowingViews
    from thermacq.reconstruction.views import board_of
    from thermacq.rig import load_rig
    from thermacq_calibration import check_board
    from thermacq_calibration.geometry.judgement import refuse_impossible_square

    check_new_file(output)
    resolved = load_rig(rig, scene)
    board = board_of(resolved)
    check_board(board)
    refuse_impossible_square(board)
    growing = GrowingViews(record, board, pair)
    session = start(resolved, record)
    try:
        _guide(session, growing, board)
    except KeyboardInterrupt:
        err.print("ending the recording; what was recorded is kept ...")
    session.stop()
    result = session.result()
    if not result.asked_for:
        warn(f"the recording ended early: {result.message}")
    err.print(f"\nrecorded: {result.path}; calibrating from it ...")
    cameras(output, [record], pair=pair, bootstrap=bootstrap, as_json=as_json)


def _guide(session: Session, growing: GrowingViews, board: Board) -> None:
    """Show the guidance until the views are enough or the recording has ended."""
    from rich.live import Live
    from rich.markup import escape

    from thermacq_calibration.targets.guidance import guidance

    session.follow(until="recording")
    with Live("waiting for the first view ...", console=err, refresh_per_second=4) as shown:
        while session.status() is not None:
            if not growing.look():
                if not growing.views and growing.trouble:
                    shown.update(f"waiting for the first view ... ({escape(growing.trouble)})")
                time.sleep(_POLL_S)
                continue
            judged = guidance(growing.views, growing.image_size, board)
            shown.update(picture(judged, growing.views[-1]))
            if judged.enough:
                return


def picture(judged: Guidance, last: View) -> RenderableType:
    """The guidance as a person at the tank reads it."""
    from rich.console import Group
    from rich.markup import escape
    from rich.table import Table

    bars = Table.grid(padding=(0, 2))
    for name, words in _BARS.items():
        part = judged.bars[name]
        full = round(part * _BAR_WIDTH)
        bars.add_row(f"{words:>14}", "█" * full + "░" * (_BAR_WIDTH - full), f"{part:.0%}")
    cells = Table.grid(padding=(0, 4))
    cells.add_row("left picture", "right picture")
    cells.add_row(
        *(
            "\n".join("".join("■ " if hit else "· " for hit in row) for row in side)
            for side in (judged.left_cells, judged.right_cells)
        )
    )
    counted = f"{judged.counted} views count ({judged.seen} with the board in both pictures), "
    counted += f"{judged.tilted:.0%} of them tilted"
    seen = last.problem or "board found in both pictures"
    if judged.enough:
        advice = "[bold green]enough[/]"
    else:
        advice = f"missing: {'; '.join(judged.missing)}\n[bold]next: {judged.next_view.words}[/]"
    return Group(f"last view ({last.name}): {escape(seen)}", counted, bars, cells, advice)
