"""Two fake GigE Vision cameras through the whole program: found, recorded as a pair, one of them lost."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from thermacq.reconstruction.pairs import run_pairs
from thermacq.store import open_run
from thermacq.timing import unwrap_counter

RIG = """
name = "pair of GigE Vision cameras"
[trigger]
mode = "free_run"
frame_rate_hz = 25
[store]
reserve_mb = 1
[cameras.left]
driver = "gige"
serial = "GV01"
settings = { columns = 160, rows = 128 }
[cameras.right]
driver = "gige"
serial = "GV02"
settings = { columns = 160, rows = 128 }
"""
FAULT_AFTER_FRAMES = 10

pytestmark = pytest.mark.slow


@pytest.fixture
def thermacq(tmp_path, monkeypatch):
    """Runs the program as a user does, in a folder of its own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "rig.toml").write_text(RIG)

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "thermacq", *arguments],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            timeout=280,
        )

    return run


def lost_in_file(run, camera: str) -> int:
    """Frames that the counters in the file say are missing."""
    counters = unwrap_counter(run.frames(camera).counter, 64)
    return int(np.sum(np.diff(counters) - 1))


def test_a_pair_is_found_and_recorded(pair, thermacq, tmp_path):
    listed = json.loads(thermacq("devices", "--json").stdout)
    found = next(row["found"] for row in listed["drivers"] if row["driver"] == "gige")
    assert [(one["model"], one["serial"]) for one in found] == [
        ("Aravis Fake", "GV01"),
        ("Aravis Fake", "GV02"),
    ]
    done = thermacq("record", "rig.toml", "-o", "run.h5", "--frames", "75", "--json")
    assert done.returncode == 0, done.stderr
    with open_run(tmp_path / "run.h5") as run:
        sync = run.summary()["sync"]
        assert sync["paired_by"] == "device time"
        for camera in ("left", "right"):
            frames = run.frames(camera)
            assert len(frames) == 75
            # Whatever did not come is missing in the camera's own count, and counted by its cause.
            lost = sync["devices"][camera]["lost"]
            assert lost_in_file(run, camera) == sum(lost.values())
        assert sync["pairs"] + sync["unpaired"]["left"] == 75
        # Both cameras expose on multiples of their period of the same clock; a busy machine leaves some out.
        assert sync["pairs"] >= 40
        assert [run.camera(name).identity["serial"] for name in ("left", "right")] == ["GV01", "GV02"]
    assert thermacq("verify", "run.h5").returncode == 0


def test_lost_packets_and_a_pause_are_told_by_the_file(fake_camera, second_address, thermacq, tmp_path):
    fake_camera("GV01", lost_per_thousand=3)
    right = fake_camera("GV02", second_address)
    path = tmp_path / "run.h5"

    def pause() -> None:
        wait_for_frames(path)
        right.signal(signal.SIGSTOP)
        time.sleep(2.0)
        right.signal(signal.SIGCONT)

    pausing = threading.Thread(target=pause)
    pausing.start()
    done = thermacq("record", "rig.toml", "-o", "run.h5", "--duration", "7")
    pausing.join()
    assert done.returncode == 0, done.stderr
    with open_run(path) as run:
        lost = {name: device["lost"] for name, device in run.summary()["sync"]["devices"].items()}
        told = [event for event in run.events() if event.device == "left" and event.kind == "incomplete"]
        assert lost["left"]["incomplete"] == len(told) > 0
        # Losses before the first and after the last good frame leave no gap between two counters.
        assert lost_in_file(run, "left") <= sum(lost["left"].values())
        assert np.max(np.diff(run.frames("right").ticks)) > 1.9e9
        assert sum(lost["right"].values()) <= 1  # the frame that was under way
        assert lost_in_file(run, "right") == sum(lost["right"].values())
    assert thermacq("verify", "run.h5").returncode == 0


def test_a_killed_camera_ends_the_run_and_harms_nothing(pair, thermacq, tmp_path):
    _, right = pair
    path = tmp_path / "run.h5"
    (tmp_path / "rig.toml").write_text(RIG + '[reconnect]\npolicy = "fail"\n')

    killer = threading.Thread(target=lambda: (wait_for_frames(path), right.kill()))
    killer.start()
    done = thermacq("record", "rig.toml", "-o", "run.h5", "--duration", "30")
    killer.join()
    assert done.returncode == 1
    assert "a camera was lost: device 'right'" in done.stderr
    with open_run(path) as run:
        assert run.complete
        gone = [event for event in run.events() if event.kind == "disconnected"]
        assert [event.device for event in gone] == ["right"]
        times = {name: run.frames(name).host_ns for name in ("left", "right")}
        assert len(times["right"]) >= FAULT_AFTER_FRAMES
        # 5 to 6 s until Aravis gives the camera up; the left one goes on meanwhile.
        assert 4e9 < gone[0].host_ns - times["right"][-1] < 12e9
        assert times["left"][-1] > gone[0].host_ns
        assert lost_in_file(run, "right") == 0
    assert thermacq("verify", "run.h5").returncode == 0


def test_the_driver_conforms(fake_camera, tmp_path):
    fake_camera("GV01")
    settings = tmp_path / "settings.toml"
    settings.write_text('address = "127.0.0.1"\ncolumns = 64\nrows = 48\nmax_frame_rate_hz = 10\n')
    suite = ["--pyargs", "thermacq.testing.conformance", "--driver", "gige"]
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            *suite,
            "--driver-settings",
            settings,
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert done.returncode == 0, done.stdout
    # The faults have tests of their own: no setting makes a real peer act them out.
    assert "20 passed, 4 skipped" in done.stdout


def wait_for_frames(path: Path) -> None:
    """Wait until some frames are in the file."""
    deadline_s = time.monotonic() + 30
    while frames_written(path) < FAULT_AFTER_FRAMES and time.monotonic() < deadline_s:
        time.sleep(0.1)


def frames_written(path: Path) -> int:
    """Frames of the right camera in a file that is being written."""
    try:
        with open_run(path) as run:
            return len(run.frames("right"))
    except Exception:
        return 0


def test_a_killed_camera_that_returns_goes_on_in_the_same_file(pair, thermacq, tmp_path):
    _, right = pair
    path = tmp_path / "run.h5"

    def replug() -> None:
        wait_for_frames(path)
        right.kill()
        time.sleep(1.0)
        right.start()

    replugging = threading.Thread(target=replug)
    replugging.start()
    done = thermacq("record", "rig.toml", "-o", "run.h5", "--duration", "12", "--json")
    replugging.join()
    assert done.returncode == 0, done.stderr
    with open_run(path) as run:
        summary = run.summary()
        (outage,) = summary["sync"]["outages"]
        assert (outage["device"], outage["came_back"], outage["changed"]) == ("right", True, {})
        told = [event.kind for event in run.events() if event.device == "right"]
        assert told.count("disconnected") == told.count("reconnected") == 1
        left, right_frames = run.frames("left"), run.frames("right")
        assert np.max(np.diff(left.host_ns)) < 1e9
        assert lost_in_file(run, "left") == sum(summary["sync"]["devices"]["left"]["lost"].values())
        (back_ns,) = right_frames.restarts_ns
        before = right_frames.host_ns < back_ns
        gap_s = (back_ns - right_frames.host_ns[before][-1]) / 1e9
        assert 1 < gap_s < 16
        missed = summary["sync"]["devices"]["right"]["lost"]["disconnected"]
        assert missed == pytest.approx(25 * gap_s, abs=3)
        assert np.count_nonzero(~before) > 25
        # Frames after the return are paired with those of the camera that stayed.
        pairs = run_pairs(run)
        assert np.max(right_frames.host_ns[pairs.right] - back_ns) > 1e9
        assert np.max(np.abs(left.ticks[pairs.left] - right_frames.ticks[pairs.right])) < 25e6
    assert thermacq("verify", "run.h5").returncode == 0
