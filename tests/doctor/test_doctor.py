"""The doctor, on computers made of files, and once on this one."""

from __future__ import annotations

import json
import os

import pytest
from typer.testing import CliRunner

from thermacq.cli.app import app
from thermacq.devices import DeviceKind
from thermacq.doctor import Verdict, checks, udev_rules, usb_bus
from thermacq.hooks import Driver, Evidence

CAMERA = Driver(
    "cam",
    DeviceKind.CAMERA,
    "a camera",
    Evidence.EMULATED,
    make=None,
    settings=None,
    usb_ids=((0x1234, 0x00AB),),
)
PROBE = Driver(
    "gauge", DeviceKind.WAVE_PROBE, "a gauge", Evidence.EMULATED, make=None, settings=None, usb_ids=((1, 2),)
)


def put(root, path, text):
    file = root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"{text}\n")


def plug(root, name, bus, device, speed, vid="1234", pid="00ab", mode=0o660):
    facts = {
        "idVendor": vid,
        "idProduct": pid,
        "busnum": bus,
        "devnum": device,
        "speed": speed,
        "product": "Cam",
    }
    for key, value in facts.items():
        put(root, f"sys/bus/usb/devices/{name}/{key}", value)
    put(root, f"dev/bus/usb/{bus:03d}/{device:03d}", "")
    (root / f"dev/bus/usb/{bus:03d}/{device:03d}").chmod(mode)


@pytest.mark.parametrize(
    ("check", "path", "good", "bad", "word"),
    [
        (checks.socket_memory, "proc/sys/net/core/rmem_max", "8388608", "212992", "sysctl"),
        (checks.usb_memory, "sys/module/usbcore/parameters/usbfs_memory_mb", "256", "16", "usbfs_memory_mb"),
        (
            checks.clock_source,
            "sys/devices/system/clocksource/clocksource0/current_clocksource",
            "tsc",
            "hpet",
            "kernel log",
        ),
        (
            checks.power_saving,
            "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
            "performance",
            "powersave",
            "cpupower",
        ),
    ],
)
def test_facts_of_the_kernel(tmp_path, check, path, good, bad, word):
    put(tmp_path, path, good)
    assert check(tmp_path).verdict is Verdict.OK
    put(tmp_path, path, bad)
    found = check(tmp_path)
    assert found.verdict is Verdict.WARNING
    assert bad in found.found or "MiB" in found.found
    assert word in found.remedy


def test_a_kernel_that_tells_nothing_is_no_traceback(tmp_path):
    for check in (checks.socket_memory, checks.usb_memory, checks.clock_source):
        assert "unknown" in check(tmp_path).found
    put(tmp_path, "proc/sys/net/core/rmem_max", "much")
    assert "unknown" in checks.socket_memory(tmp_path).found


def test_two_cameras_on_one_narrow_bus(tmp_path):
    plug(tmp_path, "1-1", 1, 4, "480")
    assert [check.verdict for check in usb_bus.shared_buses([CAMERA], tmp_path)] == [Verdict.OK]
    plug(tmp_path, "1-2", 1, 5, "480")
    (crowded,) = usb_bus.shared_buses([CAMERA], tmp_path)
    assert (crowded.verdict, crowded.name) == (Verdict.WARNING, "USB bus 1")
    assert "2 cameras share" in crowded.found


def test_cameras_on_their_own_or_faster_buses_are_fine(tmp_path):
    plug(tmp_path, "1-1", 1, 4, "480")
    plug(tmp_path, "2-1", 2, 2, "480")
    plug(tmp_path, "3-1", 3, 2, "5000")
    plug(tmp_path, "3-2", 3, 3, "5000")
    assert [check.verdict for check in usb_bus.shared_buses([CAMERA], tmp_path)] == [Verdict.OK]


def test_a_camera_behind_a_slow_cable(tmp_path):
    plug(tmp_path, "1-1", 1, 4, "12")
    (slow,) = usb_bus.shared_buses([CAMERA], tmp_path)
    assert slow.verdict is Verdict.PROBLEM
    assert "12 Mbit/s" in slow.found


def test_devices_of_no_driver_and_interfaces_are_left_alone(tmp_path):
    plug(tmp_path, "1-1", 1, 4, "480", vid="ffff")
    put(tmp_path, "sys/bus/usb/devices/1-1:1.0/bInterfaceClass", "0e")
    assert usb_bus.attached([CAMERA, PROBE], tmp_path) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_a_device_that_may_not_be_opened(tmp_path):
    plug(tmp_path, "1-1", 1, 4, "480", mode=0)
    first = usb_bus.permissions([CAMERA], tmp_path)[0]
    assert first.verdict is Verdict.PROBLEM
    assert "--udev-rules" in first.remedy


def test_a_device_that_is_reached_through_its_port_is_no_problem(tmp_path, monkeypatch):
    plug(tmp_path, "1-1", 1, 4, "480")
    plug(tmp_path, "1-2", 1, 5, "480")
    put(tmp_path, "sys/bus/usb/devices/1-2/1-2:1.0/tty/ttyACM0/dev", "166:0")
    monkeypatch.setattr(os, "access", lambda path, mode: "bus/usb" not in str(path))
    verdicts = [check.verdict for check in usb_bus.permissions([CAMERA], tmp_path)]
    assert verdicts == [Verdict.PROBLEM, Verdict.WARNING, Verdict.OK, Verdict.OK]


def test_permissions_are_asked_of_the_kernel(tmp_path, monkeypatch):
    plug(tmp_path, "1-1", 1, 4, "480")
    put(tmp_path, "dev/ttyACM0", "")
    put(tmp_path, "dev/video0", "")
    monkeypatch.setattr(
        os, "access", lambda path, mode: "ttyACM0" not in str(path) and "usb" not in str(path)
    )
    device, ports, videos = usb_bus.permissions([CAMERA], tmp_path)
    assert device.verdict is Verdict.PROBLEM
    assert "Cam (1234:00ab)" in device.name
    assert (ports.verdict, ports.found) == (Verdict.PROBLEM, "may not be opened by this user: ttyACM0")
    assert "dialout" in ports.remedy
    assert (videos.verdict, videos.found) == (Verdict.OK, "video0")


def test_udev_rules_name_every_device():
    rules = udev_rules([CAMERA, PROBE])
    assert rules.count("SUBSYSTEM") == 2
    assert 'ATTR{idVendor}=="1234", ATTR{idProduct}=="00ab"' in rules
    assert all(line.startswith(("#", "SUBSYSTEM==")) for line in rules.splitlines())


def test_disk_speed_is_judged_against_the_need_and_leaves_nothing(tmp_path):
    assert checks.disk_speed(tmp_path, 1.0, 1 << 20).verdict is Verdict.OK
    assert checks.disk_speed(tmp_path, 1e15, 1 << 20).verdict is Verdict.PROBLEM
    assert list(tmp_path.iterdir()) == []
    missing = checks.disk_speed(tmp_path / "no", 1.0, 1 << 20)
    assert (missing.verdict, "No such file" in missing.found) == (Verdict.PROBLEM, True)


def test_plugins_that_were_not_loaded_are_problems():
    (broken,) = checks.plugin_failures({"lab": "ImportError: needs x"})
    assert (broken.verdict, "needs x" in broken.found) == (Verdict.PROBLEM, True)
    assert [check.verdict for check in checks.plugin_failures({})] == [Verdict.OK]


def test_missing_libraries_name_their_packages(monkeypatch):
    monkeypatch.setattr(checks, "_has_libusb", lambda: False)
    monkeypatch.setattr(checks, "_has_aravis", lambda: False)
    assert ["apt install" in check.remedy for check in checks.libraries()] == [True, True]


def test_the_command_on_this_computer(tmp_path):
    done = CliRunner().invoke(app, ["doctor", "--folder", str(tmp_path), "--json"])
    assert done.exit_code in (0, 3)
    found = {check["name"] for check in json.loads(done.stdout)["checks"]}
    assert {"libusb", "Aravis", "clock source", "real-time priority", "serial ports"} <= found
    rules = CliRunner().invoke(app, ["doctor", "--udev-rules"])
    assert 'ATTR{idVendor}=="289d", ATTR{idProduct}=="0010"' in rules.stdout
