"""``--emulate``: a rehearsal of a whole recording, and that no one can take it for a real one."""

from __future__ import annotations

import json
import shutil
import tempfile
from itertools import pairwise

import pytest
from typer.testing import CliRunner

from thermacq.acquisition import record
from thermacq.cli.app import app
from thermacq.errors import RigError
from thermacq.plugins import plugins
from thermacq.rig import load_rig
from thermacq.rig.rehearsal import emulated_devices
from thermacq.store import open_run

RIG = """
[clock]
kind = "virtual"
[trigger]
mode = "hardware"
source = "box"
frame_rate_hz = 50.0
[store]
reserve_mb = 1
[cameras.left]
driver = "test-pattern"
settings = { rows = 48, columns = 64 }
[cameras.right]
driver = "test-pattern"
settings = { rows = 48, columns = 64 }
[trigger_sources.box]
driver = "pulse_pal"
serial = "PP7"
[emulation.box]
pulse_faults = [
  { kind = "drop", at = 20, items = 3 },
  { kind = "duplicate", at = 60, seconds = 0.01 },
]
"""


@pytest.fixture
def rig_file(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


@pytest.fixture
def short_runtime(monkeypatch):
    # The path of a socket may have 107 bytes; pytest's folders are long.
    folder = tempfile.mkdtemp(prefix="tq-")
    monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
    yield
    shutil.rmtree(folder)


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.slow
def test_a_rehearsed_recording_keeps_the_pulses_the_faults_and_the_mark(rig_file, tmp_path, short_runtime):
    output = tmp_path / "run.h5"
    result = record(rig_file, output, duration_s=2.0, emulate=True)
    assert result.asked_for
    with open_run(output) as recorded:
        header, events = recorded.header, recorded.events()
        ticks_us = recorded.frames("left").ticks
        numbers = [len(recorded.frames(name)) for name in ("left", "right")]
    assert header.emulated == ("box",)
    assert header.simulated
    # 100 pulses, 3 lost by the box and 1 that came twice.
    assert numbers == [98, 98]
    steps_ms = [round((after - before) / 1e3) for before, after in pairwise(ticks_us)]
    assert (steps_ms[19], steps_ms.count(80), steps_ms.count(10), steps_ms.count(20)) == (80, 1, 2, 94)
    injected = [(event.detail, event.index) for event in events if event.detail.startswith("emulator")]
    assert injected == [
        *[("emulator acted out: drop", index) for index in (20, 21, 22)],
        ("emulator acted out: duplicate", 60),
    ]
    told = run("info", output)
    assert "EMULATED, not hardware: box" in told.output
    assert json.loads(run("info", output, "--json").output)["emulated"] == ["box"]


@pytest.mark.slow
def test_without_emulation_the_hardware_is_missed(rig_file, tmp_path, short_runtime):
    rig_file.write_text(RIG.replace('kind = "virtual"', 'kind = "real"'))
    done = run("record", rig_file, "-o", tmp_path / "run.h5", "--duration", 1)
    assert "serial port of 'PP7' was not found" in str(done.exception)


@pytest.mark.slow
def test_the_check_opens_the_emulated_devices(rig_file):
    done = run("rig", "check", rig_file, "--emulate", "--json")
    reports = {report["name"]: report for report in json.loads(done.stdout)["devices"]}
    assert {name: report["emulated"] for name, report in reports.items()} == {
        "left": False,
        "right": False,
        "box": True,
    }
    assert reports["box"]["identity"]["serial"] == "PP7"
    assert "EMULATED" in run("rig", "check", rig_file, "--emulate").output


def test_a_device_that_nothing_can_play_is_refused_by_name(rig_file, monkeypatch):
    monkeypatch.setattr(plugins(), "emulators", dict)
    rig_file.write_text(RIG.partition("[emulation.box]")[0])
    with pytest.raises(RigError, match="box: driver 'pulse_pal' has no emulator"):
        emulated_devices(load_rig(rig_file), plugins())


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "[emulation.bix]\nserial = 'X'",
            "line 19: emulation.bix: there is no device 'bix' in this rig; did you mean 'box'",
        ),
        ("[emulation.left]\nserial = 'X'", "line 19: emulation.left: driver 'test-pattern' has no emulator"),
        ("[emulation.box]\nclock_pmm = 3.0", "line 20: emulation.box: unknown key 'clock_pmm'; did you mean"),
        ("[emulation.box]\nfaults = [{ kind = 'stall' }]", "say when it strikes"),
    ],
)
def test_mistakes_in_the_emulation_are_told_with_their_line(rig_file, table, words):
    rig_file.write_text(RIG.partition("[emulation.box]")[0] + table)
    with pytest.raises(RigError) as mistake:
        load_rig(rig_file)
    assert words in str(mistake.value)
