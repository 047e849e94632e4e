from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from thermacq.errors import PluginError, ReconstructionError, RigError
from thermacq.reconstruction import open_source, parse_settings
from thermacq.reconstruction.pairs import camera_sides, find_calibration, run_pairs, select_frames
from thermacq.rig import parse_rig
from thermacq.store import open_run


def test_pairs_have_the_time_of_their_trigger(still_run):
    with open_run(still_run) as run:
        pairs = run_pairs(run)
    assert (pairs.left_camera, pairs.right_camera) == ("left", "right")
    np.testing.assert_array_equal(pairs.left, np.arange(10))
    np.testing.assert_allclose(pairs.time_s, np.arange(10) * 0.02, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("2:5", [2, 3, 4]), (":2", [0, 1]), ("8:", [8, 9]), ("-1:", [9]), (None, range(10))],
)
def test_ranges_of_pairs(still_run, text, expected):
    with open_run(still_run) as run:
        assert list(select_frames(run_pairs(run), text).left) == list(expected)


@pytest.mark.parametrize("text", ["3", "a:b", "1:2:3", "20:30", "5:5"])
def test_impossible_ranges_are_refused(still_run, text):
    with open_run(still_run) as run, pytest.raises(ReconstructionError, match="range"):
        select_frames(run_pairs(run), text)


def test_a_run_without_pairs_is_refused(tmp_path, make_run, scene):
    path = make_run(tmp_path / "lonely.h5", scene(rows=64, columns=96), 2, lonely_right=True)
    with pytest.raises(ReconstructionError, match=r"no frames of .* belong together"):
        open_source(path)


def test_a_run_without_calibration_asks_for_one(tmp_path, make_run, scene):
    path = make_run(tmp_path / "bare.h5", scene(rows=64, columns=96), 1, calibration=False)
    with pytest.raises(ReconstructionError, match="holds no calibration") as caught:
        open_source(path)
    assert "--calibration" in caught.value.remedy


def test_the_calibration_of_another_rig_is_refused(tmp_path, still_run, scene):
    other = dataclasses.replace(scene(), columns=640, rows=512).calibration()
    other.save(tmp_path / "other.json")
    with (
        open_run(still_run) as run,
        pytest.raises(ReconstructionError, match=r"another rig.*640 x 512.*320 x 256"),
    ):
        find_calibration(run, tmp_path / "other.json")


@pytest.mark.parametrize(
    ("serials", "problem"),
    [(("right-1", "left-1"), "left and right exchanged"), (("left-1", "other"), "of other cameras")],
)
def test_the_calibration_of_other_cameras_is_refused(
    tmp_path, still_run, scene, monkeypatch, serials, problem
):
    monkeypatch.setattr("thermacq.reconstruction.pairs.camera_serials", lambda *_: ("left-1", "right-1"))
    calibration = scene().calibration()
    dataclasses.replace(calibration, serials=serials).save(tmp_path / "other.json")
    dataclasses.replace(calibration, serials=("left-1", "right-1")).save(tmp_path / "own.json")
    with open_run(still_run) as run:
        assert find_calibration(run, tmp_path / "own.json").serials == ("left-1", "right-1")
        with pytest.raises(ReconstructionError, match=problem):
            find_calibration(run, tmp_path / "other.json")


def test_the_range_of_disparity_is_found_from_the_run(still_run, scene):
    source = open_source(still_run)
    truth = scene().pair()[2]
    assert source.settings["min_disparity"] < truth.min() - 4
    assert source.settings["max_disparity"] > truth.max() + 4
    assert source.settings["max_disparity"] - source.settings["min_disparity"] < 60


def test_a_given_range_is_kept(still_run):
    source = open_source(still_run, settings={"min_disparity": -5, "max_disparity": 50})
    assert (source.settings["min_disparity"], source.settings["max_disparity"]) == (-5, 50)


def test_wrong_settings_and_matchers_are_named(still_run):
    with pytest.raises(ReconstructionError, match="block_size"):
        open_source(still_run, settings={"blok_size": 5})
    with pytest.raises(ReconstructionError, match="must be odd"):
        open_source(still_run, settings={"block_size": 4})
    with pytest.raises(PluginError, match="no matcher named 'sgmb'"):
        open_source(still_run, matcher="sgmb")


def test_settings_from_words():
    words = ["block_size=5", "refine=false", "mode=hh", "presmooth_px=0.5"]
    assert parse_settings(words) == {"block_size": 5, "refine": False, "mode": "hh", "presmooth_px": 0.5}
    with pytest.raises(ReconstructionError, match="no setting"):
        parse_settings(["block_size"])


def test_pictures_with_nothing_in_common_are_explained(tmp_path, make_run, scene):
    """Noise alone: a texture far below it."""
    path = make_run(tmp_path / "noise.h5", scene(texture_k=1e-4), 1)
    with pytest.raises(ReconstructionError, match="nearly nothing in common"):
        open_source(path)


def test_the_key_changes_with_the_settings_and_nothing_else(still_run):
    first, same = open_source(still_run), open_source(still_run)
    other = open_source(still_run, settings={"block_size": 5})
    assert first.key(first.pairs) == same.key(same.pairs)
    assert first.key(first.pairs) != other.key(other.pairs)
    assert first.key(first.pairs) != first.key(first.pairs.select(slice(0, 5)))


def test_a_pair_is_chosen_by_name_or_by_its_cameras(make_run, scene, tmp_path):
    """A run whose rig names its cameras in a pair, the other way round."""
    path = make_run(tmp_path / "run.h5", scene(rows=32, columns=48), 2)
    with open_run(path) as run:
        run.header.rig["pairs"] = {
            "usual": {"left": "left", "right": "right"},
            "crossed": {"left": "right", "right": "left"},
        }
        assert camera_sides(run) == ("left", "right")
        assert camera_sides(run, "crossed") == ("right", "left")
        assert camera_sides(run, "right, left") == ("right", "left")
        assert run_pairs(run, "crossed").left_camera == "right"
        for wrong in ("downstream", "left,left", "left,other", ""):
            with pytest.raises(ReconstructionError, match="usual, crossed"):
                camera_sides(run, wrong)


def test_a_pair_of_cameras_that_the_rig_lacks_is_refused():
    text = '[cameras.a]\ndriver = "x"\n[pairs.p]\nleft = "a"\nright = "b"\n'
    with pytest.raises(RigError, match="no camera 'b'"):
        parse_rig(text)
    with pytest.raises(RigError, match="are the same"):
        parse_rig(text.replace('"b"', '"a"'))
