"""The world frame of a run: its mean surface, the plane through it, the rig's ``[world]`` table."""

from __future__ import annotations

import contextlib
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.matching import MatchingJob, PairReader, make_matcher
from thermacq.reconstruction.mean_surface import DisparityMean, points_of, single_frame_sigma_m
from thermacq.reconstruction.outliers import reject_outliers
from thermacq.reconstruction.parts import PartMaker, PartsJob, Progress, make_parts, read_parts
from thermacq.reconstruction.plane import fit_plane
from thermacq.reconstruction.source import Source
from thermacq.reconstruction.triangulation import depth_per_pixel
from thermacq.reconstruction.world import WorldFrame, world_frame
from thermacq_calibration import StereoCalibration

MOST_PAIRS = 400
"""The mean surface is taken from at most this many pairs, spread evenly over the run."""
_INLIER_PX = 0.5
_FLAT_SHARE = 0.005


def find_world_frame(
    source: Source, parts_folder: Path, *, how: str, workers: int, progress: Progress
) -> WorldFrame:
    """World frame on the mean surface of a run.

    Parameters
    ----------
    source
        The run.
    parts_folder
        Folder for intermediate files; its part of them is removed at the end.
    how
        What the surface is, for the record: ``still water`` or ``mean surface``.
    workers, progress
        As in `make_parts`.

    Raises
    ------
    ReconstructionError
        Too little was matched, or the mean surface is no plane.
    """
    count = len(source.pairs)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_PAIRS)).round().astype(np.intp))
    pairs = source.pairs.select(chosen)
    key = source.key(pairs, stage="mean surface")
    job = PartsJob("mean surface", len(pairs), parts_folder / key, partial(_mean_of_part, source.job(pairs)))
    make_parts(job, workers, progress)
    rows, columns = source.calibration.image_size[::-1]
    mean = DisparityMean.empty((rows, columns))
    for part in read_parts(job):
        mean = mean.merge(DisparityMean(part["count"], part["mean_px"], part["square_px2"]))
    shutil.rmtree(job.folder)
    with contextlib.suppress(OSError):
        parts_folder.rmdir()  # only when no parts of other work are in it
    return _frame_on(mean, source, len(pairs), how)


def check_flat(frame: WorldFrame, largest_sigma_m: float | None = None) -> None:
    """Refuse a surface that is not still.

    Parameters
    ----------
    frame
        World frame from `find_world_frame`.
    largest_sigma_m
        Largest standard deviation of single frames from the plane; None: 0.5 % of the camera's height
        (3 mm at 0.6 m, three times the worse of the paper's figures).

    Raises
    ------
    ReconstructionError
        It is larger.
    """
    limit = _FLAT_SHARE * frame.camera_height_m if largest_sigma_m is None else largest_sigma_m
    if frame.sigma_m > limit:
        raise ReconstructionError(
            f"this is not still water: the surface of single frames deviates by {1000 * frame.sigma_m:.2f} mm "
            f"(standard deviation) from a plane, more than {1000 * limit:.2f} mm",
            remedy="Record still water; if the water was still, look at the calibration and at a frame with "
            "`thermacq disparity`, or allow more with --max-sigma-mm.",
        )


def _mean_of_part(job: MatchingJob) -> PartMaker:
    reader = PairReader(
        job.run_path, StereoCalibration.from_dict(job.calibration), job.pairs, job.corrections
    )
    matcher = make_matcher(job.matcher, job.settings)

    def make(members: range) -> dict[str, NDArray[Any]]:
        mean: DisparityMean | None = None
        for index in members:
            disparity = reject_outliers(matcher.match(*reader.read(index)))
            mean = (mean or DisparityMean.empty(disparity.shape)).add(disparity)
        return vars(mean).copy()

    return make


def _frame_on(mean: DisparityMean, source: Source, frames: int, how: str) -> WorldFrame:
    rectification = source.rectification
    points = points_of(mean.often_matched(), rectification)
    depths = points[..., 2][np.isfinite(points[..., 2])]
    if depths.size == 0:
        raise ReconstructionError(
            f"matcher '{source.matcher}' found nothing in {frames} pairs of '{source.run_path}'",
            remedy="Look at a pair with `thermacq disparity`; the settings of the matcher may not suit it.",
        )
    threshold_m = _INLIER_PX * depth_per_pixel(
        float(np.median(depths)), rectification.focal_px, rectification.baseline_m
    )
    plane = fit_plane(points, threshold_m)
    return world_frame(
        plane,
        source.rig.world,
        rotation_left=rectification.rotation_left,
        points=points,
        sigma_m=single_frame_sigma_m(mean, plane, rectification),
        frames=frames,
        source={"from": how, **source.provenance()},
    )
