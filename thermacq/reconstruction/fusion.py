"""Two elevation products in one world frame to one: weights from their uncertainty, no step at the seams.

Where both products have a cell, it is their mean with the weights ``1 / u²``, u being the standard uncertainty of
a cell (``eta_u``). Over the last few cells before the edge of what a product covers, its share falls linearly to
0, so that at the edge the fused surface is already that of the other one, whatever the two differ by.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq import __version__
from thermacq.errors import ReconstructionError
from thermacq.outputs import check_new_file
from thermacq.reconstruction.cell_uncertainty import cell_uncertainty_m
from thermacq.reconstruction.gridding import Grid
from thermacq.reconstruction.product import ProductWriter, open_product
from thermacq.reconstruction.world import WorldFrame

if TYPE_CHECKING:
    import xarray as xr

_FRAMES_AT_ONCE = 16
_RAMP_CELLS = 10
_OFTEN = 0.5
"""A cell belongs to the footprint of a product when at least this share of its frames support it."""
_SAME_TIME = 0.1
"""Frames belong together when they differ by less than this share of the time between frames."""


@dataclass(frozen=True)
class Overlap:
    """First product less second, over cells and frames that both support.

    Parameters
    ----------
    cells
        Number of cells that both support in at least one common frame.
    mean_m, sigma_m
        Mean and standard deviation of the difference.
    steady_sigma_m
        Standard deviation over the cells of the difference averaged over time: what averaging does not remove.
    expected_sigma_m
        Root of the sum of the squared uncertainties of both, RMS over the overlap.
    """

    cells: int
    mean_m: float
    sigma_m: float
    steady_sigma_m: float
    expected_sigma_m: float


@dataclass(frozen=True)
class Fused:
    """What a fusion came to.

    Parameters
    ----------
    product
        The file.
    frames
        Common frames.
    left_out
        Frames of either product without a partner.
    cells
        (ny, nx) of the common grid.
    overlap
        Agreement of the two; None when they do not overlap.
    doubts
        Sentences on what may be wrong.
    """

    product: Path
    frames: int
    left_out: int
    cells: tuple[int, int]
    overlap: Overlap | None
    doubts: tuple[str, ...]


@dataclass(frozen=True)
class _Start:
    title: str
    wall_anchor_ns: int


class _Part:
    """One product, seen on the common grid."""

    def __init__(self, dataset: xr.Dataset, frames: NDArray[np.intp], grid: Grid, own: Grid) -> None:
        self._dataset = dataset
        self._frames = frames
        self._shape = grid.shape
        row = round((own.y_m[0] - grid.y_m[0]) / grid.spacing_m)
        column = round((own.x_m[0] - grid.x_m[0]) / grid.spacing_m)
        self._place = (..., slice(row, row + own.shape[0]), slice(column, column + own.shape[1]))
        self.uncertainty_m = self._spread(_uncertainty(dataset, own), np.nan)
        self.weight = np.zeros(grid.shape)

    def block(self, name: str, start: int) -> NDArray[Any]:
        """Some frames of a variable on the common grid, NaN (or 0) outside."""
        chosen = self._frames[start : start + _FRAMES_AT_ONCE]
        values = self._dataset[name].isel(time=chosen).to_numpy()
        return self._spread(values, np.nan if values.dtype.kind == "f" else 0)

    def footprint(self) -> NDArray[np.bool_]:
        """Cells that most frames support."""
        count = np.zeros(self._shape)
        for start in range(0, self._frames.size, _FRAMES_AT_ONCE):
            count += np.isfinite(self.block("eta", start)).sum(axis=0)
        often: NDArray[np.bool_] = count >= max(1.0, _OFTEN * self._frames.size)
        return often

    def _spread(self, values: NDArray[Any], fill: float) -> NDArray[Any]:
        spread = np.full((*values.shape[:-2], *self._shape), fill, values.dtype)
        spread[self._place] = values
        return spread


def fuse(first: Path, second: Path, output: Path) -> Fused:
    """Fuse two products of one recording.

    Parameters
    ----------
    first, second
        Elevation products; the world frame of the second must have been joined to that of the first, or the
        other way round (`thermacq world`).
    output
        Product to write; must not exist.

    Raises
    ------
    StoreError
        A product cannot be read, or the output exists.
    ReconstructionError
        They are of different recordings, spacings or times.
    """
    check_new_file(output)
    with open_product(first) as one, open_product(second) as other:
        require_same_recording(one, other)
        times = common_times(one, other)
        own = [_grid_of(dataset) for dataset in (one, other)]
        grid = _union(*own)
        parts = [
            _Part(dataset, frames, grid, its)
            for dataset, frames, its in zip((one, other), times, own, strict=True)
        ]
        prints = [part.footprint() for part in parts]
        for part, weight in zip(parts, _weights(prints, [p.uncertainty_m for p in parts]), strict=True):
            part.weight = weight
        overlap = _overlap(parts, times[0].size)
        doubts = _doubts(one, other, overlap)
        start, time_s = _start_of(one), one["time"].to_numpy()[times[0]].astype(np.float64)
        attributes = _attributes((first, second), (one, other), overlap)
        with ProductWriter(output, grid, time_s, attributes, start, _fused_uncertainty(parts)) as product:
            for block in _blocks(parts, times[0].size):
                product.append(*block)
        left_out = one.sizes["time"] + other.sizes["time"] - 2 * times[0].size
    return Fused(output, time_s.size, left_out, grid.shape, overlap, doubts)


def _blocks(
    parts: list[_Part], frames: int
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]]]:
    """Fused eta, points and sd, some frames at a time."""
    for start in range(0, frames, _FRAMES_AT_ONCE):
        eta = [part.block("eta", start) for part in parts]
        weights = [np.where(np.isfinite(e), p.weight, 0.0) for e, p in zip(eta, parts, strict=True)]
        # A cell that only one product supports is its, however near to the edge it lies.
        total = weights[0] + weights[1]
        known = total > 0
        shares = [np.divide(w, total, out=np.zeros_like(w), where=known) for w in weights]
        sd = [np.nan_to_num(part.block("eta_sd", start)) for part in parts]
        points = sum(part.block("eta_points", start) for part in parts)
        mean = sum(s * np.nan_to_num(e) for s, e in zip(shares, eta, strict=True))
        spread = np.sqrt(sum(s * d**2 for s, d in zip(shares, sd, strict=True)))
        yield (
            np.where(known, mean, np.nan).astype(np.float32),
            np.asarray(points, np.int32),
            np.where(known, spread, np.nan).astype(np.float32),
        )


def _weights(
    prints: list[NDArray[np.bool_]], uncertainties: list[NDArray[np.float32]]
) -> list[NDArray[np.float64]]:
    """Shares of both products; never 0 inside a product's grid, so that single frames may reach farther."""
    from scipy.ndimage import distance_transform_edt

    # A rim of outside around the grid, so that its border is an edge too.
    depths = [distance_transform_edt(np.pad(one, 1))[1:-1, 1:-1] for one in prints]
    deepest = float(np.minimum(*depths).max())
    ramp = min(max(deepest, 1.0), _RAMP_CELLS)
    fades = [
        np.where(np.isfinite(u), np.clip(depth / ramp, 1e-6, 1.0), 0.0)
        for depth, u in zip(depths, uncertainties, strict=True)
    ]
    squares = [np.square(u, dtype=np.float64) for u in uncertainties]
    best = np.nan_to_num(squares[1] / (squares[0] + squares[1]), nan=0.5)
    # As one product fades, the other takes over what it loses: the share falls linearly, whatever the other's is.
    return [
        fades[0] * (best + (1 - best) * (1 - fades[1])),
        fades[1] * ((1 - best) + best * (1 - fades[0])),
    ]


def _fused_uncertainty(parts: list[_Part]) -> NDArray[np.float32]:
    """Standard uncertainty of a fused cell where both products support it, if their errors are independent."""
    total = parts[0].weight + parts[1].weight
    square = sum((part.weight * np.nan_to_num(part.uncertainty_m)) ** 2 for part in parts)
    known = total > 0
    fused: NDArray[np.float32] = np.where(
        known, np.sqrt(square) / np.where(known, total, 1.0), np.nan
    ).astype(np.float32)
    return fused


def _overlap(parts: list[_Part], frames: int) -> Overlap | None:
    count, mean, square = (np.zeros(parts[0].weight.shape) for _ in range(3))
    for start in range(0, frames, _FRAMES_AT_ONCE):
        difference = parts[0].block("eta", start).astype(np.float64) - parts[1].block("eta", start)
        count += np.isfinite(difference).sum(axis=0)
        mean += np.nansum(difference, axis=0)
        square += np.nansum(difference**2, axis=0)
    both = count > 0
    if not both.any():
        return None
    middle = float(mean.sum() / count.sum())
    expected = sum(np.square(part.uncertainty_m[both], dtype=float) for part in parts)
    steady = mean[both] / count[both]
    return Overlap(
        cells=int(both.sum()),
        mean_m=middle,
        sigma_m=float(np.sqrt(max(square.sum() / count.sum() - middle**2, 0.0))),
        steady_sigma_m=float(steady.std()),
        expected_sigma_m=float(np.sqrt(np.mean(expected))),
    )


def _doubts(one: xr.Dataset, other: xr.Dataset, overlap: Overlap | None) -> tuple[str, ...]:
    doubts = []
    frames = [world_of(dataset) for dataset in (one, other)]
    joined = any(
        "joined" in a.source
        and a.source["joined"].get("to_calibration_sha256") == b.source.get("calibration_sha256")
        for a, b in (frames, frames[::-1])
    )
    if not joined:
        doubts.append(
            "nothing says that the two products stand in one world frame; join them first with `thermacq world`"
        )
    if overlap is None:
        doubts.append("the products do not overlap, so nothing shows whether they agree")
    elif overlap.sigma_m > 3 * overlap.expected_sigma_m or abs(overlap.mean_m) > 3 * overlap.expected_sigma_m:
        doubts.append(
            f"the products differ by {1000 * overlap.mean_m:+.2f} mm with a standard deviation of "
            f"{1000 * overlap.sigma_m:.2f} mm where they overlap; their uncertainties explain "
            f"{1000 * overlap.expected_sigma_m:.2f} mm"
        )
    return tuple(doubts)


def require_same_recording(one: xr.Dataset, other: xr.Dataset) -> None:
    """Refuse products of different recordings, or of the same cameras; raises `ReconstructionError`."""
    runs = [dataset.attrs.get("run_id", "") for dataset in (one, other)]
    if runs[0] != runs[1] or not runs[0]:
        raise ReconstructionError(
            f"the products are of different recordings (runs {runs[0]} and {runs[1]}): their times have no common zero",
            remedy="Record all cameras into one run and reconstruct its pairs with --pair.",
        )
    if one.attrs.get("cameras") and one.attrs.get("cameras") == other.attrs.get("cameras"):
        raise ReconstructionError(
            f"both products are of the same cameras ({one.attrs['cameras']}): they are not independent",
            remedy="Fuse products of different pairs.",
        )


def common_times(one: xr.Dataset, other: xr.Dataset) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the frames of both that were taken at the same times.

    Raises
    ------
    ReconstructionError
        They are fewer than half of the shorter product.
    """
    first, second = (dataset["time"].to_numpy().astype(np.float64) for dataset in (one, other))
    step = float(np.median(np.diff(first))) if first.size > 1 else 1.0
    after = (
        np.clip(np.searchsorted(second, first), 1, second.size - 1)
        if second.size > 1
        else np.zeros_like(first)
    )
    after = after.astype(np.intp)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(second[after] - first) < np.abs(second[before] - first), after, before)
    same = np.abs(second[nearest] - first) < _SAME_TIME * step
    if np.count_nonzero(same) < 0.5 * min(first.size, second.size):
        raise ReconstructionError(
            f"only {np.count_nonzero(same)} of {first.size} and {second.size} frames were taken at the same times",
            remedy="Reconstruct the same --frames of a run whose cameras share a trigger.",
        )
    return np.flatnonzero(same), nearest[same]


def _grid_of(dataset: xr.Dataset) -> Grid:
    x, y = (dataset[name].to_numpy().astype(np.float64) for name in ("x", "y"))
    if min(x.size, y.size) < 2:
        raise ReconstructionError("a product with a single row or column of cells cannot be fused")
    return Grid(x, y, float((x[-1] - x[0]) / (x.size - 1)))


def _union(one: Grid, other: Grid) -> Grid:
    spacing = one.spacing_m
    shift = [(b[0] - a[0]) / spacing for a, b in ((one.x_m, other.x_m), (one.y_m, other.y_m))]
    if abs(other.spacing_m / spacing - 1) > 1e-6 or any(abs(value - round(value)) > 1e-3 for value in shift):
        raise ReconstructionError(
            f"the products have cells of {1000 * spacing:g} and {1000 * other.spacing_m:g} mm that do not coincide",
            remedy="Reconstruct both with the same reconstruction.grid_spacing_m.",
        )
    axes = []
    for a, b in ((one.x_m, other.x_m), (one.y_m, other.y_m)):
        first, last = (round(value / spacing) for value in (min(a[0], b[0]), max(a[-1], b[-1])))
        axes.append(np.round(np.arange(first, last + 1) * spacing, 9))
    return Grid(axes[0], axes[1], spacing)


def _uncertainty(dataset: xr.Dataset, grid: Grid) -> NDArray[np.float32]:
    if "eta_u" in dataset.variables and dataset["eta_u"].dims == ("y", "x"):
        return dataset["eta_u"].to_numpy().astype(np.float32)
    return cell_uncertainty_m(world_of(dataset), grid)


def world_of(dataset: xr.Dataset) -> WorldFrame:
    """World frame in which a product stands; raises `ReconstructionError` when it does not say."""
    try:
        values = json.loads(dataset.attrs["world_frame"])
    except (KeyError, TypeError, ValueError):
        raise ReconstructionError(
            "a product does not say in which world frame it stands", remedy="Reconstruct it again."
        ) from None
    return WorldFrame.from_dict(values)


def _start_of(dataset: xr.Dataset) -> _Start:
    since = str(dataset["time"].attrs.get("units", "")).removeprefix("seconds since ")
    try:
        start = datetime.fromisoformat(since).replace(tzinfo=UTC)
    except ValueError:
        start = datetime.fromtimestamp(0, UTC)
    return _Start(str(dataset.attrs.get("title", "")), round(start.timestamp() * 1e9))


def _attributes(
    paths: tuple[Path, Path], datasets: tuple[xr.Dataset, xr.Dataset], overlap: Overlap | None
) -> dict[str, Any]:
    """Provenance of both products; what they have in common also stands by itself."""
    one, other = (_plain(dataset) for dataset in datasets)
    taken = ("Conventions", "title", "source", "world")
    common = {key: value for key, value in one.items() if other.get(key) == value and key not in taken}
    origins = [
        {"product": path.name, "product_sha256": hashlib.sha256(path.read_bytes()).hexdigest(), **attributes}
        for path, attributes in zip(paths, (one, other), strict=True)
    ]
    return {
        **common,
        "world_frame": one["world_frame"],
        "fused_from": origins,
        "overlap": None if overlap is None else asdict(overlap),
        "thermacq_version": __version__,
    }


def _plain(dataset: xr.Dataset) -> dict[str, Any]:
    return {
        key: value.item() if isinstance(value, np.generic) else value for key, value in dataset.attrs.items()
    }
