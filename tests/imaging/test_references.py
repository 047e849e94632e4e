from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thermacq.devices import FrameFlag
from thermacq.errors import CorrectionError
from thermacq.imaging.references import Reference, middle_time, parse_reference, views_of
from thermacq_calibration import CalibrationError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.h5", Reference(Path("a.h5"))),
        ("a.h5@293.15", Reference(Path("a.h5"), 293.15)),
        ("a.h5@293.15@3:7", Reference(Path("a.h5"), 293.15, 3, 7)),
        ("a.h5@@3:", Reference(Path("a.h5"), None, 3, None)),
        ("at@home/a.h5@300", Reference(Path("at@home/a.h5"), 300.0)),
    ],
)
def test_a_reference_is_read(text, expected):
    assert parse_reference(text) == expected


@pytest.mark.parametrize("text", ["a.h5@20", "a.h5@warm", "a.h5@300@5", "a.h5@300@-3:x", "a.h5@300@-3:5"])
def test_what_is_no_reference_is_refused(text):
    with pytest.raises(CorrectionError):
        parse_reference(text)


def test_a_file_whose_name_looks_like_one_is_taken_as_it_is(tmp_path):
    path = tmp_path / "a@300"
    path.touch()
    assert parse_reference(str(path)) == Reference(path)


def test_a_view_has_mean_temperature_and_focal_plane(write_run, sensors):
    path = write_run(295.0, frames=40, inside_k=304.5)
    view = views_of(Reference(path, 295.0))["left"]
    assert view.frames == pytest.approx(40, abs=1)
    assert view.temperature_k == 295.0
    assert view.fpa_temperature_k == pytest.approx(304.5)
    assert np.abs(view.mean - 6000 - sensors["left"].offset).max() < 5 * 3.5 / 40**0.5 + 0.5


def test_frames_behind_the_shutter_and_broken_ones_do_not_count(write_run):
    def shown(_camera, index):
        return 500.0 if index % 4 == 0 else 295.0

    path = write_run(
        shown, frames=64, flags=lambda index: FrameFlag.SHUTTER if index % 4 == 0 else FrameFlag.NONE
    )
    view = views_of(Reference(path))["right"]
    assert float(np.median(view.mean)) == pytest.approx(6000, abs=40)


def test_a_simulated_blackbody_knows_its_steps(write_run):
    steps = (290.0, 300.0)
    path = write_run(
        lambda _camera, index: steps[index // 40],
        frames=80,
        scene={"view": "uniform", "uniform": {"temperatures_k": list(steps), "frames_per_temperature": 40}},
    )
    warm = views_of(Reference(path, 300.0))["left"]
    assert warm.temperature_k == 300.0
    assert warm.frames == pytest.approx(30, abs=1)
    with pytest.raises(CorrectionError, match="290, 300 K one after the other"):
        views_of(Reference(path))
    with pytest.raises(CorrectionError, match="never has 295 K"):
        views_of(Reference(path, 295.0))
    # Within one step the temperature is known without being said.
    assert views_of(Reference(path, None, 0, 40))["left"].temperature_k == 290.0


@pytest.mark.parametrize("value", [0, 16383])
def test_a_constant_view_is_refused(write_run, value):
    path = write_run(lambda _camera, _index: np.full((48, 64), value, np.uint16))
    with pytest.raises(CalibrationError, match=f"constant: 100% of the pixels have the count {value}"):
        views_of(Reference(path))


def test_a_range_without_frames_is_refused(write_run):
    with pytest.raises(CorrectionError, match="no good frames"):
        views_of(Reference(write_run(295.0), None, 100, 200))


def test_the_middle_of_the_frames_in_wall_clock_time(write_run):
    path = write_run(295.0, frames=101, start_s=3600.0)
    assert middle_time(Reference(path)) == "2026-01-02T04:04:06+00:00"
