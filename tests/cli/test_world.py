"""``world`` and ``fuse`` as a user runs them."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from thermacq.cli.app import app
from thermacq.reconstruction import WorldFrame, load_world_frame, open_product
from thermacq.reconstruction.product import ProductWriter
from thermacq.store import CameraStream, RunHeader, RunWriter, open_run
from thermacq_calibration import Board, BoardKind, CameraModel, StereoCalibration

SIMULATED = """
view = "chessboard"
seed = 3
[chessboard]
columns = 9
rows = 6
square_m = 0.036
frames_per_view = 1
place_m = [0.42, -0.03, -0.12]
largest_tilt_deg = 10
"""


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


def failure(*words):
    result = run(*words)
    assert result.exit_code != 0
    assert hasattr(result.exception, "what"), result.output
    return result.exception.what


@pytest.fixture
def rectified(tmp_path):
    record = StereoCalibration.from_rectified((640, 512), 706.0, (319.5, 255.5), 0.06)
    record.save(tmp_path / "cal.json")
    return record


@pytest.fixture
def world(tmp_path, rectified):
    tilt = np.radians(22.8)
    rotation = np.array([[0, -np.cos(tilt), np.sin(tilt)], [-1, 0, 0], [0, -np.sin(tilt), -np.cos(tilt)]])
    source = {"calibration_sha256": rectified.sha256}
    frame = WorldFrame(rotation, np.array([0, 0, 0.6]), 4e-4, 1e-4, 1e-10 * np.eye(3), 99, 9, source)
    frame.save(tmp_path / "w.json")
    return tmp_path / "w.json"


def wave_product(path, frame, cameras, x_range, angle_deg=20.0):
    x, y = np.round(np.arange(*x_range, 0.01), 9), np.round(np.arange(-0.15, 0.15, 0.01), 9)
    t, angle = np.arange(40) * 0.05, np.radians(angle_deg)
    along = x * np.cos(angle) + y[:, None] * np.sin(angle)
    eta = 0.02 * np.cos(2 * np.pi * (along / 0.97 - t[:, None, None] / 0.8))
    attributes = {"run_id": "r", "cameras": cameras, "world_frame": frame.to_dict()}
    from thermacq.reconstruction import Grid

    with ProductWriter(path, Grid(x, y, 0.01), t, attributes, HEADER) as product:
        product.append(
            eta.astype(np.float32), np.full(eta.shape, 9, np.int32), np.zeros(eta.shape, np.float32)
        )
    return path


HEADER = RunHeader("r", "", "2026-01-01T00:00:00Z", 0, 0, "virtual", True, {}, None)


def test_the_x_axis_from_marks_pixels_and_waves(world, tmp_path):
    result = run("world", "x-axis", world, "--marks", "0,0,0.3,0.3", "-o", tmp_path / "m.json")
    assert result.exit_code == 0, result.output
    assert "X turned by +45.000°" in result.stdout
    marked = load_world_frame(tmp_path / "m.json")
    np.testing.assert_allclose(
        marked.rotation[0] @ load_world_frame(world).rotation.T, [0.5**0.5, 0.5**0.5, 0], atol=1e-9
    )
    words = (
        "--pixels",
        "319.5,400,319.5,100",
        "-c",
        tmp_path / "cal.json",
        "--json",
        "-o",
        tmp_path / "p.json",
    )
    straight = run("world", "x-axis", world, *words)
    assert straight.exit_code == 0, straight.output
    # Both marks lie on the middle column, which looks along X already.
    assert abs(json.loads(straight.stdout)["turned_by_deg"]) < 1e-6
    product = wave_product(tmp_path / "eta.nc", load_world_frame(world), "a,b", (0.1, 0.6))
    words = ("--waves", product, "--json", "-o", tmp_path / "v.json")
    values = json.loads(run("world", "x-axis", world, *words).stdout)
    assert values["turned_by_deg"] == pytest.approx(20.0, abs=0.3)
    assert 0 < values["x_axis_u_deg"] < 5
    assert "another world frame" in failure(
        "world", "x-axis", tmp_path / "m.json", "--waves", product, "-o", tmp_path / "n.json"
    )


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--marks", "0,0,1,1", "--pixels", "1,2,3,4"),
        ("--marks", "0,0,1"),
        ("--marks", "0,0,1,nan"),
        ("--pixels", "1,2,3,4"),
    ],
)
def test_wrong_words_are_explained(world, tmp_path, words):
    result = run("world", "x-axis", world, *words, "-o", tmp_path / "n.json")
    assert result.exit_code == 2
    assert not (tmp_path / "n.json").exists()


def test_files_that_exist_or_do_not_belong_are_refused(world, tmp_path):
    assert "exists" in failure("world", "x-axis", world, "--marks", "0,0,1,1", "-o", world)
    StereoCalibration.from_rectified((640, 512), 700.0, (319.5, 255.5), 0.06).save(tmp_path / "other.json")
    words = ("--pixels", "1,400,3,300", "-c", tmp_path / "other.json", "-o", tmp_path / "n.json")
    assert "another calibration" in failure("world", "x-axis", world, *words)
    words = ("-w", world, "-c", tmp_path / "cal.json", "--pair", "a", "-o", tmp_path / "n.json")
    assert run("world", "join-by-board", tmp_path / "run.h5", *words).exit_code == 2


def test_the_board_is_looked_for_as_the_rig_describes_it(world, tmp_path, monkeypatch):
    path, looked_for = tmp_path / "board.h5", []
    board = {"columns": 7, "rows": 6, "square_m": 0.02, "kind": "charuco", "marker_m": 0.01}
    board["dictionary"] = "DICT_4X4_50"
    rig = {"cameras": {name: {"driver": "x"} for name in ("left", "right")}, "board": board}
    header = RunHeader("1", "board", "2026-01-01T00:00:00+00:00", 0, 0, "virtual", True, rig)
    with RunWriter.create(path, header, [CameraStream(name, 64, 64) for name in ("left", "right")]) as writer:
        writer.finish({}, "done")

    def board_corners(_run, board, *_rest):
        looked_for.append(board)
        return []

    monkeypatch.setattr("thermacq.reconstruction.shared_board.board_corners", board_corners)
    words = ("--board", path, "-c", tmp_path / "cal.json", "-o", tmp_path / "n.json", "--columns", 5)
    assert "in no view" in failure("world", "x-axis", world, *words)
    assert looked_for == [Board(5, 6, 0.02, BoardKind.CHARUCO, 0.01, "DICT_4X4_50")]


def test_fuse_tells_the_overlap(world, tmp_path):
    frame = load_world_frame(world)
    first = wave_product(tmp_path / "a.nc", frame, "a,b", (0.1, 0.6))
    second = wave_product(tmp_path / "b.nc", frame, "c,d", (0.4, 0.9))
    result = run("fuse", first, second, "-o", tmp_path / "c.nc")
    assert result.exit_code == 0, result.output
    assert "overlap of 600 cells: first less second" in result.stdout
    assert "one world frame" in result.stderr
    values = json.loads(run("fuse", first, second, "-o", tmp_path / "d.nc", "--json").stdout)
    assert values["overlap"]["sigma_m"] < 1e-6
    assert values["cells"] == [30, 80]
    with open_product(tmp_path / "c.nc") as product:
        assert product.sizes["x"] == 80
    assert "same cameras" in failure("fuse", first, first, "-o", tmp_path / "e.nc")
    assert "no product" in failure("fuse", first, tmp_path / "none.nc", "-o", tmp_path / "e.nc")
    words = ("--near", "0,0,0", "-o", tmp_path / "j.json")
    assert "leave the place" in failure("world", "join-by-water", first, second, *words)


def true_pair(path, pair):
    """Calibration and pose of a simulated pair as they really are."""
    from thermacq_drivers.simflume import truth

    with open_run(path) as opened:
        cameras = truth.simulated_cameras(opened.header.rig)
    facts = truth.calibration_facts(*truth.stereo_pair(truth.of_pair(cameras, pair)))
    models = [
        CameraModel(np.array(facts[side]["matrix"]), np.array(facts[side]["distortion"]))
        for side in ("left", "right")
    ]
    rotation, translation = np.array(facts["rotation"]), np.array(facts["translation_m"])
    return StereoCalibration(tuple(facts["image_size"]), *models, rotation, translation), facts


@pytest.mark.slow
def test_simulated_pairs_are_joined_by_a_board_that_both_see(tmp_path):
    """Four simulated cameras and a board between the pairs: the second pair is found within 3 mm."""
    from thermacq_calibration import rectify
    from thermacq_drivers.simflume.ready_made import rig_toml

    (tmp_path / "scene.toml").write_text(SIMULATED)
    recording = tmp_path / "board.h5"
    # A quarter of the pixels.
    small = re.sub(
        r"\nside = .*", r"\g<0>\nrows = 256\ncolumns = 320\npixel_pitch_um = 34", rig_toml("two-pairs")
    )
    (tmp_path / "rig.toml").write_text(small)
    command = [
        sys.executable,
        "-m",
        "thermacq",
        "simulate",
        "scene.toml",
        "--rig",
        "rig.toml",
        "--frames",
        "8",
    ]
    subprocess.run([*command, "-o", recording], cwd=tmp_path, check=True, capture_output=True)
    words = []
    for pair in ("upstream", "downstream"):
        calibration, facts = true_pair(recording, pair)
        calibration.save(tmp_path / f"{pair}.json")
        pose = facts["left_camera_to_world"]
        rotation = np.array(pose["rotation"]) @ rectify(calibration).rotation_left.T
        frame = WorldFrame(
            rotation if pair == "upstream" else np.diag([-1.0, -1.0, 1.0]) @ rotation,
            np.array([0.0, 0.0, pose["translation_m"][2]]),
            4e-4,
            2e-4,
            1e-10 * np.eye(3),
            99,
            9,
            {"calibration_sha256": calibration.sha256},
        )
        frame.save(tmp_path / f"w_{pair}.json")
        words += ["-w", tmp_path / f"w_{pair}.json", "-c", tmp_path / f"{pair}.json", "--pair", pair]
    output = tmp_path / "joined.json"
    result = run("world", "join-by-board", recording, *words, "--frames-per-view", 1, "-o", output)
    assert result.exit_code == 0, result.output
    joined = load_world_frame(output)
    # The second frame was turned round beforehand; its X points along the first one's again.
    np.testing.assert_allclose(joined.translation_m, [0.84, -0.06, 0.6], atol=3e-3)
    np.testing.assert_allclose(joined.rotation, rotation, atol=2e-3)
    place = joined.source["joined"]
    # Squares of 17 px: corners are off alike in all views, which no scatter shows.
    assert 0 < place["x_u_m"] < 3e-3
    assert place["views"] >= 5
