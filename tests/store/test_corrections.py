"""Corrections of cameras in run files: kept whole, checked, copied, and never in the way of the raw counts."""

from __future__ import annotations

from dataclasses import replace

import h5py
import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.store import CameraStream, RunWriter, open_run, recover, verify
from thermacq_calibration import CameraCorrection

PLACE = "entry/thermacq/corrections"


@pytest.fixture
def correction():
    random = np.random.default_rng(0)
    return CameraCorrection(
        "SN1",
        "left",
        (1 + random.random((6, 8))).astype(np.float32),
        random.random((6, 8)).astype(np.float32),
        np.zeros((6, 8), np.uint8),
    )


@pytest.fixture
def corrected_run(tmp_path, header, correction):
    path = tmp_path / "corrected.h5"
    header = replace(header, calibration=None)
    with RunWriter.create(
        path, header, [CameraStream("left", 6, 8)], corrections={"left": correction}
    ) as run:
        run.finish({}, "done")
    return path


def test_they_come_back_as_they_were(corrected_run, correction):
    with open_run(corrected_run) as run:
        assert {name: one.sha256 for name, one in run.corrections().items()} == {"left": correction.sha256}
    assert verify(corrected_run).ok


def test_a_run_without_any_has_none(run_file):
    with open_run(run_file) as run:
        assert run.corrections() == {}
    with h5py.File(run_file) as file:
        assert PLACE not in file


def test_they_are_copied_by_recover(corrected_run, correction, tmp_path):
    report = recover(corrected_run, tmp_path / "clean.h5")
    assert report.lost_corrections == ""
    with open_run(tmp_path / "clean.h5") as run:
        assert run.corrections()["left"].sha256 == correction.sha256


def test_an_altered_one_is_refused_but_the_run_opens(corrected_run, tmp_path):
    with h5py.File(corrected_run, "r+") as file:
        file[f"{PLACE}/left/gain"][2, 3] += 0.01
    with open_run(corrected_run) as run, pytest.raises(StoreError, match="altered"):
        run.corrections()
    assert ["correction" in finding.what for finding in verify(corrected_run).findings] == [True]
    report = recover(corrected_run, tmp_path / "clean.h5")
    assert "altered" in report.lost_corrections
    with open_run(tmp_path / "clean.h5") as run:
        assert run.corrections() == {}
        assert "altered" in run.summary()["recovered"]["lost_corrections"]


def test_links_to_other_files_are_not_followed(corrected_run, tmp_path):
    other = tmp_path / "other.h5"
    other.write_bytes(corrected_run.read_bytes())
    with h5py.File(corrected_run, "r+") as file:
        del file[f"{PLACE}/left"]
        file[f"{PLACE}/left"] = h5py.ExternalLink(str(other), f"/{PLACE}/left")
    with open_run(corrected_run) as run, pytest.raises(StoreError):
        run.corrections()
