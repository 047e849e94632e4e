"""Gathers what a report shows from a product, its run and a still-water product.

What cannot be had is left out and said in a note, so that one damaged part never costs the whole report.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import StoreError, ThermacqError
from thermacq.evaluation import Flatness, flatness, quantisation_curve
from thermacq.evaluation.probes import probe_label
from thermacq.evaluation.run_comparison import RunComparison, compare_run
from thermacq.imaging import CorrectedPictures
from thermacq.reconstruction import Source, WorldFrame, match_pair, open_product, open_source
from thermacq.report.data import (
    Coverage,
    EventLine,
    Place,
    Quantisation,
    ReportData,
    SampleFrame,
    Surface,
)
from thermacq.report.provenance import json_attribute, json_table, provenance
from thermacq.store import RunFile, open_run
from thermacq.timing import NS_PER_S
from thermacq_calibration import CalibrationError

if TYPE_CHECKING:
    import xarray as xr

_FRAMES_PER_READ = 32
_FRAMES_FOR_MEDIANS = 32
_MOST_EVENTS = 50


@dataclass
class _Parts:
    """What came from the run, and notes on what did not."""

    notes: list[str] = field(default_factory=list)
    compared: RunComparison | None = None
    source: Source | None = None
    sample: SampleFrame | None = None
    sync: dict[str, Any] | None = None
    events: tuple[EventLine, ...] = ()
    event_count: int = 0


def collect(
    product: Path,
    *,
    run: Path | None = None,
    still: Path | None = None,
    calibration: Path | None = None,
    correction_files: Sequence[Path] = (),
    title: str = "",
) -> ReportData:
    """Everything that a report on a product can show.

    Parameters
    ----------
    product
        Elevation product.
    run
        The run that it was made from.
    still
        Product of still water.
    calibration
        Calibration record; None: the one stored with the run.
    correction_files
        Corrections of the pictures; empty: those stored with the run. None are used that the product did not use.
    title
        Heading; empty: the title of the product.

    Raises
    ------
    StoreError
        A file that was named is missing or cannot be read, or the run is not that of the product.
    """
    with open_product(product) as dataset:
        if 0 in dataset.sizes.values():
            raise StoreError(f"'{product}' holds no frames or no cells: there is nothing to report")
        index = int(dataset.sizes["time"]) // 2
        parts = _Parts()
        if run is not None:
            with open_run(run) as opened:
                _from_run(parts, dataset, opened, index, calibration, correction_files)
        still_flatness = _still(still, parts.notes) if still is not None else None
        quantisation = _quantisation(dataset, parts)
        return ReportData(
            title=title or str(dataset.attrs.get("title", product.name)),
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            simulated=bool(json_attribute(dataset, "simulated", default=False)),
            sample=parts.sample,
            surface=_surface(dataset, index),
            coverage=_coverage(dataset),
            comparisons=parts.compared.comparisons if parts.compared else (),
            places=tuple(
                Place(probe_label(probe.name), probe.x_m, probe.y_m)
                for probe in (parts.compared.probes if parts.compared else ())
            ),
            flatness=still_flatness,
            flatness_source=still.name if still else "",
            quantisation=quantisation,
            sync=parts.sync,
            events=parts.events,
            event_count=parts.event_count,
            notes=tuple(parts.notes),
            provenance=provenance(product, dataset, parts.source, parts.compared),
        )


def _from_run(
    parts: _Parts,
    dataset: xr.Dataset,
    run: RunFile,
    index: int,
    calibration: Path | None,
    correction_files: Sequence[Path],
) -> None:
    """Fill in everything that needs the run."""
    if dataset.attrs.get("run_id") != run.header.run_id:
        raise StoreError(
            f"the product was not made from '{run.path}': it names run {dataset.attrs.get('run_id')}",
            remedy="Give the run that the product was reconstructed from.",
        )
    try:
        parts.compared = compare_run(dataset, run)
        parts.notes += parts.compared.notes
    except ThermacqError as error:
        parts.notes.append(f"nothing was compared: {error.what}")
    summary = run.summary()
    if summary is None:
        parts.notes.append("the run was not finished: it has no synchronisation report")
    else:
        parts.sync = summary.get("sync")
    events = run.events()
    parts.event_count = len(events)
    parts.events = tuple(
        EventLine(
            (event.host_ns - run.header.host_anchor_ns) / NS_PER_S,
            event.device,
            str(event.kind),
            event.index,
            event.detail,
        )
        for event in events[:_MOST_EVENTS]
    )
    try:
        parts.source = _source(dataset, run, calibration, correction_files)
        parts.sample = _sample(dataset, run, parts.source, index, parts.notes)
    except (ThermacqError, CalibrationError) as error:
        parts.notes.append(f"frames and disparity are not shown: {error.what}")


def _source(
    dataset: xr.Dataset, run: RunFile, calibration: Path | None, correction_files: Sequence[Path]
) -> Source:
    """The run as the product used it."""
    corrected = json_table(dataset, "correction")
    is_corrected = bool(corrected.get("cameras") or corrected.get("stages"))
    source = open_source(
        run.path,
        calibration=calibration,
        matcher=str(dataset.attrs.get("matcher", "")),
        settings=json_table(dataset, "matcher_settings"),
        correction_files=correction_files if is_corrected else (),
        correct=is_corrected,
    )
    for what, found in (("run", source.run_sha256), ("calibration", source.calibration.sha256)):
        if dataset.attrs.get(f"{what}_sha256") != found:
            raise StoreError(f"the {what} is not the one that the product was made with (its hash differs)")
    used = source.corrections.provenance()
    if is_corrected and any(corrected.get(part) != used[part] for part in ("cameras", "stages")):
        raise StoreError("the product was made with other corrections: give them with --correction")
    return source


def _sample(dataset: xr.Dataset, run: RunFile, source: Source, index: int, notes: list[str]) -> SampleFrame:
    """The pair behind one frame of the product, found by its time."""
    time_s = float(dataset["time"][index])
    pairs = source.pairs
    pair = int(np.argmin(np.abs(pairs.time_s - time_s)))
    left, right = (
        CorrectedPictures(run, camera, source.corrections)
        for camera in (pairs.left_camera, pairs.right_camera)
    )
    disparity: NDArray[np.float32] | None = None
    try:
        disparity = match_pair(source, pair).disparity
    except ThermacqError as error:
        notes.append(f"the disparity is not shown: {error.what}")
    return SampleFrame(
        index=index,
        time_s=time_s,
        left=left.read(int(pairs.left[pair])),
        right=right.read(int(pairs.right[pair])),
        disparity=disparity,
    )


def _surface(dataset: xr.Dataset, index: int) -> Surface | None:
    eta = dataset["eta"][index].to_numpy().astype(np.float64)
    if not np.isfinite(eta).any():
        return None
    return Surface(dataset["x"].to_numpy(), dataset["y"].to_numpy(), eta, float(dataset["time"][index]))


def _coverage(dataset: xr.Dataset) -> Coverage:
    frames = int(dataset.sizes["time"])
    supported = np.zeros((dataset.sizes["y"], dataset.sizes["x"]), np.int64)
    for block in _blocks(dataset):
        supported += np.isfinite(block).sum(axis=0)
    chosen = np.unique(np.linspace(0, frames - 1, min(frames, _FRAMES_FOR_MEDIANS)).astype(int))
    some = dataset[["eta", "eta_points", "eta_sd"]].isel(time=chosen).load()
    known = np.isfinite(some["eta"].to_numpy())
    seen = np.count_nonzero(supported)
    return Coverage(
        frames=frames,
        missing_fraction=1 - float(supported.mean()) / frames,
        seen_missing_fraction=1 - float(supported.sum()) / (seen * frames) if seen else 1.0,
        points_per_cell=_median(some["eta_points"].to_numpy()[known]),
        cell_sd_m=_median(some["eta_sd"].to_numpy()[known]),
    )


def _still(path: Path, notes: list[str]) -> Flatness | None:
    with open_product(path) as dataset:
        frames = (frame for block in _blocks(dataset) for frame in block)
        try:
            return flatness(frames, dataset["x"].to_numpy(), dataset["y"].to_numpy())
        except ThermacqError as error:
            notes.append(f"no flat-water map: {error.what}")
            return None


def _quantisation(dataset: xr.Dataset, parts: _Parts) -> Quantisation | None:
    """Fig. 16 at the geometry of the rectified pair; needs the calibration, and so the run."""
    if parts.source is None:
        return None
    try:
        world = WorldFrame.from_dict(json_table(dataset, "world_frame"))
    except ThermacqError as error:
        parts.notes.append(f"no quantisation error: {error.what}")
        return None
    geometry = parts.source.rectification
    centre, size = np.array(geometry.principal_point_px), np.array(geometry.image_size)
    half = np.maximum(centre, size - 1 - centre)
    # Distance along the optical axis to the water: the axis leans from the vertical by the tilt.
    working_m = world.camera_height_m / float(np.cos(np.radians(world.tilt_deg)))
    curve = quantisation_curve(
        np.linspace(0.4, 2.5, 106) * working_m,
        geometry.baseline_m,
        geometry.focal_px,
        (float(half[0]), float(half[1])),
        world.rotation,
    )
    return Quantisation(curve, working_m, geometry.baseline_m, geometry.focal_px)


def _blocks(dataset: xr.Dataset) -> Iterator[NDArray[np.float32]]:
    """Elevations in blocks of frames, so that memory does not grow with the product."""
    for start in range(0, dataset.sizes["time"], _FRAMES_PER_READ):
        yield dataset["eta"][start : start + _FRAMES_PER_READ].to_numpy()


def _median(values: NDArray[Any]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")
