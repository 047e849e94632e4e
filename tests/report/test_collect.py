from __future__ import annotations

import shutil

import h5py
import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.report import write_report
from thermacq.report.collect import collect
from thermacq.store import open_run

pytestmark = pytest.mark.usefixtures("known_truth")


def test_everything_from_product_run_and_still_water(measured_wave):
    data = collect(measured_wave.product, run=measured_wave.run, still=measured_wave.still)
    assert data.title == "A <b>known</b> wave"
    assert data.simulated
    assert data.comparisons[0].agreement.slope == pytest.approx(0.98 / 1.01, abs=1e-3)
    assert data.flatness.overall_sd_m == pytest.approx(3e-4, rel=0.05)
    assert data.coverage.frames == 200
    assert data.coverage.seen_missing_fraction == pytest.approx(0, abs=1e-12)
    assert data.coverage.missing_fraction == pytest.approx(1 / 21)
    assert data.coverage.points_per_cell == 9
    assert data.sync["pairs"] == 200
    assert [(event.time_s, event.kind, event.index) for event in data.events] == [(0.5, "late_trigger", 25)]
    assert data.quantisation.working_distance_m == pytest.approx(0.6 / np.cos(np.radians(22.8)))
    assert data.provenance["Run"]["title"] == "A <b>known</b> wave"
    assert data.provenance["Calibration"]["acceptance"] == "unknown"
    assert "pulses, drift +20.00 ppm" in data.provenance["Probe P1"]["clock"]


def test_the_sample_is_the_pair_of_the_frame(measured_wave):
    data = collect(measured_wave.product, run=measured_wave.run)
    assert (data.sample.index, data.sample.time_s) == (100, pytest.approx(2.0))
    with open_run(measured_wave.run) as run:
        assert np.array_equal(data.sample.left, run.counts("left", 100))
    # The right picture is the left one, seen 24 pixels further on.
    assert np.nanmedian(data.sample.disparity) == pytest.approx(24, abs=0.05)


def test_a_product_alone_is_enough(measured_wave):
    data = collect(measured_wave.product, title="my title")
    assert data.title == "my title"
    assert data.comparisons == ()
    assert data.sample is None
    assert data.surface is not None


def test_another_calibration_costs_only_its_part(measured_wave, tmp_path, small_pair):
    other = tmp_path / "other.json"
    small_pair.truth.save(other)
    data = collect(measured_wave.product, run=measured_wave.run, calibration=other)
    assert data.sample is None
    assert any("frames and disparity are not shown" in note for note in data.notes)
    assert data.comparisons


def test_files_that_do_not_belong_or_are_missing(measured_wave, tmp_path):
    with pytest.raises(StoreError, match="no product"):
        collect(tmp_path / "none.nc")
    with pytest.raises(StoreError, match="no run file"):
        collect(measured_wave.product, run=tmp_path / "none.h5")
    with pytest.raises(StoreError):
        collect(measured_wave.product, run=measured_wave.product)
    with pytest.raises(StoreError):
        collect(measured_wave.product, still=measured_wave.run)


def test_write_report(measured_wave, tmp_path):
    page = tmp_path / "report.html"
    notes = write_report(measured_wave.product, page, run=measured_wave.run, still=measured_wave.still)
    text = page.read_text(encoding="utf-8")
    assert "A &lt;b&gt;known&lt;/b&gt; wave" in text
    assert "&lt;i&gt;late&lt;/i&gt;" in text
    assert "<i>late" not in text
    assert notes == ()
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_a_page_that_cannot_be_written(measured_wave, tmp_path):
    with pytest.raises(StoreError, match="cannot be written"):
        write_report(measured_wave.product, tmp_path / "none" / "report.html")
    assert not (tmp_path / "none").exists()


def test_a_damaged_product(measured_wave, tmp_path):
    damaged = tmp_path / "damaged.nc"
    shutil.copy(measured_wave.product, damaged)
    with damaged.open("r+b") as stream:
        stream.truncate(damaged.stat().st_size // 2)
    with pytest.raises(StoreError, match="cannot be read"):
        collect(damaged)


@pytest.mark.parametrize(
    "value", ["", "[]", "null", '{"a": ', "<b>", '{"kind": "thermacq world frame"}', 7.5]
)
def test_hostile_attributes_cost_only_their_part(measured_wave, tmp_path, value):
    product = tmp_path / "hostile.nc"
    shutil.copy(measured_wave.product, product)
    with h5py.File(product, "r+") as file:
        for name in list(file.attrs):
            if not name.startswith("_") and name not in ("run_id", "Conventions"):
                file.attrs[name] = value
    page = tmp_path / "report.html"
    notes = write_report(product, page, run=measured_wave.run)
    assert any("frames and disparity are not shown" in note for note in notes)
    assert "stereo / probe P1" in page.read_text(encoding="utf-8")
    assert "<b>" not in page.read_text(encoding="utf-8").split("RMSE")[-1]


def test_a_damaged_world_frame_costs_the_quantisation_error(measured_wave, tmp_path):
    product = tmp_path / "frameless.nc"
    shutil.copy(measured_wave.product, product)
    with h5py.File(product, "r+") as file:
        file.attrs["world_frame"] = "{}"
    data = collect(product, run=measured_wave.run)
    assert data.quantisation is None
    assert data.sample is not None
    assert any(note.startswith("no quantisation error") for note in data.notes)
