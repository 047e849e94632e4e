from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

from thermacq.errors import ReconstructionError, StoreError
from thermacq.reconstruction import grid_over, open_product, virtual_probe
from thermacq.reconstruction.product import ProductWriter
from thermacq.store import RunHeader

HEADER = RunHeader(
    run_id="r",
    title="a title",
    start_time="2026-01-02T03:04:05+00:00",
    wall_anchor_ns=1_767_323_045_000_000_000,
    host_anchor_ns=0,
    clock="real",
    simulated=False,
    rig={},
)
GRID = grid_over(np.array([0.0, 0.04]), np.array([-0.01, 0.02]), 0.01)
TIME_S = np.arange(5) * 0.02


@pytest.fixture
def product(tmp_path):
    """eta = 0.001 (10 x + 100 y + t), one cell never supported, one missing in frame 3."""
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    eta = 0.001 * (10 * x + 100 * y + TIME_S[:, None, None]).astype(np.float32)
    eta[:, 0, 0] = np.nan
    eta[3, 1, 2] = np.nan
    points = np.where(np.isfinite(eta), 4, 0).astype(np.int32)
    sd = np.where(np.isfinite(eta), 0.0002, np.nan).astype(np.float32)
    path = tmp_path / "eta.nc"
    with ProductWriter(
        path, GRID, TIME_S, {"matcher_settings": {"a": 1}, "simulated": True}, HEADER
    ) as writer:
        writer.append(eta[:2], points[:2], sd[:2])
        writer.append(eta[2:], points[2:], sd[2:])
    return path, eta


def test_xarray_reads_what_was_written(product):
    path, eta = product
    with open_product(path) as dataset:
        np.testing.assert_array_equal(dataset["eta"].to_numpy(), eta)
        np.testing.assert_array_equal(dataset["time"].to_numpy(), TIME_S)
        assert dataset["eta_points"].dtype == np.int32
        assert json.loads(dataset.attrs["matcher_settings"]) == {"a": 1}
        assert dataset.attrs["simulated"] == "true"
    with xr.open_dataset(path, engine="h5netcdf") as decoded:
        assert str(decoded["time"].to_numpy()[1]) == "2026-01-02T03:04:05.020000000"


_READ_BY_NETCDF4 = """
import json, sys
import netCDF4, numpy as np
with netCDF4.Dataset(sys.argv[1]) as file:
    np.save(sys.argv[2], np.ma.filled(file["eta"][:], np.nan))
    print(json.dumps([file.Conventions, file["eta"].dimensions, file["eta"].units,
                      file["eta"].standard_name, file["time"].units]))
"""


def test_netcdf4_reads_it_and_finds_the_conventions(product, tmp_path):
    """In a process of its own: netCDF4 brings another HDF5 library, which must not meet that of h5py."""
    path, eta = product
    command = [sys.executable, "-c", _READ_BY_NETCDF4, path, tmp_path / "read.npy"]
    shown = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    assert shown == [
        "CF-1.11",
        ["time", "y", "x"],
        "m",
        "sea_surface_height_above_mean_sea_level",
        "seconds since 2026-01-02 03:04:05",
    ]
    np.testing.assert_array_equal(np.load(tmp_path / "read.npy"), eta)


def test_a_product_appears_only_when_it_is_complete(tmp_path):
    path = tmp_path / "eta.nc"
    writer = ProductWriter(path, GRID, TIME_S, {}, HEADER)
    assert not path.exists()
    with pytest.raises(TypeError, match="broadcast"), writer:
        writer.append(*(np.zeros((1, 2, 3), kind) for kind in (np.float32, np.int32, np.float32)))
    assert list(tmp_path.iterdir()) == []


def test_a_probe_between_cells_is_bilinear(product):
    with open_product(product[0]) as dataset:
        probe = virtual_probe(dataset, 0.0225, 0.014)
    np.testing.assert_allclose(probe.eta_m, 0.001 * (10 * 0.0225 + 100 * 0.014 + TIME_S), atol=1e-9)
    np.testing.assert_array_equal(probe.points, 16)
    np.testing.assert_allclose(probe.sd_m, 0.0002, rtol=1e-5)


def test_a_probe_on_a_centre_needs_that_cell_only(product):
    with open_product(product[0]) as dataset:
        probe = virtual_probe(dataset, 0.01, -0.01)
    np.testing.assert_allclose(probe.eta_m, 0.001 * (0.1 - 1.0 + TIME_S), atol=1e-9)
    np.testing.assert_array_equal(probe.points, 4)


def test_a_probe_beside_a_hole_takes_its_own_cell_or_nothing(product):
    with open_product(product[0]) as dataset:
        beside, inside = virtual_probe(dataset, 0.007, -0.01), virtual_probe(dataset, 0.004, -0.01)
        gap = virtual_probe(dataset, 0.019, 0.0)
    np.testing.assert_allclose(beside.eta_m, 0.001 * (0.1 - 1.0 + TIME_S), atol=1e-9)
    assert np.isnan(inside.eta_m).all()
    assert (inside.points == 0).all()
    assert np.flatnonzero(np.isnan(gap.eta_m)).tolist() == [3]


def test_a_probe_outside_is_refused_and_one_at_the_rim_is_not(product):
    with open_product(product[0]) as dataset:
        with pytest.raises(ReconstructionError, match=r"x = 0\.046 m lies outside"):
            virtual_probe(dataset, 0.046, 0.0)
        with pytest.raises(ReconstructionError, match="y = -1 m lies outside"):
            virtual_probe(dataset, 0.0, -1.0)
        rim = virtual_probe(dataset, 0.0449, 0.0249)
    np.testing.assert_allclose(rim.eta_m, 0.001 * (0.4 + 2.0 + TIME_S), atol=1e-9)


def test_foreign_files_are_no_product(tmp_path):
    (tmp_path / "text.nc").write_text("not netcdf")
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(StoreError, match="cannot be read as NetCDF"):
        open_product(tmp_path / "text.nc")
    with pytest.raises(StoreError, match="is no elevation product"):
        open_product(tmp_path / "other.nc")
    with pytest.raises(StoreError, match="there is no product"):
        open_product(tmp_path / "none.nc")
