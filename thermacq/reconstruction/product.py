"""The elevation product: a CF NetCDF-4 file, its writer, its reader, and probes put anywhere on it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError, StoreError
from thermacq.reconstruction.gridding import Grid

if TYPE_CHECKING:
    import xarray as xr

_FRAMES_PER_CHUNK = 16
_VARIABLES = ("eta", "eta_points", "eta_sd")


class Recording(Protocol):
    """What a product tells of its recording beside its attributes; a `RunHeader` is one."""

    @property
    def title(self) -> str:
        """Free text."""
        ...

    @property
    def wall_anchor_ns(self) -> int:
        """Unix time of the zero of the recording's seconds."""
        ...


class ProductWriter:
    """Writes a product frame by frame; it appears under its name only when it is complete.

    Parameters
    ----------
    path
        File to write.
    grid
        Its cells.
    time_s
        (frames,) seconds since the start of the recording.
    attributes
        Provenance; values that are no text or number are stored as JSON.
    header
        Header of the run, for title and time of start.
    uncertainty_m
        (ny, nx) standard uncertainty of a cell in one frame; None: not known.
    """

    def __init__(
        self,
        path: Path,
        grid: Grid,
        time_s: NDArray[np.float64],
        attributes: Mapping[str, Any],
        header: Recording,
        uncertainty_m: NDArray[np.float32] | None = None,
    ) -> None:
        import h5netcdf

        self._path = path
        self._unfinished = path.with_name(path.name + ".part")
        self._written = 0
        try:
            self._file = h5netcdf.File(self._unfinished, "w")
        except OSError as error:
            raise StoreError(
                f"'{path}' cannot be written: {error.strerror or error}", remedy="Choose another place."
            ) from None
        start = datetime.fromtimestamp(header.wall_anchor_ns / 1e9, UTC).replace(tzinfo=None)
        self._file.dimensions = {"time": time_s.size, "y": grid.y_m.size, "x": grid.x_m.size}
        self._coordinate("time", time_s, standard_name="time", axis="T", calendar="standard")
        self._file.variables["time"].attrs["units"] = f"seconds since {start.isoformat(sep=' ')}"
        self._file.variables["time"].attrs["long_name"] = "seconds since the start of the recording"
        self._coordinate("y", grid.y_m, units="m", axis="Y", long_name="across the flume")
        self._coordinate("x", grid.x_m, units="m", axis="X", long_name="along the flume")
        self._surface_variables(grid, time_s.size)
        if uncertainty_m is not None:
            variable = self._file.create_variable("eta_u", ("y", "x"), data=uncertainty_m)
            variable.attrs["long_name"] = "standard uncertainty of eta in one frame, by matching"
            variable.attrs["units"] = "m"
        self._file.attrs["Conventions"] = "CF-1.11"
        self._file.attrs["title"] = header.title or "water surface elevation"
        self._file.attrs["source"] = "thermal stereography"
        self._file.attrs["world"] = (
            "origin on the still water, z up, x along the flume, right-handed, metres; see world_frame"
        )
        for name, value in attributes.items():
            plain = isinstance(value, str | int | float) and not isinstance(value, bool)
            self._file.attrs[name] = value if plain else json.dumps(value)

    def append(
        self, eta_m: NDArray[np.float32], points: NDArray[np.int32], sd_m: NDArray[np.float32]
    ) -> None:
        """Append frames: three arrays (frames, ny, nx)."""
        stop = self._written + len(eta_m)
        for name, values in zip(_VARIABLES, (eta_m, points, sd_m), strict=True):
            self._file.variables[name][self._written : stop] = values
        self._written = stop

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError) if kind else contextlib.nullcontext():
            self._file.close()
        if kind is None:
            self._unfinished.replace(self._path)
        else:
            self._unfinished.unlink(missing_ok=True)

    def _coordinate(self, name: str, values: NDArray[np.float64], **attributes: str) -> None:
        variable = self._file.create_variable(name, (name,), data=values)
        variable.attrs.update(attributes)

    def _surface_variables(self, grid: Grid, frames: int) -> None:
        chunks = (min(_FRAMES_PER_CHUNK, frames), *grid.shape)
        described = {
            "eta": (
                "f4",
                "sea_surface_height_above_mean_sea_level",
                "elevation above the still water, mean of the cell",
            ),
            "eta_points": ("i4", "", "number of matched points in the cell"),
            "eta_sd": ("f4", "", "standard deviation of the points inside the cell"),
        }
        for name, (kind, standard_name, long_name) in described.items():
            fill = np.float32(np.nan) if kind == "f4" else None
            variable = self._file.create_variable(
                name,
                ("time", "y", "x"),
                dtype=kind,
                fillvalue=fill,
                chunks=chunks,
                compression="gzip",
                compression_opts=1,
                shuffle=True,
            )
            variable.attrs["long_name"] = long_name
            variable.attrs["units"] = "m" if kind == "f4" else "1"
            if standard_name:
                variable.attrs["standard_name"] = standard_name
                variable.attrs["ancillary_variables"] = "eta_points eta_sd"


def open_product(path: Path | str) -> xr.Dataset:
    """Open an elevation product lazily; close it, or use it as a context manager.

    Returns
    -------
    xarray.Dataset
        ``eta``, ``eta_sd`` (time, y, x) float32, metres; ``eta_points`` int32; ``time`` in seconds since
        the start of the recording (float64); ``x`` and ``y`` in metres.

    Raises
    ------
    StoreError
        The file is missing, cannot be read, or is no elevation product.
    """
    import xarray as xr

    path = Path(path)
    if not path.is_file():
        raise StoreError(f"there is no product '{path}'", remedy="Make it with `thermacq reconstruct`.")
    try:
        dataset = xr.open_dataset(path, engine="h5netcdf", decode_times=False)
    except Exception as error:
        raise StoreError(f"'{path}' cannot be read as NetCDF: {type(error).__name__}: {error}") from None
    right = all(
        name in dataset.variables and dataset[name].dims == ("time", "y", "x") for name in _VARIABLES
    ) and all(name in dataset.coords for name in ("time", "y", "x"))
    if not right:
        dataset.close()
        raise StoreError(
            f"'{path}' is no elevation product: it lacks eta, eta_points or eta_sd over time, y and x",
            remedy="Make one with `thermacq reconstruct`.",
        )
    return dataset


class VirtualProbe(NamedTuple):
    """Elevation at one place.

    Parameters
    ----------
    time_s
        (frames,) float64, seconds since the start of the recording.
    eta_m
        (frames,) float64, NaN where no cell supports it.
    sd_m
        (frames,) float64, standard deviation inside the cells used.
    points
        (frames,) int64, matched points in the cells used.
    """

    time_s: NDArray[np.float64]
    eta_m: NDArray[np.float64]
    sd_m: NDArray[np.float64]
    points: NDArray[np.int64]


def virtual_probe(product: xr.Dataset, x_m: float, y_m: float) -> VirtualProbe:
    """Elevation over time at a place of the surface.

    Bilinear between the centres of the four cells around the place in frames in which all four are
    supported; else the value of the cell that holds the place, where that is supported; else NaN.

    Parameters
    ----------
    product
        From `open_product`.
    x_m, y_m
        World coordinates.

    Raises
    ------
    ReconstructionError
        The place lies outside the grid.
    """
    x, y = product["x"].to_numpy(), product["y"].to_numpy()
    column, along = _cell(x, x_m, "x")
    row, across = _cell(y, y_m, "y")
    around = product.isel(y=slice(row, row + 2), x=slice(column, column + 2)).load()
    eta, sd, points = (around[name].to_numpy().astype(np.float64) for name in ("eta", "eta_sd", "eta_points"))
    weights = np.multiply.outer(_weights(across, eta.shape[1]), _weights(along, eta.shape[2]))
    holder = np.unravel_index(int(np.argmax(weights)), weights.shape)
    nearest = (slice(None), int(holder[0]), int(holder[1]))
    # A place on the centre line of cells needs only those cells that carry weight.
    used = weights > 0
    supported = np.isfinite(eta[:, used]).all(axis=1)
    bilinear = eta[:, used] @ weights[used]
    spread = np.sqrt(np.nan_to_num(sd[:, used]) ** 2 @ weights[used])
    return VirtualProbe(
        time_s=product["time"].to_numpy().astype(np.float64),
        eta_m=np.where(supported, bilinear, eta[nearest]),
        sd_m=np.where(supported, spread, sd[nearest]),
        points=np.where(supported, points[:, used].sum(axis=1), points[nearest]).astype(np.int64),
    )


def _weights(fraction: float, length: int) -> NDArray[np.float64]:
    return np.array([1.0 - fraction, fraction])[:length]


def _cell(centres: NDArray[np.float64], place_m: float, axis: str) -> tuple[int, float]:
    """Index of the cell centre below a place, and the fraction of the way to the next one."""
    spacing = float(centres[1] - centres[0]) if centres.size > 1 else 1.0
    position = (place_m - float(centres[0])) / spacing
    if not -0.5 <= position <= centres.size - 0.5:
        raise ReconstructionError(
            f"{axis} = {place_m:g} m lies outside the surface, which covers "
            f"{centres[0] - spacing / 2:.3f} to {centres[-1] + spacing / 2:.3f} m",
            remedy="Choose a place inside.",
        )
    inside = min(max(position, 0.0), centres.size - 1.0)
    index = min(int(inside), max(centres.size - 2, 0))
    return index, round(inside - index, 9)
