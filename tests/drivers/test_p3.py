"""The P3 driver on its emulated camera: start sequence, every fault, two cameras, a whole recording."""

from __future__ import annotations

import json
from contextlib import contextmanager

import numpy as np
import pytest

from thermacq.devices import DeviceContext, FrameFlag, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Emulation
from thermacq.store import open_run
from thermacq.testing.emulation.scene import frame_number
from thermacq.testing.emulators.p3 import attach
from thermacq.timing.clock import RealClock, VirtualClock
from thermacq_drivers.p3.camera import P3Camera, discover

from .bench import KeepingHost, record_emulated, take_frames

QUICK = {"settle_s": 0.0, "stream_settle_s": 0.0, "timeout_s": 1.0, "shutter_at_arm": False}


@contextmanager
def emulated(tmp_path, name="left", clock=None, **settings):
    with attach(Emulation(name, clock or RealClock(), tmp_path, settings)) as transports:
        yield transports


@contextmanager
def armed(tmp_path, settings=None, clock=None, **emulation):
    """Camera that streams; in virtual time, where no frame is lost to a busy computer."""
    clock = clock or VirtualClock()
    with emulated(tmp_path, clock=clock, **emulation) as transports:
        camera = P3Camera(DeviceContext("left", clock, transports=transports))
        try:
            camera.open()
            camera.configure(QUICK | (settings or {}))
            camera.arm(TriggerMode.FREE_RUN, 25.0)
            camera.plug = transports.usb[0]
            yield camera
        finally:
            camera.close()


def take(camera, number):
    """Counters, numbers in the pictures, flags of so many frames, and how often a damaged one was told of."""
    frames, told = take_frames(camera, number)
    return [(frame.counter, frame_number(frame.counts), frame.flags) for frame in frames], len(told)


def lost(frames):
    counters = [frame[0] for frame in frames]
    return counters[-1] - counters[0] + 1 - len(counters)


@pytest.mark.parametrize(("model", "shape"), [("P3", (192, 256)), ("P1", (120, 160))])
def test_temperatures_arrive(tmp_path, model, shape):
    with armed(tmp_path, model=model) as camera:
        declared = camera.capabilities
        assert (declared.rows, declared.columns) == shape
        frame = next(camera.frames(KeepingHost(camera)))
        assert frame.flags is FrameFlag.NONE
        celsius = frame.counts / 64 - 273.15
        assert abs(np.median(celsius) - 20.0) < 6
        assert celsius.max() < 40


def test_the_whole_start_sequence(tmp_path):
    settings = {"shutter_at_arm": True, "gain": "low", "settle_s": 0.1, "stream_settle_s": 0.1}
    with armed(tmp_path, settings, busy_polls=2) as camera:
        kinds = [command[:4].hex() + command[4:5].hex() for command in camera.plug.device.commands]
        texts = ["0101810001", "0101810002", "0101810007"]
        assert kinds == [*texts, "012f410000", "012f810000", "012f810000", "0136430000"]
        frames, damaged = take(camera, 5)
    assert (lost(frames), damaged) == (0, 0)


def test_it_says_who_it_is(tmp_path):
    with emulated(tmp_path) as transports:
        camera = P3Camera(DeviceContext("left", RealClock(), transports=transports))
        identity = camera.open()
        camera.close()
        assert (identity.model, identity.serial, identity.firmware) == ("P3", "EMU-left", "00.00.02.17")
        assert [one.serial for one in discover(transports)] == ["EMU-left"]


@pytest.mark.parametrize(
    ("fault", "told", "missing"),
    [
        ({"kind": "bad_crc", "at": 5}, 1, 1),
        ({"kind": "bad_crc", "at": 5, "items": 2}, 1, 2),
        ({"kind": "short_read", "at": 5, "amount": 700}, 1, 1),
        ({"kind": "stall", "at": 5}, 1, 1),
        ({"kind": "drop", "at": 5, "items": 3}, 0, 3),
        ({"kind": "timeout", "at": 5}, 0, 1),
        ({"kind": "counter_jump", "at": 5, "amount": 30}, 0, 30),
        ({"kind": "garbage", "at": 5, "amount": 3000}, 0, 0),
        ({"kind": "duplicate", "at": 5}, 0, 0),
        ({"kind": "slow", "at": 5, "seconds": 0.06}, 0, 0),
    ],
)
def test_every_fault_shows_as_what_it_is(tmp_path, fault, told, missing):
    with armed(tmp_path, faults=[fault]) as camera:
        frames, damaged = take(camera, 14)
        injected = sum(camera.plug.device._schedule.injected.values())
    assert injected == fault.get("items", 1)
    assert (damaged, lost(frames)) == (told, missing)
    steps = np.diff([frame[0] for frame in frames])
    np.testing.assert_array_equal(steps, np.diff([frame[1] for frame in frames]))


def test_the_camera_counts_on_across_its_wraps(tmp_path):
    # The count of milliseconds turns round every 51.2 frames.
    with armed(tmp_path, counter_start=250) as camera:
        frames, damaged = take(camera, 56)
    assert (lost(frames), damaged) == (0, 0)
    assert frames[0][1] >= 250


def test_a_closed_shutter_is_flagged(tmp_path):
    fault = {"kind": "shutter_freeze", "at": 4, "seconds": 0.2}
    with armed(tmp_path, faults=[fault]) as camera:
        frames, _ = take(camera, 14)
    assert (
        sum(bool(flags & FrameFlag.SHUTTER) for *_, flags in frames) == 4
    )  # the first of five is not told apart
    assert lost(frames) == 0


def test_its_own_shutter_comes_again_and_again(tmp_path):
    with armed(tmp_path, shutter_every_s=0.4, shutter_s=0.12) as camera:
        frames, _ = take(camera, 30)
    closed = [bool(flags & FrameFlag.SHUTTER) for *_, flags in frames]
    begins = [n for n in range(1, 30) if closed[n] and not closed[n - 1]]
    assert set(np.diff(begins)) == {10}


def test_a_shutter_at_arming_costs_no_frame(tmp_path):
    with armed(tmp_path, {"shutter_at_arm": True}) as camera:
        frames, damaged = take(camera, 6)
    assert (lost(frames), damaged) == (0, 0)


def test_silence_is_a_timeout_and_a_pulled_plug_is_told(tmp_path):
    silent = [{"kind": "timeout", "at": 4, "seconds": 60}]
    with armed(tmp_path, {"timeout_s": 0.3}, RealClock(), faults=silent) as camera:
        with pytest.raises(DeviceTimeout, match=r"no whole frame within 0\.3 s") as caught:
            take(camera, 20)
        assert caught.value.last_frame >= 2
    with (
        armed(tmp_path, faults=[{"kind": "disconnect", "at": 4}]) as camera,
        pytest.raises(DeviceDisconnected, match="gone from USB"),
    ):
        take(camera, 20)


def test_a_camera_that_stays_busy_is_told(tmp_path):
    with emulated(tmp_path, busy_polls=1000) as transports:
        camera = P3Camera(DeviceContext("left", RealClock(), transports=transports))
        with pytest.raises(DeviceTimeout, match="status 01"):
            camera.open()


def test_it_works_again_after_it_was_plugged_in_again(tmp_path):
    with armed(tmp_path, faults=[{"kind": "disconnect", "at": 4}]) as camera:
        with pytest.raises(DeviceDisconnected):
            take(camera, 20)
        camera.close()
        with pytest.raises(DeviceDisconnected, match="EMU-left"):
            camera.open()
        camera.plug.plug()
        assert camera.open().serial == "EMU-left"
        camera.configure(QUICK)
        camera.arm(TriggerMode.FREE_RUN, 25.0)
        frames, damaged = take(camera, 5)
    assert (lost(frames), damaged) == (0, 0)


@pytest.mark.parametrize("on_usb", [True, False])
def test_two_cameras_never_swap(tmp_path, on_usb):
    with (
        emulated(tmp_path, "a", serial_on_usb=on_usb) as one,
        emulated(tmp_path, "b", serial_on_usb=on_usb) as two,
    ):
        both = one + two
        with pytest.raises(DeviceFault, match="several devices fit"):
            P3Camera(DeviceContext("cam", RealClock(), transports=both)).open()
        cameras = {
            serial: P3Camera(DeviceContext("cam", RealClock(), transports=both, serial=serial))
            for serial in ("EMU-b", "EMU-a")
        }
        for serial, camera in cameras.items():
            assert camera.open().serial == serial
        with pytest.raises(DeviceDisconnected, match=r"'EMU-c'.*EMU|another program uses it"):
            P3Camera(DeviceContext("cam", RealClock(), transports=both, serial="EMU-c")).open()
        for camera in cameras.values():
            camera.close()


@pytest.mark.parametrize(
    ("mode", "rate_hz", "words"),
    [
        (TriggerMode.FREE_RUN, 30.0, "always makes 25"),
        (TriggerMode.FREE_RUN, 10.0, "always makes 25"),
        (TriggerMode.HARDWARE, 25.0, "knows no trigger"),
    ],
)
def test_what_it_cannot_do_is_refused(tmp_path, mode, rate_hz, words):
    with armed(tmp_path) as camera, pytest.raises(DeviceFault, match=words):
        camera.arm(mode, rate_hz)


def test_wrong_order_and_settings_are_typed(tmp_path):
    with armed(tmp_path) as camera:
        with pytest.raises(DeviceFault, match="no_such"):
            camera.configure({"no_such": 1})
        camera.disarm()
        with pytest.raises(DeviceFault, match="not armed"):
            next(camera.frames(KeepingHost(camera)))
        camera.close()
        with pytest.raises(DeviceFault, match="not open"):
            camera.arm(TriggerMode.FREE_RUN, 25.0)


PAIR = """
name = "two P3"
[trigger]
mode = "free_run"
frame_rate_hz = 25
[store]
reserve_mb = 1
[cameras.left]
driver = "p3"
[cameras.right]
driver = "p3"
[emulation.right]
faults = [{ kind = "bad_crc", at = 150 }, { kind = "drop", at = 200, items = 2 }]
"""


@pytest.mark.slow
def test_a_pair_at_its_nominal_rate(tmp_path, monkeypatch):
    """20 s of two cameras, as a user records them: every frame is in the file or its loss is explained."""
    said, file = record_emulated(tmp_path, monkeypatch, PAIR, "--duration", "20", "--json")
    assert json.loads(said)
    with open_run(file) as run:
        devices = run.summary()["sync"]["devices"]
        for name in ("left", "right"):
            frames = run.frames(name)
            counters = np.asarray(frames.counter)
            explained = sum(devices[name]["lost"].values())
            assert counters[-1] - counters[0] + 1 - len(frames) == explained
            assert len(frames) + explained >= 480
        assert devices["right"]["lost"]["incomplete"] == 1
        assert devices["right"]["lost"]["device_gap"] >= 2
