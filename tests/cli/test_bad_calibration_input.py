"""Bad input of ``calibrate`` and of what uses a calibration: each is told plainly, and no record is left behind."""

from __future__ import annotations

import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from thermacq.cli import main
from thermacq.rig import Rig
from thermacq.store import CameraStream, FrameRow, RunHeader, RunWriter
from thermacq_calibration import StereoCalibration

BOARD = ["--columns", 9, "--rows", 6, "--square-m", 0.05]
SHAPE = (96, 128)


def write_run(path, counts, shape=SHAPE, serials=("SN1", "SN2"), **tables):
    """Run of two cameras and six pairs; `counts(side, index)`."""
    cameras = [
        CameraStream(name, *shape, identity={"serial": serial})
        for name, serial in zip(("left", "right"), serials, strict=True)
    ]
    rig = Rig.model_validate(
        {"cameras": {camera.name: {"driver": "test-pattern"} for camera in cameras}, **tables}
    )
    header = RunHeader(
        "id", "t", "2026-01-02T03:04:05+00:00", 10**18, 0, "virtual", True, rig.model_dump(mode="json")
    )
    with RunWriter.create(path, header, cameras) as writer:
        for index in range(6):
            for side, camera in enumerate(cameras):
                row = FrameRow(index, -1, 20_000_000 * index, trigger_index=index, trigger_ns=index)
                writer.append_frame(camera.name, counts(side, index), row)
        writer.finish({}, "done")


def texture(side, _index, shape=SHAPE):
    """The same texture in both pictures, 20 px apart."""
    picture = np.random.default_rng(3).normal(0, 1, (shape[0], shape[1] + 20))
    picture = cv2.GaussianBlur(picture, (0, 0), 1.5)[:, 20 * side : 20 * side + shape[1]]
    return (9000 + 800 * picture / picture.std()).astype(np.uint16)


@pytest.fixture(scope="module")
def files(tmp_path_factory, small_pair):
    """Good views, bad pictures, runs, and things that are neither."""
    folder = tmp_path_factory.mktemp("files")
    other = replace(small_pair, board=replace(small_pair.board, square_m=0.03))
    for name in ("good", "mixed", "sizes", "broken"):
        (folder / name).mkdir()
    for index, pose in enumerate(small_pair.poses(7, seed=3)):
        for side, picture in zip(("left", "right"), small_pair.pictures(pose, seed=index), strict=True):
            for name in ("good", "mixed", "sizes", "broken"):
                cv2.imwrite(str(folder / name / f"{side}{index}.png"), picture)
    for index, pose in enumerate(other.poses(2, seed=4), start=7):
        for side, picture in zip(("left", "right"), other.pictures(pose, seed=index), strict=True):
            cv2.imwrite(str(folder / "mixed" / f"{side}{index}.png"), picture)
    cv2.imwrite(str(folder / "sizes" / "right2.png"), np.zeros((100, 120), np.uint16))
    (folder / "broken" / "left0.png").write_bytes(b"no picture")
    (folder / "broken" / "left1.png").write_bytes(b"")
    board = cv2.imread(str(folder / "good" / "left0.png"), cv2.IMREAD_UNCHANGED)
    bad = {
        "saturated": np.full_like(board, 65535),
        "mostly-saturated": np.where(np.arange(board.shape[1]) % 4 > 0, 65535, board).astype(np.uint16),
        "constant": np.full_like(board, 8000),
        "nan": np.full(board.shape, np.nan, np.float32),
        "some-nan": np.where(np.arange(board.shape[1]) == 5, np.nan, board.astype(np.float32)),
    }
    for name, picture in bad.items():
        (folder / name).mkdir()
        for index in range(5):
            for side in ("left", "right"):
                cv2.imwrite(str(folder / name / f"{side}{index}.tiff"), picture)
    write_run(folder / "dark.h5", lambda _side, _index: np.full(SHAPE, 16383, np.uint16))
    write_run(folder / "water.h5", texture)
    write_run(folder / "others.h5", texture, serials=("SN7", "SN8"))
    write_run(folder / "exchanged.h5", texture, serials=("SN2", "SN1"))
    small = (64, 96)
    write_run(folder / "small.h5", lambda side, index: texture(side, index, small), small)
    made = StereoCalibration.from_rectified(SHAPE[::-1], 176.0, (63.5, 47.5), 0.06)
    replace(made, serials=("SN1", "SN2")).save(folder / "cal.json")
    (folder / "notes.txt").write_text("no record\n")
    (folder / "empty").mkdir()
    return folder


@pytest.fixture
def thermacq(monkeypatch, capsys, files):
    """Run a command in the folder; give exit status, stdout and stderr. Nothing may be left behind."""

    def run(*arguments):
        monkeypatch.chdir(files)
        monkeypatch.setenv("COLUMNS", "300")
        monkeypatch.setattr(sys, "argv", ["thermacq", *map(str, arguments)])
        before = set(files.iterdir())
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        err = " ".join(captured.err.split())
        assert "Traceback" not in err
        assert set(files.iterdir()) == before
        return ended.value.code or 0, " ".join(captured.out.split()), err

    return run


@pytest.mark.parametrize(
    ("folder", "reason"),
    [
        ("saturated", "the picture is constant: 100.0% of the pixels have the count 65535"),
        ("mostly-saturated", "saturated: 75% of the pixels have the largest count, 65535"),
        ("constant", "the picture is constant: 100.0% of the pixels have the count 8000"),
        ("nan", "100.0% of the pixels are not numbers"),
        ("some-nan", "0.3% of the pixels are not numbers"),
    ],
)
def test_pictures_that_can_hold_no_board(thermacq, folder, reason):
    code, out, err = thermacq("calibrate", folder, *BOARD, "-o", "new.json")
    assert code == 1
    assert out.count(reason) == 10
    assert "error: no plain chessboard of 9 x 6 inner corners was found in any of the 10 pictures" in err
    assert "No file was written." in err


def test_a_run_without_a_board(thermacq):
    code, out, err = thermacq("calibrate", "dark.h5", *BOARD, "--frames-per-view", 3, "-o", "new.json")
    assert code == 1
    assert "the picture is constant" in out
    assert "no plain chessboard" in err


def test_views_of_another_board_are_named(thermacq):
    code, _, err = thermacq("calibrate", "mixed", *BOARD, "--bootstrap", 0, "-o", "new.json")
    assert code == 1
    assert "views of another board are mixed in" in err
    assert "judged by the size of its squares: 7 (0." in err
    assert "No file was written." in err


def test_pictures_of_another_size(thermacq):
    code, _, err = thermacq("calibrate", "sizes", *BOARD, "-o", "new.json")
    assert code == 1
    assert "the pictures have different sizes: left 320 x 256, right 120 x 100, 320 x 256" in err


def test_damaged_pictures_are_named_and_the_rest_is_too_little(thermacq):
    few = [f"broken/{side}{index}.png" for side in ("left", "right") for index in range(5)]
    code, out, err = thermacq("calibrate", *few, *BOARD, "-o", "new.json")
    assert code == 1
    assert "'broken/left0.png' is no picture, or damaged" in out
    assert "'broken/left1.png' is no picture, or damaged" in out
    assert "only 3 of 5 views" in err


@pytest.mark.parametrize("square", [50, 23.9, 30])
def test_squares_in_millimetres(thermacq, square):
    code, _, err = thermacq(
        "calibrate", "good", "--columns", 9, "--rows", 6, "--square-m", square, "-o", "new.json"
    )
    assert code == 1
    assert "the side of a square is wanted in metres" in err
    assert f"If it is {square} mm, give {square / 1000:g}." in err


def test_squares_in_centimetres(thermacq):
    code, _, err = thermacq(
        "calibrate", "good", "--columns", 9, "--rows", 6, "--square-m", 5, "-o", "new.json"
    )
    assert code == 1
    assert "If it is 5 mm, give 0.005; if 5 cm, 0.05." in err


def test_squares_in_millimetres_in_a_rig(thermacq, files, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(
        '[cameras.left]\ndriver = "sim-camera"\n[cameras.right]\ndriver = "sim-camera"\n[board]\nsquare_m = 50\n'
    )
    code, _, err = thermacq("calibrate", rig, "-o", "new.json", "--record", "run.h5")
    assert code == 1
    assert "square_m" in err
    assert "metres" in err


@pytest.mark.parametrize("square", ["0", "-0.05", "nan"])
def test_squares_of_no_size(thermacq, square):
    code, _, err = thermacq(
        "calibrate", "good", "--columns", 9, "--rows", 6, "--square-m", square, "-o", "new.json"
    )
    assert code == 1
    assert "must be positive" in err


def test_exchanged_sides(thermacq):
    sides = ["--left", "good/right*.png", "--right", "good/left*.png"]
    code, _, err = thermacq("calibrate", *sides, *BOARD, "-o", "new.json")
    assert code == 1
    assert "left and right are exchanged: the right camera stands 6" in err
    assert "No file was written." in err


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["nothing.h5", *BOARD], 1, "there is no file or folder 'nothing.h5'"),
        (["notes.txt", *BOARD], 1, "is not an HDF5 file"),
        (["empty", *BOARD], 1, "there are no pictures in 'empty'"),
        (["good", "water.h5", *BOARD], 1, "several sources must all be pictures"),
        (["--left", "good/x*.png", "--right", "good/right*.png", *BOARD], 1, "there are 0 left and 7 right"),
        (["good"], 2, "give --columns, --rows and --square-m"),
        (["good", "--columns", 2, "--rows", 6, "--square-m", 0.05], 2, "--columns"),
        (["good", "--columns", 9, "--rows", 7, "--square-m", 0.05], 1, "looks the same after half a turn"),
        (["good", *BOARD, "--board", "marked"], 1, "there is no dictionary of markers ''"),
        (["good", *BOARD, "--board", "chess"], 2, "chess"),
        (["water.h5", *BOARD, "--pair", "upstream"], 1, "upstream"),
        (["good", *BOARD, "--report", "nowhere/page.html"], 1, "there is no folder 'nowhere'"),
    ],
)
def test_wrong_use_of_calibrate(thermacq, arguments, code, words):
    done, _, err = thermacq("calibrate", *arguments, "-o", "new.json")
    assert done == code
    assert words in err


@pytest.mark.parametrize(
    ("run", "words"),
    [
        ("others.h5", "SN7"),
        ("exchanged.h5", "SN2"),
        ("small.h5", "96 x 64"),
        ("notes.txt", "is not an HDF5 file"),
        ("empty", "there is no run file"),
    ],
)
@pytest.mark.parametrize("command", ["check", "still-water", "reconstruct"])
def test_a_calibration_of_other_cameras_or_sizes_is_not_used(thermacq, command, run, words):
    arguments = {
        "check": ["calibration", "check", "cal.json", run],
        "still-water": ["still-water", run, "-c", "cal.json", "-o", "world.json"],
        "reconstruct": ["reconstruct", run, "-c", "cal.json", "-o", "out.nc"],
    }[command]
    code, _, err = thermacq(*arguments)
    assert code == 1
    assert words in err


@pytest.mark.parametrize("command", ["show", "diff", "check", "report"])
@pytest.mark.parametrize("file", ["notes.txt", "empty", "nothing.json", "water.h5"])
def test_what_is_no_calibration_is_said_to_be_none(thermacq, command, file):
    arguments = {
        "show": [file],
        "diff": ["cal.json", file],
        "check": [file, "water.h5"],
        "report": [file, "-o", "page.html"],
    }[command]
    code, _, err = thermacq("calibration", command, *arguments)
    assert code == 1
    assert f"'{file}'" in err


def test_the_calibration_of_these_cameras_is_used(thermacq):
    code, out, _ = thermacq("calibration", "check", "cal.json", "water.h5")
    assert code == 0
    assert "disparity 20" in out
