"""``thermacq world`` and ``fuse``: direction of X, several pairs in one world frame, two products to one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermacq.cli.common import AsJson, err, out, print_json, warn

if TYPE_CHECKING:
    from thermacq.reconstruction import WorldFrame
    from thermacq.reconstruction.shared_board import BoardCorners
    from thermacq.reconstruction.world_axes import Direction
    from thermacq_calibration import Board, StereoCalibration

app = typer.Typer(
    help="World frames: measure the direction of X, put a second pair of cameras into the frame of the first.",
    no_args_is_help=True,
)

Output = Annotated[
    Path, typer.Option("--output", "-o", help="World frame to write (JSON); must not exist yet.")
]
FramesPerView = Annotated[
    int | None,
    typer.Option(min=1, help="Pairs per pose of the board; default: whenever it stands still."),
]
Columns = Annotated[
    int | None, typer.Option(min=3, help="Inner corners along the board; default: the rig's.")
]
Rows = Annotated[int | None, typer.Option(min=3, help="Inner corners across the board; default: the rig's.")]


@app.command("x-axis")
def x_axis(
    world: Annotated[Path, typer.Argument(help="World frame from `thermacq still-water`.")],
    output: Output,
    board: Annotated[
        Path | None, typer.Option(help="Run of a board that lies flat, its rows along the flume.")
    ] = None,
    pixels: Annotated[
        str | None, typer.Option(help="Two marks on the water in the left picture: U1,V1,U2,V2.")
    ] = None,
    marks: Annotated[
        str | None, typer.Option(help="Two marks in coordinates of this frame, metres: X1,Y1,X2,Y2.")
    ] = None,
    waves: Annotated[
        Path | None, typer.Option(help="Product of waves along the flume, made with this frame.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", "-c", help="Calibration, for --board and --pixels.")
    ] = None,
    pair: Annotated[str | None, typer.Option(help="Pair of cameras, for --board.")] = None,
    frames_per_view: FramesPerView = None,
    columns: Columns = None,
    rows: Rows = None,
    mark_u_mm: Annotated[
        float, typer.Option(min=0.001, help="Standard uncertainty of a coordinate of a mark.")
    ] = 1.0,
    as_json: AsJson = False,
) -> None:
    """Turn a world frame so that X lies along a board, from one mark to another, or along the waves."""
    from thermacq.reconstruction import check_new_file, load_world_frame
    from thermacq.reconstruction.world_axes import direction_of_marks, on_water, turned_frame

    check_new_file(output)
    if sum(one is not None for one in (board, pixels, marks, waves)) != 1:
        raise typer.BadParameter("give one of --board, --pixels, --marks and --waves")
    frame = load_world_frame(world)
    if board is not None:
        direction = _by_board(
            frame, board, _calibration(frame, calibration), pair, frames_per_view, (columns, rows)
        )
    elif waves is not None:
        direction = _by_waves(frame, waves)
    elif pixels is not None:
        import numpy as np

        numbers = np.array(_numbers(pixels, "--pixels", 4)).reshape(2, 2)
        first, second = on_water(frame, _calibration(frame, calibration), numbers)
        direction = direction_of_marks(first[:2], second[:2], mark_u_mm / 1000)
    else:
        given = _numbers(marks or "", "--marks", 4)
        direction = direction_of_marks(given[:2], given[2:], mark_u_mm / 1000)
    turned = turned_frame(frame, direction)
    turned.save(output)
    _tell_direction(direction, turned, output, as_json)


@app.command("join-by-board")
def join_by_board(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run in which both pairs see one board.")],
    worlds: Annotated[
        list[Path], typer.Option("--world", "-w", help="World frames: of the first pair, then of the second.")
    ],
    calibrations: Annotated[
        list[Path], typer.Option("--calibration", "-c", help="Calibrations in the same order.")
    ],
    pairs: Annotated[list[str], typer.Option("--pair", help="Pairs in the same order.")],
    output: Output,
    frames_per_view: FramesPerView = None,
    columns: Columns = None,
    rows: Rows = None,
    as_json: AsJson = False,
) -> None:
    """Put the second pair into the world frame of the first, from views of a board that both see at once."""
    from thermacq.reconstruction import check_new_file, load_world_frame
    from thermacq.reconstruction.joining import (
        joined_frame,
        motion_between,
        placing_by_board,
        require_calibration,
        scale_uncertainty,
    )
    from thermacq_calibration import load_calibration

    check_new_file(output)
    if not len(worlds) == len(calibrations) == len(pairs) == 2:
        raise typer.BadParameter("give --world, --calibration and --pair twice each: first pair, second pair")
    first, second = (load_world_frame(path) for path in worlds)
    records = [load_calibration(path) for path in calibrations]
    for frame, record, which in zip((first, second), records, ("first", "second"), strict=True):
        require_calibration(frame, record.sha256, which)
    seen = [
        _corners(run, record, pair, frames_per_view, (columns, rows))[0]
        for record, pair in zip(records, pairs, strict=True)
    ]
    motion, left_out = motion_between(
        seen[0], seen[1], (scale_uncertainty(records[0]), scale_uncertainty(records[1]))
    )
    placing, doubts = placing_by_board(first, second, motion)
    joined = joined_frame(first, second, placing)
    joined.save(output)
    if as_json:
        print_json({**joined.to_dict(), "doubts": [*left_out, *doubts], "output": str(output)})
        return
    out.print(
        f"{motion.points} corners in {motion.views} shared views: {1000 * motion.rms_m:.2f} mm RMS apart after the "
        "motion"
    )
    _tell_placing(joined)
    for sentence in (*left_out, *doubts):
        warn(sentence)
    err.print(f"wrote {output}")


@app.command("join-by-water")
def join_by_water(
    first: Annotated[Path, typer.Argument(help="Product of the first pair.")],
    second: Annotated[Path, typer.Argument(help="Product of the second pair, of the same frames.")],
    near: Annotated[
        str,
        typer.Option(
            help="Left camera of the second pair in the first frame, and direction of its X there, as measured by "
            "hand to 6 cm and 6 degrees: X,Y,DEGREES."
        ),
    ],
    output: Output,
    as_json: AsJson = False,
) -> None:
    """Put the second pair into the world frame of the first, from the waves that both see."""
    import numpy as np

    from thermacq.reconstruction import check_new_file, open_product
    from thermacq.reconstruction.fusion import common_times, require_same_recording, world_of
    from thermacq.reconstruction.joining import joined_frame
    from thermacq.reconstruction.water_overlap import placing_by_water

    check_new_file(output)
    x_m, y_m, degrees = _numbers(near, "--near", 3)
    with open_product(first) as one, open_product(second) as other:
        require_same_recording(one, other)
        frames = world_of(one), world_of(other)
        placing = placing_by_water(
            one,
            other,
            common_times(one, other),
            frames[1].translation_m[:2],
            (x_m, y_m, float(np.radians(degrees))),
        )
    joined = joined_frame(*frames, placing)
    joined.save(output)
    if as_json:
        print_json({**joined.to_dict(), "output": str(output)})
        return
    found = placing.source
    out.print(
        f"{found['cells']} common cells over {found['frames']} frames: correlation {found['correlation']:.3f}, "
        f"{1000 * found['residual_sigma_m']:.2f} mm apart (standard deviation)"
    )
    _tell_placing(joined)
    err.print(f"wrote {output}")


def fuse(
    first: Annotated[Path, typer.Argument(help="Product whose world frame is kept.")],
    second: Annotated[Path, typer.Argument(help="Product of another pair, joined to that frame.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Product to write (NetCDF).")],
    as_json: AsJson = False,
) -> None:
    """Fuse two elevation products of one recording, weighted by their uncertainty; tells how far they differ."""
    from dataclasses import asdict

    from thermacq.reconstruction.fusion import fuse as fuse_products

    fused = fuse_products(first, second, output)
    if as_json:
        print_json({**asdict(fused), "product": str(output)})
        return
    rows, columns = fused.cells
    out.print(f"{fused.frames} frames on {columns} x {rows} cells; {fused.left_out} frames without a partner")
    if fused.overlap is not None:
        overlap = fused.overlap
        out.print(
            f"overlap of {overlap.cells} cells: first less second {1000 * overlap.mean_m:+.3f} mm, standard "
            f"deviation {1000 * overlap.sigma_m:.3f} mm (averaged over time {1000 * overlap.steady_sigma_m:.3f} mm; "
            f"their uncertainties say {1000 * overlap.expected_sigma_m:.3f} mm)"
        )
    for sentence in fused.doubts:
        warn(sentence)
    out.print(f"product: {output}")


def _by_board(
    frame: WorldFrame,
    run: Path,
    calibration: StereoCalibration,
    pair: str | None,
    frames_per_view: int | None,
    size: tuple[int | None, int | None],
) -> Direction:
    from thermacq.reconstruction.world_axes import direction_of_board

    corners, board = _corners(run, calibration, pair, frames_per_view, size)
    return direction_of_board(frame, corners, board)


def _by_waves(frame: WorldFrame, path: Path) -> Direction:
    import numpy as np

    from thermacq.errors import ReconstructionError
    from thermacq.reconstruction import open_product
    from thermacq.reconstruction.fusion import world_of
    from thermacq.reconstruction.world_axes import direction_of_waves

    with open_product(path) as product:
        if not np.allclose(world_of(product).rotation, frame.rotation, atol=1e-9):
            raise ReconstructionError(
                f"'{path}' was made with another world frame: its directions are not those of this one",
                remedy="Reconstruct the waves with this world frame first.",
            )
        return direction_of_waves(product)


def _corners(
    run: Path,
    calibration: StereoCalibration,
    pair: str | None,
    frames_per_view: int | None,
    size: tuple[int | None, int | None],
) -> tuple[list[BoardCorners], Board]:
    """Corners of the board in a run, and the board: as its rig describes it, unless its size is given."""
    from thermacq.reconstruction.shared_board import board_corners
    from thermacq.reconstruction.views import board_of
    from thermacq.store import open_run
    from thermacq_calibration import check_board

    with open_run(run) as opened:
        board = board_of(opened.rig)
    board = replace(board, columns=size[0] or board.columns, rows=size[1] or board.rows)
    check_board(board)
    with err.status(f"looking for the board ({pair})" if pair else "looking for the board"):
        return board_corners(run, board, calibration, pair, frames_per_view), board


def _calibration(frame: WorldFrame, path: Path | None) -> StereoCalibration:
    from thermacq.reconstruction.joining import require_calibration
    from thermacq_calibration import load_calibration

    if path is None:
        raise typer.BadParameter("--board and --pixels need the calibration: -c CALIBRATION.json")
    record = load_calibration(path)
    require_calibration(frame, record.sha256, "first")
    return record


def _numbers(text: str, option: str, count: int) -> list[float]:
    import math

    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise typer.BadParameter(f"{option} {text}: write {count} numbers separated by commas")
    return numbers


def _tell_direction(direction: Direction, turned: WorldFrame, output: Path, as_json: bool) -> None:
    import math

    degrees = math.degrees(direction.angle_rad)
    if as_json:
        print_json({**turned.to_dict(), "turned_by_deg": degrees, "output": str(output)})
        return
    out.print(
        f"X turned by {degrees:+.3f}° (from the old X towards the old Y), standard uncertainty "
        f"{math.degrees(direction.u_rad):.3f}°; from {direction.source['from']}"
    )
    err.print(f"wrote {output}")


def _tell_placing(joined: WorldFrame) -> None:
    source = joined.source["joined"]
    x, y, height = joined.translation_m
    out.print(
        f"left camera of the second pair at x = {x:.4f} m (± {1000 * source['x_u_m']:.2f} mm), y = {y:.4f} m "
        f"(± {1000 * source['y_u_m']:.2f} mm), {height:.4f} m above its still water; X known to "
        f"{joined.x_axis_u_deg:.3f}°"
    )
    if "height_difference_m" in source:
        out.print(
            f"the board puts it {1000 * source['height_difference_m']:+.2f} mm higher than its still water "
            f"(± {1000 * source['height_difference_u_m']:.2f} mm), the planes {source['tilt_difference_deg']:.3f}° apart"
        )
