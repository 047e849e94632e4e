"""The P2 Pro: worked requests, its thermal half, and the driver on its emulated camera with faults."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from thermacq.devices import DeviceContext, FrameFlag, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Emulation
from thermacq.store import open_run
from thermacq.testing.emulation.scene import frame_number
from thermacq.testing.emulators.p2pro import attach
from thermacq.timing.clock import RealClock, VirtualClock
from thermacq_drivers.p2pro import codec
from thermacq_drivers.p2pro.camera import P2ProCamera, discover
from thermacq_drivers.p2pro.codec import Info, Parameter

from .bench import KeepingHost, record_emulated, take_frames


@contextmanager
def emulated(tmp_path, name="left", clock=None, **settings):
    with attach(Emulation(name, clock or RealClock(), tmp_path, settings)) as transports:
        yield transports


@contextmanager
def armed(tmp_path, settings=None, clock=None, **emulation):
    """Camera that streams; in virtual time, where no frame is lost to a busy computer."""
    clock = clock or VirtualClock()
    with emulated(tmp_path, clock=clock, **emulation) as transports:
        camera = P2ProCamera(DeviceContext("left", clock, transports=transports))
        try:
            camera.open()
            camera.configure({"timeout_s": 1.0} | (settings or {}))
            camera.arm(TriggerMode.FREE_RUN, 25.0)
            yield camera, transports
        finally:
            camera.close()


def take(camera, number):
    """Numbers in the pictures and flags of so many frames, and how often a damaged one was told of."""
    frames, told = take_frames(camera, number)
    assert {(frame.counter, frame.ticks) for frame in frames} == {(-1, -1)}
    return [(frame_number(frame.counts), frame.flags) for frame in frames], len(told)


def test_worked_requests():
    assert codec.read_info(Info.SERIAL) == bytes.fromhex("05 84 07 00 00 00 00 10")
    read_gain = codec.read_parameter(Parameter.GAIN)
    assert read_gain == (bytes.fromhex("14 85 00 05 00 00 00 00"), bytes.fromhex("00 00 00 00 00 00 00 02"))
    assert codec.set_parameter(Parameter.GAIN, 1) == (bytes.fromhex("14 C5 00 05 00 00 00 01"), bytes(8))
    emissivity = codec.set_parameter(Parameter.EMISSIVITY, codec.emissivity_steps(0.95))
    assert emissivity == (bytes.fromhex("14 C5 00 03 00 00 00 79"), bytes(8))


@given(st.binary(max_size=3))
def test_any_status_is_ready_busy_or_refused(data):
    try:
        ready = codec.is_ready(data)
    except ValueError:
        assert len(data) != 1 or data[0] >= 4
    else:
        assert ready == (data == b"\x00")


@given(st.binary(max_size=5))
def test_any_answer_is_a_number_or_refused(data):
    try:
        assert codec.parse_number(data) == 256 * data[0] + data[1]
    except ValueError:
        assert len(data) != 2
    assert codec.parse_text(data).isprintable()


@given(st.floats(1e-6, 1))
def test_emissivity_is_that_of_its_step(emissivity):
    steps = codec.emissivity_steps(emissivity)
    assert 1 <= steps <= 127
    assert codec.emissivity_steps(codec.emissivity_of(steps)) == steps
    assert abs(codec.emissivity_of(steps) - emissivity) <= 1 / 127


@given(hnp.arrays(np.uint8, hnp.array_shapes(max_dims=3, max_side=20)))
def test_pictures_of_any_other_size_are_refused(picture):
    with pytest.raises(ValueError, match="bytes came"):
        codec.thermal(picture)


@pytest.mark.parametrize("shape", [(384, 256, 2), (384, 512), (1, 196608)])
def test_the_thermal_half_in_whatever_shape(shape):
    words = np.arange(384 * 256, dtype="<u4").astype("<u2")
    np.testing.assert_array_equal(
        codec.thermal(words.view(np.uint8).reshape(shape)).ravel(), words[192 * 256 :]
    )


def test_temperatures_and_settings_arrive(tmp_path):
    with armed(tmp_path, {"gain": "low", "emissivity": 0.98}) as (camera, transports):
        celsius = next(camera.frames(KeepingHost(camera))).counts / 64 - 273.15
        parameters = transports.usb[0].device.parameters
    assert abs(np.median(celsius) - 20) < 6
    assert (parameters[5], parameters[3]) == (0, 124)
    assert (parameters[0], parameters[4]) == (40, 127)  # the others as they were


def test_it_says_who_it_is(tmp_path):
    with emulated(tmp_path) as transports:
        camera = P2ProCamera(DeviceContext("left", RealClock(), transports=transports))
        identity = camera.open()
        assert not transports.video[0].device.streams
        assert (identity.model, identity.serial, identity.firmware) == ("P2 Pro", "EMU-left", "20230101")
        assert [one.serial for one in discover(transports)] == ["EMU-left"]


def test_the_emissivity_in_force_is_told(tmp_path):
    with armed(tmp_path) as (camera, _):
        applied = camera.configure({"emissivity": 0.96})
        assert applied["emissivity"] == pytest.approx(122 / 127)
        assert camera.configure(applied) == applied


@pytest.mark.parametrize(
    ("fault", "told", "missing"),
    [
        ({"kind": "garbage", "at": 6}, 1, 1),
        ({"kind": "garbage", "at": 6, "items": 2}, 2, 2),
        ({"kind": "drop", "at": 6, "items": 3}, 0, 3),
        ({"kind": "short_read", "at": 6}, 0, 1),
        ({"kind": "timeout", "at": 6}, 0, 1),
        ({"kind": "stall", "at": 6}, 0, 1),
        ({"kind": "slow", "at": 6, "seconds": 0.06}, 0, 0),
    ],
)
def test_every_fault_shows_as_what_it_is(tmp_path, fault, told, missing):
    """Without a counter, pictures that the kernel threw away are missed by nobody: only their number tells."""
    with armed(tmp_path, faults=[fault]) as (camera, transports):
        frames, damaged = take(camera, 14)
        injected = sum(transports.video[0].device._schedule.injected.values())
    numbers = [number for number, _ in frames]
    assert injected == fault.get("items", 1)
    assert damaged == told
    assert numbers[-1] - numbers[0] + 1 - len(numbers) == missing
    assert not any(flags for _, flags in frames)


def test_a_picture_that_stands_still_is_flagged(tmp_path):
    faults = [{"kind": "shutter_freeze", "at": 6, "seconds": 0.2}, {"kind": "duplicate", "at": 14}]
    with armed(tmp_path, faults=faults) as (camera, _):
        frames, _ = take(camera, 18)
    assert sum(flags is FrameFlag.SHUTTER for _, flags in frames) == 4 + 1


def test_silence_and_unplugging_are_typed(tmp_path):
    silent = [{"kind": "timeout", "at": 6, "seconds": 60}]
    with (
        armed(tmp_path, {"timeout_s": 0.3}, RealClock(), faults=silent) as (camera, _),
        pytest.raises(DeviceTimeout, match=r"no frame within 0\.3 s"),
    ):
        take(camera, 30)
    pulled = [{"kind": "disconnect", "at": 6}]
    with (
        armed(tmp_path, faults=pulled) as (camera, _),
        pytest.raises(DeviceDisconnected, match="is gone"),
    ):
        take(camera, 30)


def test_it_works_again_after_it_was_plugged_in_again(tmp_path):
    with armed(tmp_path, faults=[{"kind": "disconnect", "at": 6}]) as (camera, transports):
        with pytest.raises(DeviceDisconnected):
            take(camera, 30)
        camera.close()
        for plug in (*transports.usb, *transports.video):
            plug.plug()
        assert camera.open().serial == "EMU-left"
        camera.configure({})
        camera.arm(TriggerMode.FREE_RUN, 25.0)
        frames, damaged = take(camera, 5)
    assert (len(frames), damaged) == (5, 0)


@pytest.mark.parametrize(
    ("emulation", "kind", "words"),
    [
        ({"refuses": 4}, DeviceFault, r"refused a command \(status 04\)"),
        ({"only_picture": True}, DeviceFault, "no picture of 256 x 384"),
        ({"faults": [{"kind": "drop", "at": 0, "items": 1000}]}, DeviceTimeout, "no picture came"),
    ],
)
def test_a_camera_that_does_not_do_its_part_is_told(tmp_path, monkeypatch, emulation, kind, words):
    monkeypatch.setattr("thermacq_drivers.p2pro.camera._FIRST_PICTURE_S", 0.3)
    with emulated(tmp_path, **emulation) as transports:
        camera = P2ProCamera(DeviceContext("left", RealClock(), transports=transports))
        with pytest.raises(kind, match=words):
            camera.open()
        camera.close()
        assert not transports.video[0].device.streams


def test_requests_before_the_picture_streams_end_in_time(tmp_path):
    from thermacq_drivers.p2pro.control import P2ProControl

    with emulated(tmp_path) as transports:
        control = P2ProControl("left", transports, transports.video_nodes()[0])
        with pytest.raises(DeviceTimeout):
            control.text(Info.SERIAL, "open")
        control.close()


@pytest.mark.parametrize("on_usb", [True, False])
def test_two_cameras_never_swap(tmp_path, on_usb):
    with (
        emulated(tmp_path, "a", serial_on_usb=on_usb) as one,
        emulated(tmp_path, "b", serial_on_usb=on_usb) as two,
    ):
        # The second hangs on the second socket.
        two.video[0]._node = replace(two.video[0]._node, location="1-2")
        both = one + two
        with pytest.raises(DeviceFault, match="several cameras fit"):
            P2ProCamera(DeviceContext("cam", RealClock(), transports=both)).open()
        for serial in ("EMU-b", "EMU-a"):
            camera = P2ProCamera(DeviceContext("cam", RealClock(), transports=both, serial=serial))
            assert camera.open().serial == serial
            camera.close()
        with pytest.raises(DeviceDisconnected, match="'EMU-c'"):
            P2ProCamera(DeviceContext("cam", RealClock(), transports=both, serial="EMU-c")).open()


@pytest.mark.parametrize(
    ("mode", "rate_hz", "words"),
    [(TriggerMode.FREE_RUN, 50.0, "always makes 25"), (TriggerMode.SOFTWARE, 25.0, "knows no trigger")],
)
def test_what_it_cannot_do_is_refused(tmp_path, mode, rate_hz, words):
    with armed(tmp_path) as (camera, _), pytest.raises(DeviceFault, match=words):
        camera.arm(mode, rate_hz)


RIG = """
name = "P2 Pro"
[trigger]
mode = "free_run"
frame_rate_hz = 25
[store]
reserve_mb = 1
[cameras.left]
driver = "p2pro"
"""


@pytest.mark.slow
def test_a_recording(tmp_path, monkeypatch):
    _, file = record_emulated(tmp_path, monkeypatch, RIG, "--frames", "40")
    with open_run(file) as run:
        assert run.frame_count("left") == 40
        numbers = [frame_number(run.counts("left", index)) for index in range(40)]
    assert np.all(np.diff(numbers) >= 1)
