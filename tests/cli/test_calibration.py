"""``thermacq calibrate`` and ``thermacq calibration``."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from thermacq.cli.app import app
from thermacq.errors import ThermacqError
from thermacq_calibration import CalibrationError, load_calibration, rectify

BOARD = ["--columns", "9", "--rows", "6", "--square-m", "0.05"]


@pytest.fixture
def run():
    """Run a command; what it raises (`main` turns it into a message) is in ``exception``."""

    def invoke(*arguments):
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    return invoke


@pytest.fixture(scope="module")
def folder(tmp_path_factory, small_pair):
    """Eight views of a board, one of them blurred in the right picture."""
    folder = tmp_path_factory.mktemp("board [heated]")
    for index, pose in enumerate(small_pair.poses(8, seed=3)):
        left, right = small_pair.pictures(pose, seed=index)
        if index == 5:
            right = cv2.GaussianBlur(right, (0, 0), 12)
        cv2.imwrite(str(folder / f"left{index}.png"), left)
        cv2.imwrite(str(folder / f"right{index}.png"), right)
    return folder


@pytest.fixture(scope="module")
def record(folder, tmp_path_factory):
    """The calibration made of them."""
    path = tmp_path_factory.mktemp("record") / "cal.json"
    done = CliRunner().invoke(app, ["calibrate", str(folder), *BOARD, "-o", str(path)])
    assert done.exit_code == 0, done.output
    return path


def test_a_folder_becomes_a_record_near_the_truth(record, small_pair):
    made = load_calibration(record)
    assert made.baseline_m == pytest.approx(small_pair.truth.baseline_m, rel=0.02)
    assert made.left.matrix[0, 0] == pytest.approx(small_pair.truth.left.matrix[0, 0], rel=0.01)
    assert made.rms_px < 0.2
    assert rectify(made).focal_px == pytest.approx(353.9, rel=0.01)


def test_every_view_is_reported(folder, tmp_path, run):
    done = run("calibrate", folder, *BOARD, "-o", tmp_path / "cal.json", "--json")
    assert done.exit_code == 0
    views = json.loads(done.stdout)["views"]
    assert [view["used"] for view in views].count(True) == 7
    assert "right: no board of 9 x 6 inner corners" in views[5]["reason"]
    text = run("calibrate", folder, *BOARD, "-o", tmp_path / "again.json")
    assert "view 5 not used: right: no board of 9 x 6 inner corners" in text.stdout
    assert "7 of 8" in text.stdout
    assert "[heated]" in text.stdout
    assert "Only 7 views were used" in text.stderr


def test_globs_name_the_sides(folder, tmp_path, run):
    exchanged = run(
        "calibrate",
        "--left",
        folder / "right*.png",
        "--right",
        folder / "left*.png",
        *BOARD,
        "-o",
        tmp_path / "c",
    )
    # The folder's name holds brackets, which a pattern reads as a choice of letters.
    assert isinstance(exchanged.exception, ThermacqError)
    (tmp_path / "plain").symlink_to(folder)
    plain = tmp_path / "plain"
    done = run(
        "calibrate",
        "--left",
        plain / "right*.png",
        "--right",
        plain / "left*.png",
        *BOARD,
        "-o",
        tmp_path / "c",
    )
    assert isinstance(done.exception, CalibrationError)
    assert "exchanged" in done.exception.what
    assert done.exception.kept == "No file was written."
    assert not (tmp_path / "c").exists()


def test_no_board_anywhere_shows_each_view_and_writes_nothing(folder, tmp_path, run):
    output = tmp_path / "cal.json"
    done = run("calibrate", folder, "--columns", 10, "--rows", 7, "--square-m", 0.05, "-o", output)
    assert isinstance(done.exception, CalibrationError)
    assert "no plain chessboard of 10 x 7" in done.exception.what
    assert "9 x 6 inner corners is there" in done.exception.remedy
    assert done.stdout.count("no board of 10 x 7 inner") == 16
    assert not output.exists()


def test_pictures_of_one_camera_are_looked_at_before_they_are_refused(folder, tmp_path, run):
    output = tmp_path / "cal.json"
    for index in range(3):
        (tmp_path / f"frame_{index}.png").write_bytes((folder / f"left{index}.png").read_bytes())
    done = run("calibrate", tmp_path, *BOARD, "-o", output, "--json")
    assert isinstance(done.exception, CalibrationError)
    assert "no picture has a partner" in done.exception.what
    views = json.loads(done.stdout)["views"]
    assert [view["left"] for view in views] == ["found"] * 3
    assert [view["right"] for view in views] == ["there is no picture"] * 3
    assert not output.exists()


def test_too_few_views_write_nothing(folder, tmp_path, run):
    output = tmp_path / "cal.json"
    pictures = sorted(folder.glob("*[012].png"))
    done = run("calibrate", *pictures, *BOARD, "-o", output)
    assert isinstance(done.exception, CalibrationError)
    assert "only 3 of 3 views" in done.exception.what
    assert done.exception.kept == "No file was written."
    assert done.stdout.count("found") == 6
    assert not output.exists()


@pytest.mark.parametrize("command", [["calibrate", ".", *BOARD], ["calibration", "rectified"]])
def test_existing_output_is_refused_first(tmp_path, run, command):
    output = tmp_path / "cal.json"
    output.write_text("precious")
    geometry = ["--size", "64x48", "--focal-px", 100, "--baseline-m", 0.1] if "rectified" in command else []
    done = run(*command, *geometry, "-o", output)
    assert isinstance(done.exception, ThermacqError)
    assert "exists already" in done.exception.what
    assert output.read_text() == "precious"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give a SOURCE"),
        (["x", "--left", "a", "--right", "b"], "give a SOURCE"),
        (["--left", "a*"], "give a SOURCE"),
    ],
)
def test_unclear_sources_are_wrong_usage(tmp_path, run, arguments, words):
    done = run("calibrate", *arguments, *BOARD, "-o", tmp_path / "cal.json")
    assert done.exit_code == 2
    assert words in done.stderr


def test_pictures_need_a_board(folder, tmp_path, run):
    done = run("calibrate", folder, "-o", tmp_path / "cal.json")
    assert done.exit_code == 2
    assert "--square-m" in done.stderr


def test_missing_sources_and_folders_are_explained(tmp_path, run):
    missing = run("calibrate", tmp_path / "nothing", *BOARD, "-o", tmp_path / "cal.json")
    assert "no file or folder" in str(missing.exception)
    nowhere = run("calibrate", tmp_path, *BOARD, "-o", tmp_path / "no" / "cal.json")
    assert "no folder" in str(nowhere.exception)


def test_show_tells_what_is_in_a_record(record, run):
    done = run("calibration", "show", record)
    assert done.exit_code == 0
    assert load_calibration(record).sha256 in done.stdout
    assert "9 x 6 inner corners, 0.05 m squares" in done.stdout
    as_json = run("calibration", "show", record, "--json")
    shown = json.loads(as_json.stdout)
    assert shown.pop("acceptance")["verdict"] == "fail"
    assert shown == load_calibration(record).to_dict()
    assert "as a whole: fail" in done.stdout


def test_show_refuses_an_altered_record(record, tmp_path, run):
    altered = tmp_path / "altered.json"
    altered.write_text(record.read_text().replace('"used": true', '"used": false', 1))
    done = run("calibration", "show", altered)
    assert isinstance(done.exception, CalibrationError)
    assert "altered" in done.exception.what


def test_a_report_can_be_written_at_once_and_later(folder, record, tmp_path, run):
    done = run(
        "calibrate",
        folder,
        *BOARD,
        "-o",
        tmp_path / "c.json",
        "--bootstrap",
        0,
        "--report",
        tmp_path / "c.html",
    )
    assert done.exit_code == 0
    page = (tmp_path / "c.html").read_text()
    assert "View 5, not used: right: no board" in page
    assert page.count("data:image/jpeg") == 8
    assert "Uncertainties are not known" in page
    later = run("calibration", "report", record, "-o", tmp_path / "later.html")
    assert later.exit_code == 0
    assert "bootstrap over poses" in (tmp_path / "later.html").read_text()
    again = run("calibration", "report", record, "-o", tmp_path / "later.html")
    assert "exists already" in str(again.exception)


def test_options_of_the_judgement_reach_the_record(folder, tmp_path, run):
    options = ["--bootstrap", 10, "--working-distance-m", 0.8, "--counts-per-kelvin", 160]
    done = run("calibrate", "cameras", folder, *BOARD, *options, "-o", tmp_path / "c.json", "--json")
    values = json.loads(done.stdout)
    assert (values["uncertainty"]["replicates"], values["uncertainty"]["working_distance_m"]) == (10, 0.8)
    rows = {row["measure"]: row for row in values["acceptance"]["rows"]}
    assert "depth-bias σ at 0.8 m" in rows
    # The pictures have 800 counts between light and dark, less some blur.
    assert rows["board contrast"]["verdict"] in {"pass", "excellent"}
    assert float(rows["board contrast"]["value"].split()[0]) == pytest.approx(5.0, abs=0.6)


def test_squares_in_millimetres_stop_before_the_work(folder, tmp_path, run):
    board = ["--columns", "9", "--rows", "6", "--square-m", "50"]
    done = run("calibrate", folder, *board, "-o", tmp_path / "c.json")
    assert isinstance(done.exception, CalibrationError)
    assert "wanted in metres" in done.exception.what
    assert "give 0.05" in done.exception.remedy
    assert not (tmp_path / "c.json").exists()


def test_diff_shows_what_moved(record, tmp_path, run):
    moved = load_calibration(record)
    replace(moved, translation_m=moved.translation_m * 1.01).save(tmp_path / "moved.json")
    done = run("calibration", "diff", record, tmp_path / "moved.json", "--json")
    assert done.exit_code == 0
    values = json.loads(done.stdout)
    changes = {change["quantity"]: change for change in values["changes"]}
    assert changes["baseline_m"]["second"] == pytest.approx(1.01 * changes["baseline_m"]["first"])
    assert changes["baseline_m"]["in_sigmas"] > 1
    assert values["difference"]["depth_m"] == pytest.approx(0.0065, rel=0.05)
    text = run("calibration", "diff", record, tmp_path / "moved.json").stdout
    assert "depth at the working distance differs by +6." in text
    same = run("calibration", "diff", record, record).stdout
    assert "projections differ by 0.000 px" in same


@pytest.fixture
def wavy(tmp_path, small_pair):
    """A rectified pair of textured pictures with rows 0.6 px apart, and one with rows that agree."""
    random = np.random.default_rng(0)
    texture = cv2.GaussianBlur(random.normal(0, 1, (256, 340)), (0, 0), 2.5)
    counts = 9000 + 700 * texture / texture.std()
    rows, columns = np.mgrid[:256, :320].astype(np.float32)
    for name, right, down in (("left", 12, 0.0), ("right", 0, 0.6), ("level", 0, 0.0)):
        picture = cv2.remap(
            counts.astype(np.float32), columns + right, rows - np.float32(down), cv2.INTER_CUBIC
        )
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.clip(picture, 0, 65535).astype(np.uint16))
    return tmp_path


def test_check_of_rectified_pictures_reports_their_offset(wavy, run):
    done = run("calibration", "check", "--rectified", wavy / "left.png", wavy / "right.png", "--json")
    assert done.exit_code == 3
    values = json.loads(done.stdout)
    assert values["agreement"]["median_px"] == pytest.approx(-0.6, abs=0.05)
    assert values["fits"] is False
    level = run("calibration", "check", "--rectified", wavy / "left.png", wavy / "level.png")
    assert level.exit_code == 0
    assert "fits" in level.stdout


def test_check_with_a_calibration_rectifies_first(wavy, record, tmp_path, run):
    cal = tmp_path / "given.json"
    run("calibration", "rectified", "--size", "320x256", "--focal-px", 350, "--baseline-m", 0.06, "-o", cal)
    assert run("calibration", "check", cal, wavy / "left.png", wavy / "level.png").exit_code == 0
    # The cameras of the record are turned against each other; these pictures are not.
    assert run("calibration", "check", record, wavy / "left.png", wavy / "level.png").exit_code == 3


def test_check_of_a_run_uses_its_own_calibration(measured_wave, run):
    own = run("calibration", "check", measured_wave.run)
    assert own.exit_code == 0, own.output
    assert "temperature against the calibration is not known" in own.stdout
    given = run("calibration", "check", measured_wave.calibration, measured_wave.run, "--json")
    values = json.loads(given.stdout)
    assert values["pairs"] == 8
    assert abs(values["agreement"]["median_px"]) < 0.02
    assert values["agreement"]["disparities_px"] == pytest.approx([24, 24], abs=0.1)


@pytest.mark.parametrize(
    "files", [["a.png"], ["cal.json", "a.png"], ["--rectified", "cal.json", "a.png", "b.png"]]
)
def test_check_wants_a_run_or_two_pictures(run, files):
    done = run("calibration", "check", *files)
    assert done.exit_code == 2
    assert "give CAL RUN" in done.stderr


def test_given_geometry_of_middlebury(tmp_path, run):
    path = tmp_path / "motorcycle.json"
    done = run(
        *("calibration", "rectified", "--size", "741x500", "--focal-px", 994.978, "--baseline-m", 0.193001),
        *("--doffs-px", 31.086, "--principal-point", "311.193,254.877", "-o", path),
    )
    assert done.exit_code == 0
    made = rectify(load_calibration(path))
    assert (made.focal_px, made.principal_point_px) == (994.978, (311.193, 254.877))
    assert made.doffs_px == pytest.approx(31.086)
    assert made.left is None
    assert "0.193001 m" in run("calibration", "show", path).stdout


@pytest.mark.parametrize("size", ["741", "741x", "axb", "64.5x48", "1x2x3"])
def test_sizes_that_are_none_are_wrong_usage(tmp_path, run, size):
    geometry = ["--focal-px", 100, "--baseline-m", 0.1, "-o", tmp_path / "cal.json"]
    done = run("calibration", "rectified", "--size", size, *geometry)
    assert done.exit_code == 2
    assert "--size" in done.stderr


def test_impossible_geometry_is_refused(tmp_path, run):
    for size, focal in (("64x48", -100), ("64x0", 100), ("64x48", "nan")):
        done = run(
            *("calibration", "rectified", "--size", size, "--focal-px", focal),
            *("--baseline-m", 0.1, "-o", tmp_path / "cal.json"),
        )
        assert isinstance(done.exception, CalibrationError)
        assert not (tmp_path / "cal.json").exists()


def test_coded_thermal_boards_are_refused_view_by_view(shared_data, tmp_path, run):
    source = shared_data / "mrt_lwir_checkerboard"
    done = run("calibrate", source, *BOARD, "-o", tmp_path / "cal.json", "--json")
    assert isinstance(done.exception, CalibrationError)
    assert "no plain chessboard" in done.exception.what
    views = json.loads(done.stdout)["views"]
    assert len(views) == 8
    assert all("no board of 9 x 6 inner corners" in view["left"] for view in views)
    assert np.all([view["right"] == "there is no picture" for view in views])
