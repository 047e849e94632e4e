"""The main stage: every pair of a run to elevation on a grid, and the product file."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq.outputs import check_new_file
from thermacq.reconstruction.cell_uncertainty import cell_uncertainty_m
from thermacq.reconstruction.gridding import Grid, GriddedSurface, grid_over, grid_points
from thermacq.reconstruction.matching import MatchingJob, PairReader, make_matcher
from thermacq.reconstruction.mean_surface import points_of
from thermacq.reconstruction.outliers import reject_outliers
from thermacq.reconstruction.parts import PartMaker, PartsJob, Progress, make_parts, read_parts
from thermacq.reconstruction.product import ProductWriter
from thermacq.reconstruction.rims import Interior
from thermacq.reconstruction.source import Source
from thermacq.reconstruction.still_water import find_world_frame
from thermacq.reconstruction.triangulation import plane_disparity
from thermacq.reconstruction.world import WorldFrame
from thermacq.rig import ReconstructionTable
from thermacq_calibration import Rectification, StereoCalibration

_HIGHEST_SHARE = 0.5
"""Points higher or lower than this share of the camera's height are no water."""


@dataclass(frozen=True)
class Reconstructed:
    """What a reconstruction came to.

    Parameters
    ----------
    product
        The product file.
    world
        World frame that it stands in.
    pairs
        Number of pairs.
    cells
        (ny, nx) of the grid.
    supported_share
        Supported cells over all cells and frames that the cameras see in common.
    """

    product: Path
    world: WorldFrame
    pairs: int
    cells: tuple[int, int]
    supported_share: float


def reconstruct(
    source: Source,
    output: Path,
    *,
    world: WorldFrame | None,
    workers: int,
    progress: Progress,
) -> Reconstructed:
    """Reconstruct every pair of a run and write the elevation product.

    Parameters
    ----------
    source
        The run, from `open_source`.
    output
        Product to write; must not exist. Parts are kept beside it, in ``OUTPUT.parts``, until it is
        complete: after an interruption the same call goes on where it stopped.
    world
        World frame; None: the plane through the run's own mean surface.
    workers, progress
        As in `make_parts`.

    Raises
    ------
    ReconstructionError
        The world frame belongs to another calibration, or nothing could be reconstructed.
    StoreError
        The output exists or cannot be written.
    """
    check_new_file(output)
    if world is not None and world.source.get("calibration_sha256") != source.calibration.sha256:
        raise ReconstructionError(
            "the world frame was found with another calibration than this run is reconstructed with",
            remedy="Use the calibration of the still-water run, or find the world frame again.",
        )
    parts_folder = parts_folder_of(output)
    if world is None:
        world = find_world_frame(source, parts_folder, how="mean surface", workers=workers, progress=progress)
    table = source.rig.reconstruction
    grid = grid_over(*_common_view(source, world), table.grid_spacing_m)
    key = source.key(
        source.pairs,
        stage="elevation",
        world=world.to_dict(),
        grid=[table.grid_spacing_m, table.min_points_per_cell, table.rim_px],
    )
    job = PartsJob(
        "elevation",
        len(source.pairs),
        parts_folder / key,
        partial(_surfaces_of_part, source.job(source.pairs), world, grid, table),
    )
    make_parts(job, workers, progress)
    supported = _write(job, output, source, world, grid)
    shutil.rmtree(parts_folder, ignore_errors=True)
    return Reconstructed(output, world, len(source.pairs), grid.shape, supported)


def parts_folder_of(output: Path) -> Path:
    """Folder beside a product that keeps its parts until it is complete."""
    return output.with_name(output.name + ".parts")


def surface_of(
    disparity: NDArray[np.float32],
    rectification: Rectification,
    interior: Interior,
    world: WorldFrame,
    grid: Grid,
    min_points: int,
) -> GriddedSurface:
    """One frame: disparity (rows, columns) to a gridded surface, outliers and rims left out."""
    trusted = reject_outliers(interior.keep(disparity))
    points = world.to_world(points_of(trusted, rectification))
    water = np.abs(points[..., 2]) < _HIGHEST_SHARE * world.camera_height_m
    return grid_points(np.where(water[..., None], points, np.nan), grid, min_points)


def _surfaces_of_part(
    job: MatchingJob, world: WorldFrame, grid: Grid, table: ReconstructionTable
) -> PartMaker:
    reader = PairReader(
        job.run_path, StereoCalibration.from_dict(job.calibration), job.pairs, job.corrections
    )
    matcher = make_matcher(job.matcher, job.settings)
    interior = Interior.of(reader.rectification, table.rim_px)

    def surface(index: int) -> GriddedSurface:
        disparity = matcher.match(*reader.read(index))
        return surface_of(disparity, reader.rectification, interior, world, grid, table.min_points_per_cell)

    def make(members: range) -> dict[str, NDArray[Any]]:
        surfaces = [surface(index) for index in members]
        return {
            "eta": np.stack([surface.eta_m for surface in surfaces]),
            "eta_points": np.stack([surface.points for surface in surfaces]),
            "eta_sd": np.stack([surface.sd_m for surface in surfaces]),
        }

    return make


def _common_view(source: Source, world: WorldFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World x and y, metres, of the still water that both cameras see, rims left out."""
    rectification = source.rectification
    disparity = plane_disparity(
        rectification.image_size[::-1],
        world.rotation[2],
        world.camera_height_m,
        focal_px=rectification.focal_px,
        principal_point_px=rectification.principal_point_px,
        baseline_m=rectification.baseline_m,
        doffs_px=rectification.doffs_px,
    )
    common = Interior.of(rectification, source.rig.reconstruction.rim_px).keep(disparity.astype(np.float32))
    lowest = source.settings.get("min_disparity")
    if lowest is not None:
        common[common < lowest] = np.nan
    water = world.to_world(points_of(common, rectification))
    return water[..., 0], water[..., 1]


def _write(job: PartsJob, output: Path, source: Source, world: WorldFrame, grid: Grid) -> float:
    """Put the parts together; returns the share of supported cells among those ever supported."""
    supported = np.zeros(grid.shape, np.int64)
    uncertainty_m = cell_uncertainty_m(world, grid)
    with ProductWriter(
        output, grid, source.pairs.time_s, _attributes(source, world), source.header, uncertainty_m
    ) as product:
        for part in read_parts(job):
            product.append(part["eta"], part["eta_points"], part["eta_sd"])
            supported += np.isfinite(part["eta"]).sum(axis=0)
        if not supported.any():
            raise ReconstructionError(
                f"matcher '{source.matcher}' found no surface in any of {len(source.pairs)} pairs",
                remedy="Look at a pair with `thermacq disparity`; check the world frame and the settings.",
            )
    return float(supported.sum() / (np.count_nonzero(supported) * len(source.pairs)))


def _attributes(source: Source, world: WorldFrame) -> dict[str, Any]:
    rectification = source.rectification
    return {
        **source.provenance(),
        "world_frame": world.to_dict(),
        "world_frame_from": world.source["from"],
        "camera_height_m": world.camera_height_m,
        "still_water_sigma_m": world.sigma_m,
        "focal_px": rectification.focal_px,
        "baseline_m": rectification.baseline_m,
        "pairs_left_out": source.pairs.left_out,
        "min_points_per_cell": source.rig.reconstruction.min_points_per_cell,
        "rim_px": source.rig.reconstruction.rim_px,
    }
