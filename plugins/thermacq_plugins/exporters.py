"""One frame of an elevation product as PLY, VTK or CSV."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import StoreError
from thermacq.reconstruction import check_new_file, open_product
from thermacq.reconstruction import write_ply as write_point_cloud

# Anchors of the colour map "coolwarm": blue troughs, grey still water, red crests.
_COLOURS = np.array([(59, 76, 192), (221, 221, 221), (180, 4, 38)], np.float64)


@dataclass(frozen=True)
class _Frame:
    """One frame: coordinates (nx,), (ny,) and cells (ny, nx)."""

    time_s: float
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    eta_m: NDArray[np.float32]
    points: NDArray[np.int32]
    sd_m: NDArray[np.float32]

    def positions(self) -> NDArray[np.float64]:
        """(ny, nx, 3) float64, metres; NaN height in unsupported cells."""
        x, y = np.meshgrid(self.x_m, self.y_m)
        return np.stack([x, y, self.eta_m], axis=-1)


def write_ply(product: Path, output: Path, frame: int) -> None:
    """Point cloud of the supported cells, coloured by elevation."""
    surface = _read(product, output, frame)
    write_point_cloud(output, surface.positions(), _colours(surface.eta_m))


def write_csv(product: Path, output: Path, frame: int) -> None:
    """Supported cells as lines ``time_s, x_m, y_m, eta_m, points, sd_m``."""
    surface = _read(product, output, frame)
    x, y = np.meshgrid(surface.x_m, surface.y_m)
    known = np.isfinite(surface.eta_m)
    columns = [field[known] for field in (x, y, surface.eta_m, surface.points, surface.sd_m)]
    with output.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "x_m", "y_m", "eta_m", "points", "sd_m"])
        for a, b, eta, points, sd in zip(*columns, strict=True):
            writer.writerow(
                [f"{surface.time_s:.6f}", f"{a:.6f}", f"{b:.6f}", f"{eta:.6f}", points, f"{sd:.6f}"]
            )


def write_vts(product: Path, output: Path, frame: int) -> None:
    """XML structured grid for ParaView; unsupported cells are blanked (VTK's hidden points)."""
    surface = _read(product, output, frame)
    rows, columns = surface.eta_m.shape
    positions = surface.positions()
    hidden = ~np.isfinite(surface.eta_m)
    positions[hidden, 2] = 0.0
    extent = quoteattr(f"0 {columns - 1} 0 {rows - 1} 0 0")
    arrays = [
        _array("eta", "Float32", np.nan_to_num(surface.eta_m)),
        _array("eta_sd", "Float32", np.nan_to_num(surface.sd_m)),
        _array("eta_points", "Int32", surface.points),
        # 2 is VTK's HIDDENPOINT: readers draw neither the point nor the cells around it.
        _array("vtkGhostType", "UInt8", np.where(hidden, 2, 0)),
    ]
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="StructuredGrid" version="1.0" byte_order="LittleEndian">',
        f"<StructuredGrid WholeExtent={extent}>",
        '<FieldData><DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">',
        f"{surface.time_s!r}</DataArray></FieldData>",
        f"<Piece Extent={extent}>",
        '<PointData Scalars="eta">',
        *arrays,
        "</PointData>",
        "<Points>",
        _array("position", "Float64", positions, components=3),
        "</Points>",
        "</Piece></StructuredGrid></VTKFile>",
    ]
    output.write_text("\n".join(lines) + "\n", encoding="ascii")


def _read(product: Path, output: Path, frame: int) -> _Frame:
    check_new_file(output)
    with open_product(product) as dataset:
        frames = dataset.sizes["time"]
        if not -frames <= frame < frames:
            raise StoreError(f"'{product}' has no frame {frame}; it has {frames}")
        one = dataset.isel(time=frame).load()
        surface = _Frame(
            time_s=float(one["time"]),
            x_m=one["x"].to_numpy(),
            y_m=one["y"].to_numpy(),
            eta_m=one["eta"].to_numpy(),
            points=one["eta_points"].to_numpy(),
            sd_m=one["eta_sd"].to_numpy(),
        )
    if not np.isfinite(surface.eta_m).any():
        raise StoreError(f"frame {frame} of '{product}' has no supported cell: there is nothing to export")
    return surface


def _colours(eta_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Pseudo-colour (ny, nx, 3), symmetric about the still water."""
    largest = max(float(np.nanmax(np.abs(eta_m))), 1e-6)
    place = np.nan_to_num(eta_m / largest)
    channels = [np.interp(place, (-1.0, 0.0, 1.0), _COLOURS[:, channel]) for channel in range(3)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def _array(name: str, kind: str, values: NDArray[np.generic], components: int = 1) -> str:
    numbers = " ".join(f"{value:.7g}" for value in values.ravel().tolist())
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="ascii">'
        f"{numbers}</DataArray>"
    )
