from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from pydantic import BaseModel

from thermacq import plugins as plugin_module
from thermacq.devices import FrameFlag
from thermacq.errors import CorrectionError, PluginError
from thermacq.hooks import CorrectionStage
from thermacq.imaging import (
    NO_CORRECTIONS,
    CorrectedPictures,
    Corrections,
    Stage,
    corrections_of,
    doubts,
)
from thermacq.store import open_run
from thermacq_calibration import CameraCorrection, Corrector


def correction(serial="SN1", camera="left", shape=(48, 64), seed=0):
    random = np.random.default_rng(seed)
    bad = np.zeros(shape, np.uint8)
    bad[3, 4] = 1
    return CameraCorrection(
        serial,
        camera,
        (1 + 0.1 * random.random(shape)).astype(np.float32),
        random.normal(0, 50, shape).astype(np.float32),
        bad,
        shading=random.normal(0, 5, shape).astype(np.float32),
        created="2026-01-01T00:00:00+00:00",
    )


@pytest.fixture
def both():
    return {"left": correction(), "right": correction("SN2", "right", seed=1)}


def test_without_any_the_raw_counts_come_back(write_run):
    with open_run(write_run(295.0, frames=2)) as run:
        corrections = corrections_of(run)
        picture = CorrectedPictures(run, "left", corrections).read(1)
        assert picture.dtype == np.uint16
        assert np.array_equal(picture, run.counts("left", 1))
        assert corrections.provenance() == {"from": "none", "cameras": {}, "stages": []}


def test_those_stored_with_the_run_are_used_and_told(write_run, both):
    with open_run(write_run(295.0, frames=2, corrections=both, inside_k=304.0)) as run:
        corrections = corrections_of(run)
        picture = CorrectedPictures(run, "right", corrections).read(1)
        expected = Corrector(both["right"])(run.counts("right", 1), 304.0)
        assert np.array_equal(picture, expected)
        told = corrections.provenance()
        assert told["from"] == "run"
        assert told["cameras"]["left"]["sha256"] == both["left"].sha256
        assert told["cameras"]["left"]["stages"] == ["nonuniformity", "shading", "bad-pixels"]


def test_the_rig_chooses_the_stages(write_run, both):
    rig = {"correction": {"shading": False, "bad_pixels": False}}
    with open_run(write_run(295.0, frames=1, corrections=both, **rig)) as run:
        corrections = corrections_of(run)
        assert corrections.provenance()["cameras"]["left"]["stages"] == ["nonuniformity"]
        raw = run.counts("left", 0)
        assert np.allclose(
            CorrectedPictures(run, "left", corrections).read(0),
            both["left"].gain * raw + both["left"].offset,
            atol=1e-2,
        )
    none = {"correction": {"shading": False, "bad_pixels": False, "nonuniformity": False}}
    with open_run(write_run(295.0, frames=1, corrections=both, **none)) as run:
        assert corrections_of(run).provenance() == NO_CORRECTIONS.provenance()


def test_none_can_be_asked_for(write_run, both):
    with open_run(write_run(295.0, frames=1, corrections=both)) as run:
        assert corrections_of(run, use=False) == NO_CORRECTIONS


def test_files_go_to_the_camera_of_their_serial_number(write_run, tmp_path, both):
    file = tmp_path / "x.correction.h5"
    # Its name in the rig may have changed since.
    replace(both["left"], serial="SN2").save(file)
    with open_run(write_run(295.0, frames=1, corrections=both)) as run:
        corrections = corrections_of(run, [file])
        assert set(corrections.cameras) == {"right"}
        assert corrections.provenance()["from"] == "files"
        with pytest.raises(CorrectionError, match="two corrections were given"):
            corrections_of(run, [file, file])


def test_files_of_other_cameras_or_sizes_are_refused(write_run, tmp_path):
    other, small = tmp_path / "other.correction.h5", tmp_path / "small.correction.h5"
    correction("SN9").save(other)
    correction(shape=(24, 32)).save(small)
    with open_run(write_run(295.0, frames=1)) as run:
        with pytest.raises(CorrectionError, match="camera SN9, which did not take part"):
            corrections_of(run, [other])
        with pytest.raises(CorrectionError, match="32 x 24 pixels"):
            corrections_of(run, [small])


def test_a_stored_correction_of_another_camera_is_refused(write_run, both):
    path = write_run(295.0, frames=1, corrections={"left": both["right"]})
    with open_run(path) as run, pytest.raises(CorrectionError, match="that of camera SN2"):
        corrections_of(run)


def test_corrections_travel_to_worker_processes(both):
    corrections = Corrections(both, "files", stages=(Stage("x", {"a": 1}),))
    assert pickle.loads(pickle.dumps(corrections)).provenance() == corrections.provenance()


class _Settings(BaseModel):
    length: int = 3


class _MeanOfPast:
    """Adds the mean of the first pixel of the pictures before: as history-dependent as a stage can be."""

    def __init__(self, settings):
        self.length, self.past = settings.length, []

    def __call__(self, picture):
        self.past = [*self.past, float(picture[0, 0])][-self.length - 1 :]
        return np.float32(np.mean(self.past)) + 0 * picture


@pytest.fixture
def stage(monkeypatch):
    """A stage with a memory in place of all others."""
    made = CorrectionStage(
        "past", "", lambda: _Settings, _MeanOfPast, memory=lambda settings: settings.length
    )
    known = plugin_module.plugins()
    monkeypatch.setattr(type(known), "correction_stages", lambda _self: {"past": made})
    return made


def test_a_stage_with_memory_does_not_depend_on_where_reading_began(write_run, stage):
    rig = {"correction": {"stages": [{"name": "past"}]}}
    path = write_run(
        295.0,
        frames=12,
        flags=lambda index: FrameFlag.SHUTTER if index == 5 else FrameFlag.NONE,
        **rig,
    )
    good = [index for index in range(12) if index != 5]
    with open_run(path) as run:
        corrections = corrections_of(run)
        assert corrections.provenance()["stages"] == [{"name": "past", "settings": {"length": 3}}]
        in_order = CorrectedPictures(run, "left", corrections)
        forwards = {index: in_order.read(index)[0, 0] for index in good}
        first = {index: float(run.counts("left", index)[0, 0]) for index in good}
        for place, index in enumerate(good):
            expected = np.mean([first[one] for one in good[max(0, place - 3) : place + 1]])
            assert forwards[index] == pytest.approx(expected, abs=1e-2)
        backwards = CorrectedPictures(run, "left", corrections)
        assert {index: backwards.read(index)[0, 0] for index in reversed(good)} == forwards


def test_unknown_stages_and_settings_are_refused(write_run, stage):
    for table, error in (
        ({"name": "no such"}, PluginError),
        ({"name": "past", "settings": {"length": "long"}}, CorrectionError),
    ):
        path = write_run(295.0, frames=1, correction={"stages": [table]})
        with open_run(path) as run, pytest.raises(error):
            corrections_of(run)


def test_what_makes_a_correction_doubtful_is_told(write_run, both):
    kept = {name: replace(one, fpa_temperature_k=305.0) for name, one in both.items()}
    names = ("left", "right")
    with open_run(write_run(295.0, frames=4, corrections=kept, inside_k=305.3)) as run:
        assert doubts(run, names, corrections_of(run)) == ()
    half = {"left": kept["left"]}
    path = write_run(
        295.0,
        frames=9,
        corrections=half,
        inside_k=302.0,
        flags=lambda index: FrameFlag.SHUTTER if index in (0, 4, 5) else FrameFlag.NONE,
    )
    with open_run(path) as run:
        one_sided, shutter, colder = doubts(run, names, corrections_of(run))
        assert "camera 'right' has no correction" in one_sided
        assert "closed its shutter 2 times" in shutter
        assert "-3.0 K" in colder
        assert doubts(run, names, corrections_of(run, use=False)) == ()
