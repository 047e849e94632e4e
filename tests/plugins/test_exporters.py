"""Export formats, through the door that every exporter uses; each file is read back by hand."""

from __future__ import annotations

import csv
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.plugins import load_plugins
from thermacq.reconstruction import grid_over
from thermacq.reconstruction.product import ProductWriter
from thermacq.store import RunHeader

HEADER = RunHeader("r", "", "2026-01-02T03:04:05+00:00", 0, 0, "real", simulated=False, rig={})
GRID = grid_over(np.array([0.1, 0.13]), np.array([0.0, 0.02]), 0.01)


@pytest.fixture
def product(tmp_path):
    """Two frames; the second has one hole; a third is empty."""
    eta = np.linspace(-0.02, 0.03, 36).reshape(3, 3, 4).astype(np.float32)
    eta[1, 2, 3] = np.nan
    eta[2] = np.nan
    points = np.where(np.isfinite(eta), 5, 0).astype(np.int32)
    path = tmp_path / "eta.nc"
    with ProductWriter(path, GRID, np.array([0.0, 0.5, 1.0]), {}, HEADER) as writer:
        writer.append(eta, points, np.where(np.isfinite(eta), np.float32(0.001), np.float32(np.nan)))
    return path, eta


def export(name, product, output, frame=1):
    load_plugins().exporter(name).write(product, output, frame)
    return output


def test_ply_holds_the_supported_cells_in_colours_of_elevation(product, tmp_path):
    path, eta = product
    content = export("ply", path, tmp_path / "frame.ply").read_bytes()
    header, body = content.split(b"end_header\n", 1)
    assert b"element vertex 11" in header
    kinds = [*((axis, "<f4") for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))]
    vertices = np.frombuffer(body, kinds)
    known = np.isfinite(eta[1])
    np.testing.assert_array_equal(vertices["z"], eta[1][known])
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    np.testing.assert_allclose(vertices["x"], x[known], rtol=1e-6)
    np.testing.assert_allclose(vertices["y"], y[known], rtol=1e-6, atol=1e-9)
    low, high = vertices[vertices["z"].argmin()], vertices[vertices["z"].argmax()]
    assert low["blue"] > low["red"]
    assert high["red"] > high["blue"]


def test_csv_has_a_line_for_each_supported_cell(product, tmp_path):
    path, eta = product
    with export("csv", path, tmp_path / "frame.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "x_m", "y_m", "eta_m", "points", "sd_m"]
    np.testing.assert_allclose([float(row["eta_m"]) for row in rows], eta[1][np.isfinite(eta[1])], atol=1e-6)
    assert {row["time_s"] for row in rows} == {"0.500000"}


def test_vtk_blanks_what_is_not_supported(product, tmp_path):
    path, eta = product
    tree = ET.parse(export("vtk", path, tmp_path / "frame.vts")).getroot()
    grid = tree.find("StructuredGrid")
    assert grid is not None
    assert grid.get("WholeExtent") == "0 3 0 2 0 0"
    arrays = {
        item.get("Name"): np.array(item.text.split(), float) for item in grid.iter("DataArray") if item.text
    }
    hidden = arrays["vtkGhostType"].reshape(3, 4) == 2
    np.testing.assert_array_equal(hidden, np.isnan(eta[1]))
    position = arrays["position"].reshape(3, 4, 3)
    np.testing.assert_allclose(position[~hidden][:, 2], eta[1][~hidden], rtol=1e-6)
    np.testing.assert_allclose(position[0, :, 0], GRID.x_m)
    assert arrays["TimeValue"] == 0.5


@pytest.mark.parametrize("name", ["ply", "csv", "vtk"])
def test_what_cannot_be_exported_is_explained(product, tmp_path, name):
    path, _ = product
    with pytest.raises(StoreError, match="no frame 3; it has 3"):
        export(name, path, tmp_path / "out", frame=3)
    with pytest.raises(StoreError, match="no supported cell"):
        export(name, path, tmp_path / "out", frame=2)
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(StoreError, match="exists"):
        export(name, path, tmp_path / "mine")
    assert (tmp_path / "mine").read_text() == "mine"
    assert not (tmp_path / "out").exists()
