"""The Tau 2 on its emulated grabber: questions inside the stream, every fault, slave of a line, a recording."""

from __future__ import annotations

import time
from contextlib import contextmanager

import numpy as np
import pytest

from thermacq.devices import DeviceContext, FrameFlag, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Emulation
from thermacq.store import open_run
from thermacq.testing.emulation.scene import frame_number
from thermacq.testing.emulators.tau2 import attach
from thermacq.timing.clock import RealClock, VirtualClock
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.tau2.camera import Tau2Camera, discover

from .bench import KeepingHost, record_emulated, take_frames

# Faster than any real one, to keep the tests short.
RATE_HZ = 75.0
QUICK = {"ffc_at_arm": False, "timeout_s": 1.0, "own_rate_hz": RATE_HZ}


@contextmanager
def emulated(tmp_path, name="left", clock=None, **settings):
    with attach(
        Emulation(name, clock or RealClock(), tmp_path, {"size": "336", "own_rate_hz": RATE_HZ} | settings)
    ) as transports:
        yield transports


@contextmanager
def opened(tmp_path, settings=None, clock=None, **emulation):
    """Camera that answers; in virtual time, where no frame is lost to a busy computer."""
    clock = clock or VirtualClock()
    with emulated(tmp_path, clock=clock, **emulation) as transports:
        given = QUICK | (settings or {})
        camera = Tau2Camera(DeviceContext("left", clock, transports=transports, settings=given))
        camera.clock, camera.plug = clock, transports.usb[0]
        try:
            camera.open()
            camera.configure(given)
            yield camera, transports.usb[0].device
        finally:
            camera.close()


@contextmanager
def armed(tmp_path, settings=None, clock=None, **emulation):
    with opened(tmp_path, settings, clock, **emulation) as (camera, grabber):
        camera.arm(TriggerMode.FREE_RUN, RATE_HZ)
        yield camera, grabber


def take(camera, number):
    """Numbers in the pictures, flags and temperatures of so many frames, and how often damage was told of."""
    frames, told = take_frames(camera, number)
    return [(frame_number(frame.counts), frame.flags, frame.fpa_temperature_k) for frame in frames], len(told)


@pytest.mark.parametrize(("size", "shape"), [("640", (512, 640)), ("336", (256, 336))])
def test_pictures_and_temperature_arrive(tmp_path, size, shape):
    with armed(tmp_path, size=size, fpa_celsius=-5.5) as (camera, _):
        assert (camera.capabilities.rows, camera.capabilities.columns) == shape
        frames, damaged = take(camera, 8)
    assert damaged == 0
    assert {round(kelvin, 3) for *_, kelvin in frames} == {273.15 - 5.5}


def test_it_says_who_it_is(tmp_path):
    with emulated(tmp_path) as transports:
        camera = Tau2Camera(DeviceContext("left", RealClock(), transports=transports))
        identity = camera.open()
        camera.close()
        assert (identity.serial, identity.firmware) == ("EMU-left", "12.0.3.44")
        assert identity.model.startswith("FLIR Tau 2 no. ")
        assert [one.serial for one in discover(transports)] == ["EMU-left"]


def test_ffc_mode_and_ffc_at_arming(tmp_path):
    with opened(tmp_path, {"ffc_mode": "external", "ffc_at_arm": True}, ffc_s=0.3) as (camera, grabber):
        assert grabber._core.words[0x0B] == 2
        began_ns = camera.clock.now_ns()
        camera.arm(TriggerMode.FREE_RUN, RATE_HZ)
        assert camera.clock.now_ns() - began_ns >= 0.3e9
        frames, _ = take(camera, 4)
    assert not any(flags for _, flags, _ in frames)


def test_a_correction_under_way_is_flagged(tmp_path):
    fault = {"kind": "shutter_freeze", "at": 20, "seconds": 0.5}
    with armed(tmp_path, {"temperature_every_s": 0.5}, faults=[fault]) as (camera, _):
        frames, _ = take(camera, 90)
    numbers = np.array([number for number, *_ in frames])
    closed = np.array([bool(flags & FrameFlag.SHUTTER) for _, flags, _ in frames])
    still = np.flatnonzero(np.diff(numbers) == 0) + 1
    assert still.size >= 8
    assert closed[still].all()
    assert not closed[: still[0] - 1].any()
    assert not closed[-5:].any()


@pytest.mark.parametrize(
    ("fault", "told", "missing"),
    [
        ({"kind": "short_read", "at": 30, "amount": 1000}, 1, 1),
        ({"kind": "short_read", "at": 30, "amount": 1000, "items": 2}, 2, 2),
        ({"kind": "bad_crc", "at": 30}, 1, 1),
        ({"kind": "bad_crc", "at": 30, "items": 3}, 3, 3),
        ({"kind": "stall", "at": 30}, 1, 1),
        ({"kind": "garbage", "at": 30, "amount": 300}, 0, 0),
        ({"kind": "drop", "at": 30, "items": 2}, 0, 2),
        ({"kind": "timeout", "at": 30}, 0, 1),
        ({"kind": "slow", "at": 30, "seconds": 0.03}, 0, 0),
        ({"kind": "duplicate", "at": 30}, 0, -1),
    ],
)
def test_every_fault_shows_as_what_it_is(tmp_path, fault, told, missing):
    """Frames that never came are missed by nobody, as there is no counter: only their number tells."""
    with armed(tmp_path, faults=[fault]) as (camera, grabber):
        frames, damaged = take(camera, 45)
        injected = sum(grabber._schedule.injected.values())
    numbers = [number for number, *_ in frames]
    assert injected == fault.get("items", 1)
    assert damaged == told
    assert numbers[-1] - numbers[0] + 1 - len(numbers) == missing


@pytest.mark.parametrize(
    "fault",
    [{"kind": "bad_crc", "at": 2}, {"kind": "drop", "at": 3}, {"kind": "garbage", "at": 1, "amount": 7}],
)
def test_damaged_answers_are_asked_for_again(tmp_path, monkeypatch, fault):
    monkeypatch.setattr("thermacq_drivers.tau2.link._ANSWER_S", 0.5)
    with armed(tmp_path, serial_faults=[fault]) as (camera, grabber):
        frames, damaged = take(camera, 3)
        assert sum(grabber._core._serial_schedule.injected.values()) == 1
    assert (len(frames), damaged) == (3, 0)


def test_as_a_slave_it_takes_a_picture_for_each_pulse(tmp_path):
    line = LineWriter(tmp_path, "trigger")
    with opened(tmp_path, clock=RealClock()) as (camera, grabber):
        camera.arm(TriggerMode.HARDWARE, 20.0)
        assert grabber._core.words[0x21] == 1
        line.start_session()
        stream, numbers = camera.frames(KeepingHost(camera)), []
        for _ in range(8):
            line.emit(RealClock().now_ns())
            numbers.append(frame_number(next(stream).counts))
            time.sleep(0.05)
        camera.disarm()
    assert numbers == list(range(8))


def test_the_number_of_the_slave_can_be_set(tmp_path):
    with opened(tmp_path, {"sync_slave": 5, "timeout_s": 0.3}, RealClock(), slave_number=5) as (
        camera,
        grabber,
    ):
        camera.arm(TriggerMode.HARDWARE, 20.0)
        assert grabber._core.words[0x21] == 5
        with pytest.raises(DeviceTimeout, match=r"no frame came for 0\.3 s") as caught:
            take(camera, 1)
        assert "trigger line" in caught.value.remedy
        camera.disarm()
        assert grabber._core.words[0x21] == 0


def test_a_camera_left_as_a_slave_is_opened(tmp_path):
    with armed(tmp_path, left_as_slave=True) as (camera, _):
        assert len(take(camera, 3)[0]) == 3


def test_silence_and_a_pulled_plug_are_typed(tmp_path):
    silent = [{"kind": "timeout", "at": 30, "seconds": 60}]
    with (
        armed(tmp_path, {"timeout_s": 0.3}, RealClock(), faults=silent) as (camera, _),
        pytest.raises(DeviceTimeout, match="no frame came"),
    ):
        take(camera, 100)
    pulled = [{"kind": "disconnect", "at": 30}]
    with armed(tmp_path, faults=pulled) as (camera, _), pytest.raises(DeviceDisconnected, match="gone"):
        take(camera, 100)


def test_it_works_again_after_it_was_plugged_in_again(tmp_path):
    with armed(tmp_path, faults=[{"kind": "disconnect", "at": 30}]) as (camera, _):
        with pytest.raises(DeviceDisconnected):
            take(camera, 100)
        camera.close()
        camera.plug.plug()
        assert camera.open().serial == "EMU-left"
        camera.configure(QUICK)
        camera.arm(TriggerMode.FREE_RUN, RATE_HZ)
        assert len(take(camera, 5)[0]) == 5


@pytest.mark.parametrize(
    ("emulation", "words"),
    [
        ({"output_on": False}, "the camera answers, but no picture came"),
        ({"serial_faults": [{"kind": "drop", "at": 0, "items": 1000}]}, "did not answer to function 04"),
    ],
)
def test_what_is_wrong_behind_the_grabber_is_told(tmp_path, monkeypatch, emulation, words):
    monkeypatch.setattr("thermacq_drivers.tau2.camera._FIRST_PICTURE_S", 0.3)
    monkeypatch.setattr("thermacq_drivers.tau2.link._ANSWER_S", 0.2)
    with emulated(tmp_path, **emulation) as transports:
        camera = Tau2Camera(DeviceContext("left", RealClock(), transports=transports))
        with pytest.raises(DeviceTimeout, match=words):
            camera.open()


def test_two_cameras_never_swap(tmp_path):
    with emulated(tmp_path, "a") as one, emulated(tmp_path, "b") as two:
        both = one + two
        with pytest.raises(DeviceFault, match="several devices fit"):
            Tau2Camera(DeviceContext("cam", RealClock(), transports=both)).open()
        for serial in ("EMU-b", "EMU-a"):
            camera = Tau2Camera(DeviceContext("cam", RealClock(), transports=both, serial=serial))
            assert camera.open().serial == serial
            camera.close()


@pytest.mark.parametrize(
    ("mode", "rate_hz", "words"),
    [
        (TriggerMode.FREE_RUN, 25.0, "by itself it makes 75"),
        (TriggerMode.HARDWARE, 80.0, "at most 75 possible"),
        (TriggerMode.SOFTWARE, 30.0, "cannot run in mode"),
    ],
)
def test_what_it_cannot_do_is_refused(tmp_path, mode, rate_hz, words):
    with opened(tmp_path) as (camera, _), pytest.raises(DeviceFault, match=words):
        camera.arm(mode, rate_hz)


RIG = """
name = "Tau 2"
[trigger]
mode = "free_run"
frame_rate_hz = 30
[store]
reserve_mb = 1
[cameras.left]
driver = "tau2"
[emulation.left]
size = "336"
faults = [{ kind = "short_read", at = 60, amount = 500 }]
"""


@pytest.mark.slow
def test_a_recording(tmp_path, monkeypatch):
    _, file = record_emulated(tmp_path, monkeypatch, RIG, "--frames", "60")
    with open_run(file) as run:
        assert run.frame_count("left") == 60
        assert run.summary()["sync"]["devices"]["left"]["lost"]["incomplete"] == 1
