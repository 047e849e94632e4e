"""The calibration record: round trip, hash, and what foreign or altered files lead to."""

from __future__ import annotations

import copy
import hashlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_calibration import (
    Board,
    CalibrationError,
    CameraModel,
    StereoCalibration,
    ViewReport,
    load_calibration,
)

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


def record(**changes) -> StereoCalibration:
    camera = CameraModel(
        np.array([[705.9, 0, 320.1], [0, 706.2, 255.3], [0, 0, 1]]),
        np.array([-0.1, 0.05, 1e-4, 2e-4, 0]),
        0.14,
    )
    values = {
        "image_size": (640, 512),
        "left": camera,
        "right": camera,
        "rotation": np.eye(3),
        "translation_m": np.array([-0.06, 1e-4, -2e-4]),
        "rms_px": 0.19,
        "vertical_rms_px": 0.1,
        "held_out_vertical_rms_px": 0.12,
        "coverage": (0.9, 0.85),
        "board": Board(9, 6, 0.05),
        "views": (ViewReport("01", True, left_rms_px=0.1), ViewReport("02", False, "too blurred")),
        "uncertainty": {"baseline_m": 2e-5},
        "source": "folder",
        "created": "2026-01-01T00:00:00+00:00",
    }
    return StereoCalibration(**{**values, **changes})


def test_round_trip_through_a_file_keeps_everything(tmp_path):
    path = tmp_path / "cal.json"
    record().save(path)
    again = load_calibration(path)
    assert again.to_dict() == record().to_dict()
    assert again.sha256 == record().sha256
    assert again.views == record().views
    np.testing.assert_array_equal(again.left.matrix, record().left.matrix)


def test_hash_names_the_content_not_the_layout(tmp_path):
    path = tmp_path / "cal.json"
    values = record().to_dict()
    path.write_text(json.dumps(dict(reversed(values.items())), indent=7))
    assert load_calibration(path).sha256 == record().sha256
    assert record(rms_px=0.1900001).sha256 != record().sha256


def leaves(value, place=()):
    """Places of all numbers, texts and flags of nested JSON."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if not isinstance(value, dict | list):
        yield place
    for key, inner in items:
        yield from leaves(inner, (*place, key))


@pytest.mark.parametrize("place", list(leaves(record().to_dict())), ids=str)
def test_every_altered_value_is_noticed(place):
    values = copy.deepcopy(record().to_dict())
    parent = values
    for key in place[:-1]:
        parent = parent[key]
    old = parent[place[-1]]
    parent[place[-1]] = {str: "x", bool: True, int: 3, float: 0.3, type(None): 0.3}[type(old)]
    if old != parent[place[-1]]:
        with pytest.raises(CalibrationError):
            StereoCalibration.from_dict(values)


@pytest.mark.parametrize("extra", [{"comment": "mine"}, {"sha256": None}])
def test_added_and_missing_values_are_noticed(extra):
    with pytest.raises(CalibrationError, match="altered"):
        StereoCalibration.from_dict({**record().to_dict(), **extra})


@given(JSON)
def test_foreign_json_is_refused(values):
    with pytest.raises(CalibrationError):
        StereoCalibration.from_dict(values)


@pytest.mark.parametrize("key", ["corners", "uncertainty", "distortion"])
def test_numbers_that_are_not_finite_are_refused_however_deep(key):
    with pytest.raises(CalibrationError):
        StereoCalibration.from_dict({**record().to_dict(), key: {"": float("inf")}})


@given(st.data())
def test_a_record_with_one_hostile_value_is_refused(data):
    values = record().to_dict()
    key = data.draw(st.sampled_from(sorted(values)))
    hostile = data.draw(JSON)
    if json.dumps(hostile) != json.dumps(values[key]):
        with pytest.raises(CalibrationError):
            StereoCalibration.from_dict({**values, key: hostile})


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", '{"format": NaN}', "[" * 100_000, '{"format": "thermacq-stereo-calibration"}'],
    ids=["empty", "cut off", "list", "null", "nan", "deep", "no version"],
)
def test_files_that_are_no_record_are_named(tmp_path, text):
    path = tmp_path / "foreign.json"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=r"foreign\.json"):
        load_calibration(path)


def test_binary_missing_and_huge_files_are_explained(tmp_path):
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    with pytest.raises(CalibrationError, match="not text"):
        load_calibration(tmp_path / "binary")
    with pytest.raises(CalibrationError, match="there is no file"):
        load_calibration(tmp_path / "missing")
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(1 << 25)
    with pytest.raises(CalibrationError, match="too large"):
        load_calibration(tmp_path / "huge")
    with pytest.raises(CalibrationError, match="cannot be read"):
        load_calibration(tmp_path)


def test_numbers_beyond_float_are_refused(tmp_path):
    path = tmp_path / "cal.json"
    path.write_text(json.dumps(record().to_dict()).replace("705.9", "9" * 400))
    with pytest.raises(CalibrationError):
        load_calibration(path)


def test_an_existing_file_is_not_touched(tmp_path):
    path = tmp_path / "cal.json"
    path.write_text("precious")
    with pytest.raises(CalibrationError, match="exists already"):
        record().save(path)
    assert path.read_text() == "precious"
    with pytest.raises(CalibrationError, match="cannot be written"):
        record().save(tmp_path / "no folder" / "cal.json")


def test_a_full_disk_leaves_no_half_record(tmp_path, monkeypatch):
    class FullDisk(io.StringIO):
        def write(self, text):
            raise OSError(28, "No space left on device")

    def open_on_full_disk(path, *_, **__):
        path.touch()
        return FullDisk()

    monkeypatch.setattr(Path, "open", open_on_full_disk)
    with pytest.raises(CalibrationError, match="No space left"):
        record().save(tmp_path / "cal.json")
    assert list(tmp_path.iterdir()) == []


def test_a_record_cannot_be_changed():
    made = record()
    with pytest.raises(ValueError, match="read-only"):
        made.left.matrix[0, 0] = 1
    with pytest.raises(AttributeError):
        made.rms_px = 0.01  # type: ignore[misc]


@pytest.mark.parametrize(
    "changes",
    [
        {"rotation": np.eye(3) * 1.1},
        {"rotation": np.diag([1.0, 1, -1])},
        {"translation_m": np.zeros(3)},
        {"translation_m": np.array([np.nan, 0, 0])},
        {"image_size": (0, 512)},
    ],
)
def test_impossible_geometry_is_refused(changes):
    with pytest.raises(CalibrationError):
        record(**changes)


@pytest.mark.parametrize(
    ("matrix", "distortion"),
    [
        (np.eye(2), np.zeros(5)),
        (np.diag([-700.0, 700, 1]), np.zeros(5)),
        (np.diag([700.0, 700, 2]), np.zeros(5)),
        (np.diag([700.0, 700, 1]), np.zeros(3)),
        (np.diag([700.0, 700, 1]), np.full(5, np.inf)),
    ],
)
def test_impossible_cameras_are_refused(matrix, distortion):
    with pytest.raises(CalibrationError):
        CameraModel(matrix, distortion)


def test_given_geometry_of_middlebury():
    given_geometry = StereoCalibration.from_rectified(
        (741, 500), 994.978, (311.193, 254.877), 0.193001, 31.086
    )
    assert given_geometry.baseline_m == pytest.approx(0.193001)
    assert given_geometry.right.matrix[0, 2] - given_geometry.left.matrix[0, 2] == pytest.approx(31.086)
    assert given_geometry.rms_px is None


@pytest.mark.parametrize(("focal", "baseline"), [(0, 0.1), (-5, 0.1), (700, 0), (np.nan, 0.1), (700, np.inf)])
def test_impossible_given_geometry_is_refused(focal, baseline):
    with pytest.raises(CalibrationError, match="positive"):
        StereoCalibration.from_rectified((640, 512), focal, None, baseline)


def test_records_of_version_1_keep_their_hash():
    content = {
        "format": "thermacq-stereo-calibration",
        "version": 1,
        "image_size": [640, 512],
        "left": {
            "matrix": [[700.0, 0.0, 320.0], [0.0, 700.0, 256.0], [0.0, 0.0, 1.0]],
            "distortion": [0.0] * 5,
            "rms_px": 0.1,
        },
        "right": {
            "matrix": [[700.0, 0.0, 320.0], [0.0, 700.0, 256.0], [0.0, 0.0, 1.0]],
            "distortion": [0.1] * 5,
            "rms_px": 0.1,
        },
        "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "translation_m": [-0.06, 0.0, 0.0],
        "baseline_m": 0.06,
        "rms_px": 0.12,
        "vertical_rms_px": 0.1,
        "held_out_vertical_rms_px": 0.1,
        "coverage": [0.9, 0.8],
        "board": {"columns": 9, "rows": 6, "square_m": 0.05},
        "views": [],
        "uncertainty": None,
        "serials": None,
        "source": "board.h5",
        "created": "2026-01-01T00:00:00+00:00",
    }
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    old = StereoCalibration.from_dict(
        json.loads(text) | {"sha256": hashlib.sha256(text.encode()).hexdigest()}
    )
    assert old.version == 1
    assert old.poses is None
    assert old.standard_uncertainty("baseline_m") is None
