"""``thermacq info``, ``verify``, ``recover`` and ``import`` as a user runs them."""

from __future__ import annotations

import json
import sys

import cv2
import numpy as np
import pytest

from thermacq.cli import main
from thermacq.cli.store import _sync_report
from thermacq.store import CameraStream, FrameRow, ProbeStream, RunHeader, RunWriter, open_run, verify


@pytest.fixture
def thermacq(monkeypatch, capsys):
    """Run a command; give exit status, stdout and stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["thermacq", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return ended.value.code or 0, captured.out, captured.err

    return run


@pytest.fixture
def run_file(tmp_path):
    """A complete run of 3 frames and 2 samples."""
    return write(tmp_path / "run.h5", finish=True)


def write(path, finish):
    header = RunHeader("id-1", "[bold]title", "2024-05-01T10:00:00Z", 0, 0, "virtual", True, {"cameras": {}})
    probe = ProbeStream("gauge", ("level",), "V", 0.0)
    with RunWriter.create(path, header, [CameraStream("left", 4, 6)], [probe]) as writer:
        for index in range(3):
            writer.append_frame("left", np.full((4, 6), index, np.uint16), FrameRow(index, -1, 10**9 * index))
        writer.append_samples("gauge", np.ones((2, 1)), np.arange(2), 0, 0)
        if finish:
            writer.finish({"pairs": 0}, "as asked")
    return path


def test_info_for_people(thermacq, run_file):
    status, out, _ = thermacq("info", run_file)
    assert status == 0
    assert "title: [bold]title" in out
    assert "camera left: 3 frames of 6 x 4 in 2.000 s" in out
    assert "probe gauge: 2 samples of level [V]" in out
    assert "state: complete, simulated" in out


def test_info_for_programs(thermacq, run_file):
    status, out, _ = thermacq("info", run_file, "--json")
    facts = json.loads(out)
    assert status == 0
    assert facts["cameras"][0]["frames"] == 3
    assert facts["summary"] == {"pairs": 0}


def test_verify_a_sound_run(thermacq, run_file):
    status, out, _ = thermacq("verify", run_file)
    assert status == 0
    assert "nothing is wrong" in out


def test_verify_says_what_is_wrong_and_exits_with_3(thermacq, tmp_path):
    path = write(tmp_path / "cut.h5", finish=False)
    status, out, _ = thermacq("verify", path)
    assert status == 3
    assert "wrong: run: the run was not closed" in out
    status, out, _ = thermacq("verify", path, "--json")
    assert status == 3
    report = json.loads(out)
    assert not report["ok"]
    assert report["findings"][0]["where"] == "run"


def test_recover(thermacq, tmp_path):
    path = write(tmp_path / "cut.h5", finish=False)
    clean = tmp_path / "clean.h5"
    status, out, _ = thermacq("recover", path, "-o", clean)
    assert status == 0
    assert "camera left: 3 frames saved" in out
    assert "is a clean run file" in out
    assert verify(clean).ok
    status, out, err = thermacq("recover", path, "-o", clean)
    assert status == 1
    assert "exists already" in err


def test_import(thermacq, tmp_path):
    for camera in ("left", "right"):
        for index in range(3):
            cv2.imwrite(str(tmp_path / f"{camera}{index}.png"), np.full((4, 6), index, np.uint8))
    sources = ("--left", tmp_path / "left*.png", "--right", tmp_path / "right*.png")
    status, out, err = thermacq("import", *sources, "-o", tmp_path / "run.h5")
    assert status == 1
    assert "--rate-hz" in err
    status, out, err = thermacq("import", *sources, "--rate-hz", 10, "-o", tmp_path / "run.h5")
    assert status == 0
    assert "3 pairs of 6 x 4 pixels, 8 bits, 10 Hz" in out
    assert "note: times follow from a steady rate of 10.0 Hz" in err
    with open_run(tmp_path / "run.h5") as run:
        assert run.frame_count("right") == 3


@pytest.mark.parametrize("command", ["info", "verify"])
def test_bad_files_are_explained(thermacq, tmp_path, command):
    (tmp_path / "text.h5").write_text("no run")
    for path in (tmp_path / "none.h5", tmp_path / "text.h5", tmp_path):
        status, out, err = thermacq(command, path)
        assert status == 1
        assert out == ""
        assert "error:" in err
        assert "Traceback" not in err


@pytest.mark.parametrize("summary", [None, {}, {"sync": None}, {"sync": {"trigger_mode": 3}}, {"sync": "x"}])
def test_a_summary_without_a_proper_sync_report_is_no_obstacle(summary):
    assert _sync_report(summary) == []


def test_the_sync_report_is_shown_again():
    sync = {"trigger_mode": "hardware", "clock": "real", "note": "", "devices": {}, "clocks": {}}
    assert _sync_report({"sync": sync}) == ["trigger      hardware, real clock"]
