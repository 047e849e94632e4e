"""``thermacq calibrate RIG --record RUN`` from the first frame to the record, on simulated cameras in virtual time."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from thermacq.store import open_run
from thermacq_calibration import load_calibration

SIDE = """
[cameras.{side}]
driver = "sim-camera"
settings = {{ side = "{side}", rows = 256, columns = 320, pixel_pitch_um = 34.0 }}
"""
RIG = """
[clock]
kind = "virtual"
speed = {speed}
[trigger]
mode = "software"
frame_rate_hz = 20
[store]
reserve_mb = 1
[board]
columns = 9
rows = 6
square_m = 0.05
"""
SCENE = """
view = "chessboard"
seed = 1
[chessboard]
columns = 9
rows = 6
square_m = 0.05
frames_per_view = 5
"""


@pytest.fixture
def start(tmp_path: Path):
    """Start a live calibration in a process group of its own, as a shell does."""
    runtime = Path(tempfile.mkdtemp(prefix="th-"))
    environment = os.environ | {"XDG_RUNTIME_DIR": str(runtime), "COLUMNS": "200"}
    (tmp_path / "board.toml").write_text(SCENE)

    def start(speed: float, *options: str) -> subprocess.Popen[str]:
        (tmp_path / "rig.toml").write_text(
            RIG.format(speed=speed) + SIDE.format(side="left") + SIDE.format(side="right")
        )
        command = ["calibrate", "rig.toml", "-o", "cal.json", "--record", "run.h5", "--scene", "board.toml"]
        return subprocess.Popen(
            [sys.executable, "-m", "thermacq", *command, *options],
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    yield start
    shutil.rmtree(runtime)


@pytest.mark.slow
def test_from_the_first_view_to_the_record(start, tmp_path: Path) -> None:
    process = start(3, "--bootstrap", "5", "--json")
    out, err = process.communicate(timeout=280)
    assert process.returncode == 0, err
    made = load_calibration(tmp_path / "cal.json")
    assert json.loads(out)["sha256"] == made.sha256
    assert made.poses >= 25
    assert made.serials == ("SIM-left", "SIM-right")
    assert made.source == "run.h5 (simulated)"
    assert made.rms_px < 0.25
    # The simulated pair stands 60.4 mm apart by its own settings.
    assert made.baseline_m == pytest.approx(0.0604, rel=0.01)
    with open_run(tmp_path / "run.h5") as run:
        assert run.complete
    assert "views count (" in err
    assert "enough" in err


@pytest.mark.slow
def test_ctrl_c_leaves_a_closed_run_and_says_so(start, tmp_path: Path) -> None:
    # Slow enough for a busy machine: the board changes its pose every second.
    process = start(0.25, "--bootstrap", "0")
    deadline_s = time.monotonic() + 60
    while not (tmp_path / "run.h5").exists() and time.monotonic() < deadline_s:
        time.sleep(0.05)
    time.sleep(1.5)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=280)
    assert "Traceback" not in err
    assert "what was recorded is kept" in err
    assert "recorded: " in err
    with open_run(tmp_path / "run.h5") as run:
        assert run.complete
        views = len(run.frames("left")) // 5
    # A few seconds show too few views: then there is no record, and the message says why.
    assert process.returncode == 1, out
    assert views < 12
    assert not (tmp_path / "cal.json").exists()
    assert "No file was written." in err
