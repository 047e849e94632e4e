"""``thermacq rig check``, ``show`` and ``schema``: every misfit is said, nothing hangs the check."""

from __future__ import annotations

import dataclasses
import json
import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import pytest

from thermacq.devices import (
    CameraCapabilities,
    DeviceIdentity,
    DeviceKind,
    ProbeCapabilities,
    TriggerCapabilities,
    TriggerMode,
)
from thermacq.hooks import Evidence
from thermacq.plugins import load_plugins
from thermacq.rig import parse_rig
from thermacq.rig.fit import find_misfits
from thermacq.rig.inspection import DeviceReport, flat, inspect_devices
from thermacq.rig.machine import Machine

PLUGIN = """
import os, time
from pydantic import BaseModel
from thermacq.devices import *
from thermacq.errors import DeviceTimeout
from thermacq.hooks import Driver, Evidence, RigFinding, hookimpl

class Settings(BaseModel):
    trouble: str = ""
    gain: float = 1.0

class Lab:
    capabilities = CameraCapabilities(4, 5, 14, 60.0, frozenset({TriggerMode.FREE_RUN}))

    def __init__(self, context):
        self.name = context.name

    def open(self):
        return DeviceIdentity("lab", "Lab One", "42")

    def configure(self, settings):
        trouble = settings.get("trouble")
        if trouble == "hang":
            time.sleep(1000)
        if trouble == "die":
            os._exit(7)
        if trouble == "bug":
            1 / 0
        if trouble == "fault":
            raise DeviceTimeout(self.name, "configure", "no answer", remedy="Is it [plugged] in?")
        return {"trouble": "", "gain": 2.0}

    def close(self):
        pass

@hookimpl
def thermacq_drivers():
    return [Driver("lab", DeviceKind.CAMERA, "", Evidence.HARDWARE, Lab, lambda: Settings)]

@hookimpl
def thermacq_rig_checks(rig):
    return [RigFinding("warning", "the tank is empty")] if rig.name == "dry" else []
"""

PATTERN = "[cameras.{name}]\ndriver = 'test-pattern'\nsettings = {{rows = 24, columns = 32}}\n"


@pytest.fixture
def thermacq(tmp_path):
    """Run the command in a fresh interpreter where the lab's plugin is installed."""
    (tmp_path / "lab_plugin.py").write_text(PLUGIN)
    information = tmp_path / "lab-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[thermacq]\nlab = lab_plugin\n")

    def run(*arguments: str, rig: str, **files: str) -> subprocess.CompletedProcess[str]:
        (tmp_path / "rig.toml").write_text(rig)
        for name, text in files.items():
            (tmp_path / f"{name}.toml").write_text(text)
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        command = [sys.executable, "-m", "thermacq", "rig", *arguments]
        return subprocess.run(
            command, capture_output=True, text=True, env=environment, cwd=tmp_path, check=False
        )

    return run


def test_a_rig_that_fits(thermacq):
    text = PATTERN.format(name="left") + PATTERN.format(name="right")
    done = thermacq("check", "rig.toml", rig="[trigger]\nframe_rate_hz = 20\n" + text)
    assert done.returncode == 0, done.stderr
    assert "left  test pattern, serial TP-left (test-pattern, proven on: simulated)" in done.stdout
    assert "rows = 24" in done.stdout
    assert "counter_bits 16" in done.stdout
    assert "trigger_modes free_run/hardware/software" in done.stdout
    assert "everything fits" in done.stdout or "the disk here" in done.stdout
    assert done.stderr.strip() == ""


def test_misfits_end_with_status_3_and_are_all_in_the_json(thermacq):
    rig = (
        PATTERN.format(name="left")
        + "[cameras.right]\ndriver = 'lab'\nserial = '43'\nsettings = {gain = 1.0}"
    )
    done = thermacq("check", "rig.toml", "--json", rig="name = 'dry'\n" + rig)
    assert done.returncode == 3
    answer = json.loads(done.stdout)
    messages = [finding["message"] for finding in answer["findings"]]
    for expected in (
        "right: the rig expects serial '43', the device is '42'",
        "right: gain: asked 1.0, applied 2.0",
        "the cameras differ in size: left 32 x 24, right 5 x 4 pixels",
        "right: trigger mode 'software' is not offered; it has: free_run",
        "the tank is empty",
    ):
        assert expected in messages
    left = answer["devices"][0]
    assert left["capabilities"]["trigger_modes"] == ["free_run", "hardware", "software"]
    assert left["applied"]["rows"] == 24


@pytest.mark.parametrize(
    ("trouble", "message"),
    [
        ("die", "its process ended with status 7 (stage 'configure')"),
        ("bug", "ZeroDivisionError: division by zero"),
        ("fault", "device 'left' (configure): no answer Is it [plugged] in?"),
    ],
)
def test_a_device_in_trouble_is_a_finding(thermacq, trouble, message):
    rig = f"[cameras.left]\ndriver = 'lab'\nsettings = {{trouble = '{trouble}'}}\n" + PATTERN.format(
        name="right"
    )
    done = thermacq("check", "rig.toml", rig=rig)
    assert done.returncode == 3
    assert f"error: left: {message}" in done.stdout
    assert "right  test pattern, serial TP-right" in done.stdout
    assert "Traceback" not in done.stderr


def test_a_wrong_rig_file_is_explained(thermacq):
    done = thermacq("check", "rig.toml", rig="[cameras.left]\ndriver = 'labb'\n")
    assert done.returncode == 1
    assert "rig.toml, line 2: cameras.left.driver: there is no camera driver named 'labb'" in done.stderr
    assert "Did you mean 'lab'?" in done.stderr


def test_show_prints_the_rig_with_defaults_and_scene(thermacq):
    rig = PATTERN.format(name="left") + "[scene]\nkind = 'still'\n"
    done = thermacq("show", "rig.toml", "--scene", "wave.toml", rig=rig, wave="kind = 'wave'\n")
    shown = json.loads(done.stdout)
    assert shown["scene"] == {"kind": "wave"}
    assert shown["store"]["compression"] == "lz4"


def test_schema_is_json(thermacq):
    assert "trigger_sources" in json.loads(thermacq("schema", rig="").stdout)["properties"]


def test_a_hanging_device_is_given_up_and_its_process_ended(tmp_path, monkeypatch):
    (tmp_path / "lab_plugin.py").write_text(PLUGIN)
    information = tmp_path / "lab-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[thermacq]\nlab = lab_plugin\n")
    monkeypatch.syspath_prepend(tmp_path)
    rig = parse_rig("[cameras.left]\ndriver = 'lab'\nsettings = {trouble = 'hang'}\n")
    before = set(multiprocessing.active_children())
    report = inspect_devices(rig, timeout_s=4.0)[0]
    assert report.error == "did not answer within 4 s (stage 'configure')"
    assert set(multiprocessing.active_children()) <= before


CAMERA = CameraCapabilities(
    512, 640, 14, 60.0, frozenset({TriggerMode.HARDWARE}), tick_rate_hz=1000.0, counter_bits=32
)
PROBE = ProbeCapabilities(("a", "b"), "V", 1000.0)
SOURCE = TriggerCapabilities(max_rate_hz=55.0, period_step_s=1e-3)
PLENTY = Machine(cores=64, memory_bytes=10**12, disk_bytes=10**15)
TABLES = """
[trigger]
mode = 'hardware'
source = 'box'
frame_rate_hz = 50
[cameras.left]
driver = 'x'
[cameras.right]
driver = 'x'
[probes.near]
driver = 'x'
[trigger_sources.box]
driver = 'x'
"""


def report(name: str, kind: DeviceKind, capabilities, **changes) -> DeviceReport:
    identity = DeviceIdentity("x", "model", f"serial of {name}")
    good = DeviceReport(name, kind, "x", {}, Evidence.HARDWARE, identity, {}, capabilities)
    return dataclasses.replace(good, **changes)


def misfits(text: str = TABLES, machine: Machine = PLENTY, **changes) -> list[str]:
    reports = [
        report("left", DeviceKind.CAMERA, **{"capabilities": CAMERA, **changes}),
        report("right", DeviceKind.CAMERA, CAMERA),
        report("near", DeviceKind.WAVE_PROBE, PROBE),
        report("box", DeviceKind.TRIGGER_SOURCE, SOURCE),
    ]
    found = find_misfits(parse_rig(text), reports, load_plugins(), machine)
    return [f"{finding.severity}: {finding.message}" for finding in found if "matcher" not in finding.message]


def test_a_fitting_rig_has_no_findings():
    assert misfits() == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("= 50", "= 61", "error: left: 61 frames/s asked, at most 60 possible at this size"),
        ("= 50", "= 58", "error: box: 58 pulses/s asked, at most 55 possible"),
        ("= 50", "= 49", "warning: box: its period has steps of 1000 µs, so 49 Hz becomes 50 Hz"),
        ("'hardware'", "'software'", "warning: trigger.source 'box' is not used in mode 'software'"),
        (
            "'hardware'",
            "'software'",
            "error: left: trigger mode 'software' is not offered; it has: hardware",
        ),
        (
            "[probes.near]",
            "[probes.near]\nchannel = 'c'",
            "error: near: there is no channel 'c'; it has: a, b",
        ),
        ("[probes.near]", "[probes.near]\npin_to_core = 64", "error: near: pin_to_core = 64, but the cores"),
        (
            "[cameras.right]",
            "pin_to_core = 3\n[cameras.right]\npin_to_core = 3",
            "warning: left and right are pinned to the same core 3",
        ),
        (
            "[trigger]",
            "[clock]\nkind = 'virtual'\n[trigger]",
            "error: left: a real device cannot follow the virtual clock",
        ),
    ],
)
def test_each_misfit_of_the_rig_is_found(old, new, message):
    assert any(line.startswith(message) for line in misfits(TABLES.replace(old, new, 1)))


def test_a_camera_that_counts_nothing_is_warned_of():
    blind = dataclasses.replace(CAMERA, tick_rate_hz=0.0, counter_bits=0)
    (warning,) = misfits(capabilities=blind)
    assert warning.startswith("warning: left: as it is set up it has neither frame counter nor clock")


def test_the_same_device_twice_is_found():
    twin = DeviceIdentity("x", "model", "serial of right")
    assert misfits(identity=twin) == ["error: left and right are the same device; give each its serial"]


def test_a_small_machine_is_found():
    small = Machine(cores=64, memory_bytes=100_000_000, disk_bytes=2 * 10**9)
    lines = misfits(machine=small)
    assert lines[0].startswith("error: the rings need 131 MB of memory, of 100 MB that are free")
    assert lines[1].startswith("warning: the disk here holds 15 s of uncompressed pictures")


def test_only_the_asked_keys_of_inner_tables_are_compared():
    asked = {"clock": {"drift_ppm": 8, "rate_hz": 1e6}, "channels": ["a"]}
    applied = {"clock": {"drift_ppm": 8.0, "rate_hz": 5e5, "offset_s": 0.0}, "channels": ("a",)}
    lines = misfits(requested=asked, applied=applied)
    assert lines == ["warning: left: clock.rate_hz: asked 1000000.0, applied 500000.0"]


def test_findings_of_an_unopened_device_stop_at_its_error():
    lines = misfits(error="no answer", identity=None, capabilities=None)
    assert lines == ["error: left: no answer"]


def test_this_repository_keeps_no_runtime_folder_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    inspect_devices(parse_rig(PATTERN.format(name="left")))
    assert list(Path(tmp_path).iterdir()) == []


def test_inner_tables_and_lists_of_tables_are_compared_key_by_key():
    asked = {"clock": {"ppm": 3}, "inputs": [{"ain": 0}, {"ain": 1}], "channels": ("a", "b"), "none": []}
    assert flat(asked) == {
        "clock.ppm": 3,
        "inputs[0].ain": 0,
        "inputs[1].ain": 1,
        "channels": ["a", "b"],
        "none": [],
    }
