"""``thermacq still-water``, ``reconstruct`` and ``disparity``: pairs of frames to the shape of the water."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermacq.cli.common import EXIT_INTERRUPTED, AsJson, err, out, print_json, warn

if TYPE_CHECKING:
    from thermacq.reconstruction import MatchedPair, Source, WorldFrame

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Run file.")]
CalibrationPath = Annotated[
    Path | None,
    typer.Option("--calibration", "-c", help="Calibration record; default: the one stored in the run."),
]
MatcherName = Annotated[str | None, typer.Option("--matcher", help="Matcher; default: the rig's.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Setting of the matcher; repeatable.")
]
FrameRange = Annotated[
    str | None, typer.Option("--frames", metavar="A:B", help="Range of pairs, B not included; default: all.")
]
Workers = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes; default: one for each processor core.")
]
PairName = Annotated[
    str | None,
    typer.Option("--pair", help="Pair of the rig, or cameras LEFT,RIGHT; default: the rig's first pair."),
]
CorrectionFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--correction", help="Correction file of a camera; repeatable. Default: those stored in the run."
    ),
]
NoCorrection = Annotated[
    bool, typer.Option("--no-correction", help="Pictures as the cameras delivered them.")
]


def still_water(
    run: RunPath,
    output: Annotated[Path, typer.Option("--output", "-o", help="World frame to write (JSON).")],
    calibration: CalibrationPath = None,
    matcher: MatcherName = None,
    settings: Settings = None,
    frames: FrameRange = None,
    pair: PairName = None,
    correction: CorrectionFiles = None,
    no_correction: NoCorrection = False,
    workers: Workers = None,
    max_sigma_mm: Annotated[
        float | None,
        typer.Option("--max-sigma-mm", min=0, help="Refuse more; default: 0.5 % of the camera's height."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the still-water plane and the world frame on it."""
    from thermacq.reconstruction import check_flat, check_new_file, find_world_frame, parts_folder_of

    check_new_file(output)
    source = _open(run, calibration, matcher, settings, frames, pair, correction, no_correction)
    folder = parts_folder_of(output)
    with _resumable(folder), _progress() as progress:
        world = find_world_frame(
            source, folder, how="still water", workers=workers or _cores(), progress=progress
        )
    check_flat(world, None if max_sigma_mm is None else max_sigma_mm / 1000.0)
    world.save(output)
    if as_json:
        print_json({**world.to_dict(), "output": str(output)})
        return
    _show_world(world)
    out.print(f"world frame: {output}")


def reconstruct(
    run: RunPath,
    output: Annotated[Path, typer.Option("--output", "-o", help="Elevation product to write (NetCDF).")],
    calibration: CalibrationPath = None,
    world: Annotated[
        Path | None,
        typer.Option("--world", "-w", help="World frame from `thermacq still-water`; default: mean surface."),
    ] = None,
    matcher: MatcherName = None,
    settings: Settings = None,
    frames: FrameRange = None,
    pair: PairName = None,
    correction: CorrectionFiles = None,
    no_correction: NoCorrection = False,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Reconstruct the elevation of every pair of a run.

    When it is interrupted, the same command goes on where it stopped.
    """
    from thermacq import reconstruction

    reconstruction.check_new_file(output)
    frame = None if world is None else reconstruction.load_world_frame(world)
    source = _open(run, calibration, matcher, settings, frames, pair, correction, no_correction)
    folder = reconstruction.parts_folder_of(output)
    with _resumable(folder), _progress() as progress:
        result = reconstruction.reconstruct(
            source, output, world=frame, workers=workers or _cores(), progress=progress
        )
    if as_json:
        print_json(
            {
                "output": str(output),
                "pairs": result.pairs,
                "cells": result.cells,
                "supported_share": result.supported_share,
                "world_frame": result.world.to_dict(),
            }
        )
        return
    if frame is None:
        out.print(
            f"no world frame was given: z = 0 is the mean surface of {result.world.frames} pairs of this run"
        )
        _show_world(result.world)
    rows, columns = result.cells
    out.print(
        f"{result.pairs} pairs on {columns} x {rows} cells, {100 * result.supported_share:.1f} % supported"
        + (f"; {source.pairs.left_out} pairs left out (incomplete)" if source.pairs.left_out else "")
    )
    out.print(f"product: {output}")


def disparity(
    run: RunPath,
    calibration: CalibrationPath = None,
    frame: Annotated[int, typer.Option("--frame", min=0, help="Number of the pair.")] = 0,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Disparity to write (NPZ, array `disparity`).")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Known disparity (NPZ or NPY), to compare with.")
    ] = None,
    cloud: Annotated[
        Path | None, typer.Option("--cloud", help="Point cloud of the left camera to write (PLY).")
    ] = None,
    matcher: MatcherName = None,
    settings: Settings = None,
    pair: PairName = None,
    correction: CorrectionFiles = None,
    no_correction: NoCorrection = False,
    as_json: AsJson = False,
) -> None:
    """Match one pair: density, errors against a known disparity, depth, point cloud."""
    from thermacq import reconstruction

    for path in (output, cloud):
        if path is not None:
            reconstruction.check_new_file(path)
    known = None if truth is None else reconstruction.load_disparity(truth)
    source = _open(
        run, calibration, matcher, settings, f"{frame}:{frame + 1}", pair, correction, no_correction
    )
    matched = reconstruction.match_pair(source)
    values = _describe(matched, source)
    if known is not None:
        values["errors"] = asdict(reconstruction.disparity_errors(matched.disparity, known))
        values["depth_errors"] = asdict(
            reconstruction.depth_errors(matched.disparity, known, source.rectification)
        )
    if output is not None:
        reconstruction.save_disparity(output, matched.disparity)
    if cloud is not None:
        values["cloud_points"] = reconstruction.write_cloud(matched, cloud)
    if as_json:
        print_json(values)
    else:
        _show_match(values)


def _open(
    run: Path,
    calibration: Path | None,
    matcher: str | None,
    settings: list[str] | None,
    frames: str | None,
    pair: str | None,
    correction: list[Path] | None,
    no_correction: bool,
) -> Source:
    from thermacq.reconstruction import open_source, parse_settings

    if correction and no_correction:
        raise typer.BadParameter("--correction and --no-correction contradict each other")

    source = open_source(
        run,
        calibration=calibration,
        frames=frames,
        matcher=matcher,
        settings=parse_settings(settings or []),
        pair=pair,
        correction_files=correction or [],
        correct=not no_correction,
    )
    for doubt in source.doubts:
        warn(doubt)
    return source


def _cores() -> int:
    return len(os.sched_getaffinity(0))


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on stderr, one line for each stage."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("pairs"))
    with Progress(*columns, TimeRemainingColumn(), console=err) as bar:
        tasks: dict[str, Any] = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done)

        yield show


@contextmanager
def _resumable(folder: Path) -> Iterator[None]:
    """Say after Ctrl-C that what was done is kept."""
    try:
        yield
    except KeyboardInterrupt:
        kept = len(list(folder.glob("*/part-*.npz")))
        err.print(
            f"interrupted; {kept} finished parts are kept in '{folder}'. Run the same command again to go on."
        )
        raise typer.Exit(EXIT_INTERRUPTED) from None


def _show_world(world: WorldFrame) -> None:
    height, slope_x, slope_y = (float(value) ** 0.5 for value in world.covariance.diagonal())
    out.print(
        f"still-water plane: standard deviation {1000 * world.sigma_m:.3f} mm in single frames, "
        f"{1000 * world.sigma_mean_m:.3f} mm of the mean of {world.frames}"
    )
    out.print(
        f"left camera {world.camera_height_m:.4f} m above the water (± {1000 * height:.3f} mm), tilted "
        f"{world.tilt_deg:.2f}° from the vertical; slopes ± {1000 * slope_x:.3f}, ± {1000 * slope_y:.3f} mm/m"
    )


def _describe(pair: MatchedPair, source: Source) -> dict[str, Any]:
    """Figures of one match, as plain values."""
    import numpy as np

    valid = source.rectification.valid[0]
    low, middle, high = (float(value) for value in np.nanpercentile(pair.disparity, (1.0, 50.0, 99.0)))
    depth = pair.points[..., 2]
    near, median, far = (float(value) for value in np.nanpercentile(depth, (1.0, 50.0, 99.0)))
    return {
        "matcher": source.matcher,
        "settings": source.settings,
        "density": float(np.isfinite(pair.disparity)[valid].mean()),
        "disparity_px": {"p1": low, "median": middle, "p99": high},
        "depth_m": {"p1": near, "median": median, "p99": far},
    }


def _show_match(values: dict[str, Any]) -> None:
    disparity, depth = values["disparity_px"], values["depth_m"]
    out.print(f"matcher {values['matcher']}: density {100 * values['density']:.1f} % of the left picture")
    out.print(
        f"disparity {disparity['p1']:.2f} .. {disparity['median']:.2f} .. {disparity['p99']:.2f} px, "
        f"depth {depth['p1']:.4f} .. {depth['median']:.4f} .. {depth['p99']:.4f} m (1 %, median, 99 %)"
    )
    if "errors" in values:
        errors, depths = values["errors"], values["depth_errors"]
        out.print(
            f"against the truth: density {100 * errors['density']:.1f} %, bad1 {100 * errors['bad1']:.1f} %, "
            f"bad2 {100 * errors['bad2']:.1f} % ({100 * errors['bad2_all']:.1f} % with holes), "
            f"EPE {errors['epe_px']:.2f} px, bias {errors['bias_px']:+.3f} px"
        )
        out.print(
            f"depth: median error {1000 * depths['median_m']:.2f} mm ({100 * depths['median_relative']:.2f} %), "
            f"{100 * depths['within_1_percent']:.1f} % of the points within 1 %"
        )
    if "cloud_points" in values:
        out.print(f"point cloud of {values['cloud_points']} points")
