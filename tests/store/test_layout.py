"""The run file as other programs see it: NeXus validator, xarray, plain h5py."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
import xarray as xr


@pytest.fixture
def validate():
    """Warnings and errors of the base-class check of nexusformat (``nxcheck``, formerly ``nxvalidate``)."""
    validator = pytest.importorskip("nexusformat.nexus.validate")
    return validator.validate_file


def test_run_file_is_valid_nexus(run_file, validate):
    assert validate(str(run_file)) == (0, 0)


def test_file_of_a_killed_writer_is_valid_nexus_once_recovered(create, append, tmp_path, validate):
    from thermacq.store import recover

    writer = create()
    append(writer, 0)
    writer.close()
    recover(tmp_path / "run.h5", tmp_path / "clean.h5")
    assert validate(str(tmp_path / "clean.h5")) == (0, 0)


def test_the_validator_would_complain(run_file, validate):
    with h5py.File(run_file, "r+") as file:
        file["entry/instrument/left"].create_dataset("temperature_of_tea", data=80.0)
        file["entry/instrument/left"].create_group("spoon").attrs["NX_class"] = "NXspoon"
    assert sum(validate(str(run_file))) > 0


def test_default_plot_is_the_first_camera(run_file):
    nexus = pytest.importorskip("nexusformat.nexus")
    root = nexus.nxload(str(run_file))
    data = root.get_default()
    assert data.nxname == "left"
    assert data.nxsignal.nxname == "data"
    assert [axis.nxname for axis in data.nxaxes] == ["time", "row", "column"]


@pytest.mark.parametrize("camera", ["left", "right"])
def test_xarray_opens_a_camera(run_file, counts_of, camera):
    with xr.open_dataset(
        run_file, engine="h5netcdf", group=f"entry/{camera}", decode_timedelta=False
    ) as data:
        assert data["data"].dims == ("time", "row", "column")
        assert data["data"].attrs["units"] == "counts"
        np.testing.assert_allclose(data["time"], 0.02 * np.arange(25), atol=1e-12)
        assert data["time"].attrs["units"] == "s"
        np.testing.assert_array_equal(data["trigger_index"], np.arange(25))
        np.testing.assert_array_equal(data["data"].isel(time=17), counts_of(camera, 17))


def test_xarray_opens_a_probe(run_file):
    with xr.open_dataset(run_file, engine="h5netcdf", group="entry/gauge", decode_timedelta=False) as data:
        assert data["value"].dims == ("time", "channel")
        assert data["value"].attrs["units"] == "V"
        np.testing.assert_allclose(data["time"], 1e-3 * np.arange(500), atol=1e-12)
        np.testing.assert_allclose(data["value"].isel(channel=1), -0.25 * np.arange(500))


def test_detector_facts_stand_where_nexus_wants_them(run_file):
    with h5py.File(run_file) as file:
        detector = file["entry/instrument/left"]
        assert detector["bit_depth_readout"][()] == 14
        assert detector["saturation_value"][()] == 2**14 - 1
        assert detector["frame_time"][()] == pytest.approx(0.02)
        assert detector["frame_time"].attrs["units"] == "s"
        assert detector["serial_number"].asstr()[()] == "left"
        assert detector["sequence_number"].shape == (25,)
        assert detector["start_time"].attrs["start"] == "2024-05-01T10:00:00+00:00"
        assert file["entry/end_time"].asstr()[()] == "2024-05-01T10:00:01+00:00"


def test_older_hdf5_can_read_the_file(run_file):
    superblock_version = run_file.read_bytes()[8]
    assert superblock_version == 3  # that of HDF5 1.10
