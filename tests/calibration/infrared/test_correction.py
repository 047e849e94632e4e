"""The correction record: round trip, hash, and what foreign, damaged or altered files lead to."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermacq_calibration import CalibrationError, CameraCorrection, load_correction

SHAPE = (12, 16)


def make(**changes) -> CameraCorrection:
    random = np.random.default_rng(1)
    values = {
        "serial": "SIM-1",
        "camera": "left",
        "gain": random.normal(1, 0.03, SHAPE),
        "offset": random.normal(0, 50, SHAPE),
        "bad_pixels": (random.random(SHAPE) < 0.05) * 5,
        "shading": random.normal(0, 3, SHAPE),
        "shading_temperature_k": 306.0,
        "shading_zero_k": 303.0,
        "counts_per_kelvin": 99.5,
        "kelvin_at_zero": 235.0,
        "netd_k": 0.035,
        "made_from": {"views": [{"temperature_k": 290.0, "frames": 64}]},
        "fpa_temperature_k": 303.0,
        "created": "2026-01-01T00:00:00+00:00",
    }
    return CameraCorrection(**{**values, **changes})


def test_round_trip_through_a_file_keeps_everything(tmp_path):
    path = tmp_path / "left.correction.h5"
    record = make()
    record.save(path)
    again = load_correction(path)
    assert again.sha256 == record.sha256
    assert again.made_from == record.made_from
    assert (again.serial, again.camera, again.netd_k) == ("SIM-1", "left", 0.035)
    assert again.shutter is None
    for name in ("gain", "offset", "bad_pixels", "shading"):
        np.testing.assert_array_equal(getattr(again, name), getattr(record, name))


def test_a_run_file_can_hold_records_of_several_cameras(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name in ("left", "right"):
            make(camera=name, shading=None, shading_temperature_k=None, shading_zero_k=None).to_group(
                file.create_group(f"corrections/{name}")
            )
        assert CameraCorrection.from_group(file["corrections/right"]).camera == "right"
        assert CameraCorrection.from_group(file["corrections/left"]).shading is None


def test_every_part_is_in_the_hash():
    plain = make().sha256
    for change in (
        {"offset": make().offset + 1e-3},
        {"bad_pixels": np.zeros(SHAPE)},
        {"shading": None},
        {"shutter": make().offset},
        {"netd_k": 0.036},
        {"made_from": {}},
    ):
        assert make(**change).sha256 != plain
    assert make().sha256 == plain


def test_arrays_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        make().gain[0, 0] = 2


def test_shading_grows_linearly_from_where_it_vanishes():
    record = make()
    assert record.shading_factor(306.0) == pytest.approx(1)
    assert record.shading_factor(303.0) == pytest.approx(0)
    assert record.shading_factor(309.0) == pytest.approx(2)
    assert record.shading_factor(float("nan")) == 1
    assert make(shading_zero_k=None).shading_factor(320.0) == 1


def test_counts_become_kelvin_by_the_scale():
    kelvin = make().to_kelvin(np.full(SHAPE, 5970.0, np.float32))
    np.testing.assert_allclose(kelvin, 235 + 5970 / 99.5, rtol=1e-6)
    with pytest.raises(CalibrationError, match="does not know counts per kelvin"):
        make(counts_per_kelvin=None, kelvin_at_zero=None).to_kelvin(np.zeros(SHAPE, np.float32))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gain": np.zeros(SHAPE)}, "positive numbers"),
        ({"gain": np.ones(4)}, "must be a picture"),
        ({"offset": np.full(SHAPE, np.nan)}, "offset of a correction is not finite"),
        ({"offset": np.zeros((12, 17))}, "size"),
        ({"bad_pixels": np.zeros((3, 3))}, "size"),
        ({"netd_k": float("inf")}, "not finite"),
        ({"kelvin_at_zero": None}, "needs both"),
        ({"shading_temperature_k": None}, "needs the one it was seen at"),
        ({"shading_zero_k": 306.02}, "too near"),
        ({"made_from": {"x": float("nan")}}, "plain, finite"),
        ({"made_from": {"x": np.ones(2)}}, "plain, finite"),
    ],
)
def test_what_makes_no_sense_is_refused(changes, message):
    with pytest.raises(CalibrationError, match=message):
        make(**changes)


def test_an_existing_file_is_not_touched(tmp_path):
    path = tmp_path / "kept.h5"
    path.write_text("mine")
    with pytest.raises(CalibrationError, match="exists already"):
        make().save(path)
    assert path.read_text() == "mine"
    with pytest.raises(CalibrationError, match="cannot be written: No such"):
        make().save(tmp_path / "nowhere" / "x.h5")


def test_a_missing_or_foreign_file_is_named(tmp_path):
    with pytest.raises(CalibrationError, match="there is no file"):
        load_correction(tmp_path / "none.h5")
    foreign = tmp_path / "text.h5"
    foreign.write_text("hello")
    with pytest.raises(CalibrationError, match=r"text\.h5' is no camera correction"):
        load_correction(foreign)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = np.ones(3)
    with pytest.raises(CalibrationError, match="'record' is missing"):
        load_correction(tmp_path / "other.h5")
    with pytest.raises(CalibrationError, match="Is a directory"):
        load_correction(tmp_path)


def test_altered_arrays_and_links_are_refused(tmp_path):
    path = tmp_path / "c.h5"
    make().save(path)
    with h5py.File(path, "r+") as file:
        file["gain"][3, 4] *= 1.001
    with pytest.raises(CalibrationError, match="altered after it was made"):
        load_correction(path)
    with h5py.File(path, "r+") as file:
        del file["gain"]
        file["gain"] = h5py.ExternalLink("elsewhere.h5", "gain")
    with pytest.raises(CalibrationError, match="'gain' is missing"):
        load_correction(path)


def test_a_picture_that_claims_a_huge_size_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "c.h5"
    make().save(path)
    with h5py.File(path, "r+") as file:
        text = bytes(file["record"][()]).replace(b'"rows":12', b'"rows":10000000')
        del file["record"]
        file["record"] = np.bytes_(text)
    with pytest.raises(CalibrationError, match="cannot have 10000000 x 16 pixels"):
        load_correction(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0, 1, exclude_max=True), length=st.integers(1, 40), byte=st.integers(0, 255))
def test_a_damaged_file_is_refused_or_reads_as_written(tmp_path, place, length, byte):
    path = tmp_path / "whole.h5"
    if not path.exists():
        make().save(path)
    content = bytearray(path.read_bytes())
    first = int(place * len(content))
    content[first : first + length] = bytes([byte]) * len(content[first : first + length])
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(content)
    try:
        again = load_correction(damaged)
    except CalibrationError:
        return
    assert again.sha256 == make().sha256
