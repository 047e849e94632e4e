"""``thermacq preheat`` and ``noise`` as a user runs them: live in virtual time, recorded, and with wrong input."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from thermacq.store import EventKind, open_run

SIDE = """
[cameras.{side}]
driver = "sim-camera"
[cameras.{side}.settings]
side = "{side}"
rows = 16
columns = 24
pixel_pitch_um = 400.0
"""
RIG = """
[clock]
kind = "virtual"
[store]
reserve_mb = 1
[probes.gone]
driver = "sim-probe"
"""
SCENE = """
view = "uniform"
[camera.sensor]
shading_k = 0.0
[camera.warm_up]
powered_for_s = 0.0
fpa_rise_k = {rise}
fpa_time_constant_s = 60.0
housing_rise_k = 0.0
[camera.shutter]
period_s = 60.0
"""


@pytest.fixture
def folder(tmp_path: Path):
    """Folder with a rig of two tiny cameras that warm up fast, and with scenes."""
    (tmp_path / "rig.toml").write_text(RIG + SIDE.format(side="left") + SIDE.format(side="right"))
    (tmp_path / "warm.toml").write_text(SCENE.format(rise=5.0))
    (tmp_path / "hot.toml").write_text(
        SCENE.format(rise=40.0).replace("= 60.0\nhousing", "= 3000.0\nhousing")
    )
    (tmp_path / "black.toml").write_text('view = "uniform"\n')
    return tmp_path


@pytest.fixture
def start(folder: Path):
    runtime = Path(tempfile.mkdtemp(prefix="th-"))
    environment = os.environ | {"XDG_RUNTIME_DIR": str(runtime), "COLUMNS": "200"}
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "thermacq", *arguments],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            # A test that gave up waiting leaves nothing behind.
            process.kill()
            process.communicate()
    shutil.rmtree(runtime)


@pytest.fixture
def thermacq(start):
    def run(*arguments: str) -> tuple[int, str, str]:
        process = start(*arguments)
        out, err = process.communicate(timeout=280)
        assert "Traceback" not in err
        return process.returncode, out, err

    return run


@pytest.mark.slow
def test_a_live_preheat_ends_with_a_go_that_the_run_tells_again(thermacq, folder: Path) -> None:
    code, out, err = thermacq(
        "preheat", "rig.toml", "--scene", "warm.toml", "-o", "run.h5", "--minimum-min", "11",
        "--counts-per-kelvin", "100", "--rate-hz", "2", "--json", "--picture", "warm.png",
    )  # fmt: skip
    assert code == 0, err
    facts = json.loads(out)
    assert facts["go"]
    assert facts["ready"]
    assert facts["time_s"] >= 660
    assert (folder / "warm.png").stat().st_size > 10_000
    for camera in facts["cameras"].values():
        assert {one["name"]: one["grade"] for one in camera["criteria"]}["time"] == "pass"
    with open_run(folder / "run.h5") as run:
        assert run.complete
        assert run.probes == ()
        notes = [event.detail for event in run.events() if event.kind is EventKind.NOTE]
        assert notes == ["preheat: left go; right go"]
    code, out, _ = thermacq("preheat", "run.h5", "--minimum-min", "11", "--counts-per-kelvin", "100")
    assert code == 0
    assert out.rstrip().endswith("go")
    code, out, _ = thermacq("preheat", "run.h5", "--minimum-min", "600")
    assert code == 3
    assert out.rstrip().endswith("no-go")
    assert "cannot be judged: the counts per kelvin are not known" in out


@pytest.mark.slow
def test_an_override_is_logged_in_the_run_and_remembered(thermacq, folder: Path) -> None:
    code, out, err = thermacq(
        "preheat", "rig.toml", "--scene", "hot.toml", "-o", "run.h5", "--minimum-min", "6", "--rate-hz", "2",
        "--override", "the paint dries",
    )  # fmt: skip
    assert code == 0, err
    assert "override: the paint dries" in out
    assert out.rstrip().endswith("go, by override")
    with open_run(folder / "run.h5") as run:
        notes = [event for event in run.events() if event.kind is EventKind.NOTE]
    assert notes[0].detail == "preheat override: the paint dries"
    assert notes[0].device == "operator"
    assert notes[0].host_ns >= 360e9
    assert "no-go: fpa" in notes[1].detail
    assert thermacq("preheat", "run.h5", "--minimum-min", "600")[0] == 0


@pytest.mark.slow
def test_ctrl_c_keeps_the_run_and_says_no_go(start, folder: Path) -> None:
    process = start("preheat", "rig.toml", "--scene", "hot.toml", "-o", "run.h5", "--minimum-min", "1e6")
    deadline_s = time.monotonic() + 60
    while not (folder / "run.h5").exists() and time.monotonic() < deadline_s:
        time.sleep(0.05)
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=280)
    assert process.returncode == 3
    assert "Traceback" not in err
    assert "no-go" in out
    with open_run(folder / "run.h5") as run:
        assert run.complete
        assert any(event.detail.startswith("preheat: ") for event in run.events())


@pytest.mark.slow
def test_noise_of_a_recorded_blackbody(thermacq, folder: Path) -> None:
    code, _, err = thermacq("record", "rig.toml", "--scene", "black.toml", "-o", "black.h5", "--frames", "64")
    assert code == 0, err
    code, out, err = thermacq("noise", "black.h5", "--counts-per-kelvin", "100")
    assert code == 0, err
    assert "simulated run" in out
    # Rounding to whole counts adds 1/12 to 3.5².
    assert float(re.search(r"NETD +(\S+)", out)[1]) == pytest.approx(35.1, abs=1.0)
    code, _, err = thermacq("noise", "black.h5", "-o", "noise.pdf")
    assert code == 1
    assert "neither .png nor .html" in err
    code, _, err = thermacq("noise", "black.h5", "--sitf", "black.h5", "--counts-per-kelvin", "1")
    assert code == 2
    assert "choose one" in err


def test_wrong_input_is_explained(thermacq, folder: Path) -> None:
    code, _, err = thermacq("preheat", "rig.toml")
    assert code == 2
    assert "-o RUN" in err
    code, _, err = thermacq("preheat", "run.h5", "--override", "x")
    assert code == 2
    assert "not altered" in err
    code, _, err = thermacq("preheat", "run.h5")
    assert code == 1
    assert "no run file" in err
