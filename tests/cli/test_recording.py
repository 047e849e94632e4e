"""The recording commands as a user runs them: other processes, signals, exit statuses."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from thermacq.cli.recording import sync_lines
from thermacq.store import open_run

RIG = """
[store]
reserve_mb = 1
[cameras.left]
driver = "test-pattern"
settings = { rows = 48, columns = 64 }
[cameras.right]
driver = "test-pattern"
settings = { rows = 48, columns = 64 }
"""


class Thermacq:
    """Runs the command in a folder with a rig file, with a runtime folder of its own."""

    def __init__(self, folder: Path, runtime: Path) -> None:
        self.folder = folder
        self.environment = os.environ | {"XDG_RUNTIME_DIR": str(runtime), "COLUMNS": "200"}
        self.started: list[subprocess.Popen[str]] = []
        (folder / "rig.toml").write_text(RIG)

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "thermacq", *arguments],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.started.append(process)
        return process

    def __call__(self, *arguments: str) -> tuple[int, str, str]:
        process = self.start(*arguments)
        out, err = process.communicate(timeout=280)
        assert "Traceback" not in err
        return process.returncode, out, err

    def recordings(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = json.loads(self("status", "--json")[1])["recordings"]
        return found

    def when(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Wait until the status of the only recording fulfils a condition."""
        deadline_s = time.monotonic() + 40
        while time.monotonic() < deadline_s:
            for status in self.recordings():
                if condition(status):
                    return status
        raise AssertionError("it did not come to that")


@pytest.fixture
def thermacq(tmp_path: Path) -> Iterator[Thermacq]:
    runtime = Path(tempfile.mkdtemp(prefix="th-"))
    command = Thermacq(tmp_path, runtime)
    yield command
    for process in command.started:
        if process.poll() is None:
            process.kill()
        process.communicate()
    left = command.recordings()
    shutil.rmtree(runtime)
    assert left == []


def written(status: dict[str, Any]) -> bool:
    return bool(status["devices"]) and all(device["written"] >= 5 for device in status["devices"].values())


@pytest.mark.slow
def test_ctrl_c_ends_the_recording_and_keeps_everything(thermacq: Thermacq) -> None:
    process = thermacq.start("record", "rig.toml", "-o", "run.h5", "--json")
    thermacq.when(written)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=280)
    assert process.returncode == 130
    assert "Traceback" not in err
    result = json.loads(out)
    assert result["end_reason"] == "stopped"
    with open_run(thermacq.folder / "run.h5") as run:
        assert run.complete
        assert run.frame_count("left") == result["summary"]["sync"]["devices"]["left"]["received"] >= 5


@pytest.mark.slow
def test_a_hammered_ctrl_c_harms_nothing(thermacq: Thermacq) -> None:
    process = thermacq.start("record", "rig.toml", "-o", "run.h5")
    thermacq.when(written)
    for _ in range(5):
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
    assert "Traceback" not in process.communicate(timeout=280)[1]
    assert process.returncode == 130
    deadline_s = time.monotonic() + 30
    while thermacq.recordings() and time.monotonic() < deadline_s:
        time.sleep(0.1)
    with open_run(thermacq.folder / "run.h5") as run:
        assert run.complete


@pytest.mark.slow
def test_a_killed_client_leaves_a_recording_that_others_see_and_stop(thermacq: Thermacq) -> None:
    client = thermacq.start("record", "rig.toml", "-o", "run.h5")
    before = thermacq.when(written)
    client.kill()
    client.communicate()
    after = thermacq.when(lambda s: s["devices"]["left"]["written"] > before["devices"]["left"]["written"])
    assert after["run_id"] == before["run_id"]
    code, out, _ = thermacq("stop", "--json")
    assert code == 0
    path = Path(json.loads(out)["path"])
    assert path == thermacq.folder / "run.h5"
    with open_run(path) as run:
        assert run.complete
        assert run.frame_count("left") >= after["devices"]["left"]["written"]


@pytest.mark.slow
def test_a_detached_recording_is_shown_and_stopped(thermacq: Thermacq) -> None:
    code, out, _ = thermacq("record", "rig.toml", "-o", "run.h5", "--detach")
    assert code == 0
    assert "thermacq stop" in out
    shown = thermacq("status")[1]
    assert "run.h5" in shown
    assert "left" in shown
    assert thermacq("stop", "other.h5")[0] == 1
    assert thermacq("stop", "run.h5")[0] == 0
    with open_run(thermacq.folder / "run.h5") as run:
        assert run.complete


@pytest.mark.slow
def test_a_recording_of_a_set_length_tells_how_it_went(thermacq: Thermacq) -> None:
    code, out, _ = thermacq("record", "rig.toml", "-o", "run.h5", "--duration", "0.2")
    assert code == 0
    assert "pairs" in out
    assert "recorded:" in out
    code, _, err = thermacq("record", "rig.toml", "-o", "run.h5", "--duration", "0.2")
    assert code == 1
    assert "exists already" in err


@pytest.mark.slow
def test_wrong_use_is_explained(thermacq: Thermacq) -> None:
    (thermacq.folder / "unknown.toml").write_text('[cameras.a]\ndriver = "test-patern"\n')
    (thermacq.folder / "sizes.toml").write_text(RIG.replace("rows = 48", "rows = 50", 1))
    for arguments, message in (
        (("record", "missing.toml", "-o", "run.h5"), "there is no file"),
        (("record", "unknown.toml", "-o", "run.h5"), "Did you mean 'test-pattern'"),
        (("record", "rig.toml", "-o", "none/run.h5"), "there is no folder"),
        (("record", "rig.toml", "-o", "run.h5", "--frames", "0"), "positive"),
        (("record", "rig.toml", "-o", "run.h5", "--calibration", "none.json"), "none.json"),
        (("record", "sizes.toml", "-o", "run.h5", "--frames", "5"), "left 64 x 50, right 64 x 48"),
        (("record", "rig.toml", "-o", "run.h5", "--duration", "1e9"), "will not fit on the disk"),
        (("stop",), "no recording is running"),
    ):
        code, out, err = thermacq(*arguments)
        assert (code, out) == (1, ""), arguments
        assert message in err
    assert not (thermacq.folder / "run.h5").exists()


def test_the_sync_report_in_words() -> None:
    report = {
        "trigger_mode": "software",
        "clock": "virtual",
        "note": "virtual clock: skew is simulated",
        "pairs": 9,
        "paired_by": "trigger index",
        "unpaired": {"left": 0, "right": 1},
        "skew_ns": {"p50": 60.0, "p99": 900.0, "max": 1e6},
        "skew_source": "host times",
        "devices": {
            "left": {"received": 9, "written": 9, "lost": {"late_trigger": 1, "ring_full": 2}},
            "wp": {"received": 400, "lost": {}},
        },
        "clocks": {"wp": {"drift_ppm": 25.0, "residual_ns": 1500.0, "method": "pulses"}, "left": None},
    }
    text = "\n".join(sync_lines(report))
    assert "simulated" in text
    assert "9 by trigger index; unpaired: left 0, right 1" in text
    assert "p50 0.06 us, p99 0.9 us, max 1e+03 us" in text
    assert "lost 1 late_trigger, 2 ring_full" in text
    assert "drift +25.00 ppm, residual 1.5 us, from pulses" in text
