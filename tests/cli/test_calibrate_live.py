"""``thermacq calibrate RIG --record RUN``: what is refused, and what the guidance looks like."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from typer.testing import CliRunner

from thermacq.cli.app import app
from thermacq.cli.calibrate_live import picture
from thermacq_calibration import NoBoard, View
from thermacq_calibration.targets.guidance import guidance


def words(judged, last):
    console = Console(width=200, file=io.StringIO())
    console.print(picture(judged, last))
    return console.file.getvalue()


def test_the_guidance_says_what_is_covered_and_what_is_next(pair):
    views = pair.views(3)
    said = words(guidance(views, (640, 512), pair.board), views[-1])
    assert "3 views count" in said
    assert "22 more different views" in said
    assert "next: hold the board at the" in said
    assert "■" in said


def test_the_reason_of_a_failed_view_is_shown(pair):
    lost = View("4-9", NoBoard("too blurred"), NoBoard("too blurred"))
    said = words(guidance([lost], (640, 512), pair.board), lost)
    assert "last view (4-9): left: too blurred; right: too blurred" in said


def test_an_existing_record_is_refused_before_anything_is_recorded(tmp_path):
    existing = tmp_path / "cal.json"
    existing.write_text("{}")
    run = tmp_path / "run.h5"
    done = CliRunner().invoke(app, ["calibrate", "rig.toml", "-o", str(existing), "--record", str(run)])
    assert done.exit_code != 0
    assert "exists already" in str(done.exception)
    assert not run.exists()


@pytest.mark.parametrize(
    ("board", "words"),
    [
        ("columns = 8\nrows = 6", "looks the same after half a turn"),
        ("square_m = 0.6", "the side of a square is wanted in metres"),
    ],
)
def test_an_impossible_board_is_refused_before_anything_is_recorded(tmp_path, board, words):
    rig = tmp_path / "rig.toml"
    rig.write_text(
        '[clock]\nkind = "virtual"\n[cameras.left]\ndriver = "sim-camera"\n[cameras.right]\n'
        f'driver = "sim-camera"\n[board]\n{board}\n'
    )
    arguments = ["calibrate", str(rig), "-o", str(tmp_path / "c.json"), "--record", str(tmp_path / "r.h5")]
    done = CliRunner().invoke(app, arguments)
    assert words in str(done.exception)
    assert not (tmp_path / "r.h5").exists()
