"""The Boson driver on its emulated camera: telemetry, sync, shutter, and each fault against what became of it."""

from __future__ import annotations

import logging
import time
from contextlib import ExitStack
from itertools import pairwise

import numpy as np
import pytest

from thermacq.devices import FrameFlag, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.testing.emulation.faults import FaultKind
from thermacq.testing.emulation.scene import frame_number
from thermacq.timing.clock import NS_PER_S, RealClock
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.boson.camera import BosonCamera, discover

from .bench import KeepingHost as Host
from .bench import take_frames as take
from .boson_bench import QUICK, camera, context, gaps, plugged


@pytest.mark.parametrize("telemetry", ["16-bit", "8-bit"])
def test_telemetry_is_found_in_both_packings(tmp_path, telemetry):
    with camera(tmp_path, telemetry=telemetry) as device:
        assert device.applied["telemetry"] == telemetry
        assert (device.capabilities.rows, device.capabilities.columns) == (256, 320)
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, told = take(device, 20)
    assert told == []
    assert gaps(frames) == 0
    # The picture has no row of telemetry left in it, and the number of its frame.
    assert [frame_number(frame.counts) for frame in frames] == [frame.counter for frame in frames]
    milliseconds = [two.ticks - one.ticks for one, two in pairwise(frames)]
    assert set(milliseconds) <= {16, 17}
    assert [frame.fpa_temperature_k for frame in frames] == pytest.approx(20 * [31.4 + 273.15])
    assert {frame.flags for frame in frames} == {FrameFlag.NONE}


def test_without_telemetry_it_warns_and_gives_host_times(tmp_path, caplog):
    with caplog.at_level(logging.WARNING), camera(tmp_path, telemetry="none") as device:
        assert device.applied["telemetry"] == "none"
        assert device.capabilities.counter_bits == 0
        assert device.capabilities.tick_rate_hz == 0
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, _ = take(device, 5)
    assert "'left': no telemetry row was found" in caplog.text
    assert {(frame.counter, frame.ticks) for frame in frames} == {(-1, -1)}
    assert frames[0].counts.shape == (256, 320)
    assert frame_number(frames[1].counts) == frame_number(frames[0].counts) + 1


def test_telemetry_that_is_demanded_and_not_there_is_refused(tmp_path):
    with plugged(tmp_path, telemetry="8-bit") as transports:
        device = BosonCamera(context(transports))
        device.open()
        with pytest.raises(DeviceFault, match="no telemetry row in 16-bit packing"):
            device.configure({"telemetry": "16-bit"})
        assert device.configure({**QUICK, "telemetry": "8-bit"})["telemetry"] == "8-bit"
        assert device.configure({**QUICK, "telemetry": "none"})["telemetry"] == "none"
        device.close()


def test_the_large_sensor(tmp_path):
    with camera(tmp_path, size="640") as device:
        device.arm(TriggerMode.FREE_RUN, 30)
        frames, told = take(device, 3)
    assert frames[0].counts.shape == (512, 640)
    assert frames[2].ticks - frames[1].ticks in (33, 34)
    assert told == []


def test_a_frozen_camera_is_below_zero(tmp_path):
    with camera(tmp_path, fpa_celsius=-12.3) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, _ = take(device, 1)
    assert frames[0].fpa_temperature_k == pytest.approx(273.15 - 12.3)


def test_the_temperature_is_read_again_between_frames(tmp_path):
    with camera(tmp_path, {"temperature_every_s": 0.5}, clock=RealClock()) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        device._acquisition._temperature_k = 0.0
        frames, _ = take(device, 60)
    assert frames[0].fpa_temperature_k == 0.0
    assert frames[-1].fpa_temperature_k == pytest.approx(304.55)


def test_the_counter_wraps(tmp_path):
    with camera(tmp_path, counter_start=2**32 - 8) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, told = take(device, 20)
    counters = [frame.counter for frame in frames]
    assert min(counters) == 0
    assert max(counters) == 2**32 - 1
    assert (told, gaps(frames)) == ([], 0)


def test_milliseconds_go_on_across_their_wrap(tmp_path):
    with camera(tmp_path) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        made = [device._acquisition._continuous(time_ms) for time_ms in (2**32 - 20, 2**32 - 3, 14, 31)]
    assert np.diff(made).tolist() == [17, 17, 17]


FAULTS = [
    # fault, frames announced as damaged or doubled, frames missing in the count
    ({"kind": "drop", "at": 20, "items": 3}, 0, 3),
    ({"kind": "short_read", "at": 20}, 0, 1),
    ({"kind": "stall", "at": 20}, 0, 1),
    ({"kind": "bad_crc", "at": 20, "items": 2}, 2, 2),
    ({"kind": "duplicate", "at": 20, "items": 2}, 2, 0),
    ({"kind": "counter_jump", "at": 20, "amount": 7}, 0, 7),
    ({"kind": "slow", "at": 20, "seconds": 0.03}, 0, 0),
]


@pytest.mark.parametrize(
    ("fault", "announced", "missing"), FAULTS, ids=[fault[0]["kind"] for fault in FAULTS]
)
def test_each_fault_of_the_picture_is_noticed_and_counted(tmp_path, fault, announced, missing):
    with camera(tmp_path, faults=[fault]) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, told = take(device, 40)
    assert len(told) == announced
    assert gaps(frames) == missing
    assert all(two.ticks > one.ticks for one, two in pairwise(frames))


def test_frames_under_the_shutter_are_flagged(tmp_path):
    fault = {"kind": "shutter_freeze", "at": 20, "seconds": 0.2}
    with camera(tmp_path, faults=[fault]) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, _ = take(device, 50)
    flagged = [frame for frame in frames if frame.flags & FrameFlag.SHUTTER]
    # 0.2 s at 60 frames/s.
    assert 10 <= len(flagged) <= 14
    assert len({frame_number(frame.counts) for frame in flagged}) == 1
    assert gaps(frames) == 0


def test_a_correction_is_run_before_the_recording(tmp_path):
    with camera(tmp_path, {"ffc_at_arm": True}, ffc_s=0.4) as device:
        began_ns = device.clock.now_ns()
        device.arm(TriggerMode.FREE_RUN, 60)
        assert device.clock.now_ns() - began_ns >= 0.4 * NS_PER_S
        frames, _ = take(device, 3)
    assert {frame.flags for frame in frames} == {FrameFlag.NONE}


def test_a_shutter_that_does_not_open_is_told(tmp_path):
    with (
        camera(tmp_path, {"ffc_at_arm": True}, ffc_s=9) as device,
        pytest.raises(DeviceTimeout, match="not complete after 8 s"),
    ):
        device.arm(TriggerMode.FREE_RUN, 60)


def test_silence_is_a_timeout_and_unplugging_a_disconnection(tmp_path):
    silent, pulled = {"kind": "timeout", "at": 10, "seconds": 60}, {"kind": "disconnect", "at": 10}
    with camera(tmp_path, {"timeout_s": 0.5}, faults=[silent], clock=RealClock()) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        with pytest.raises(DeviceTimeout, match=r"no frame came for 0\.5 s"):
            take(device, 100)
    with camera(tmp_path, faults=[pulled], clock=RealClock()) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        with pytest.raises(DeviceDisconnected):
            take(device, 100)


def test_two_cameras_never_swap_and_the_same_object_works_after_replugging(tmp_path):
    pulled = {"faults": [{"kind": "disconnect", "at": 10}]}
    with ExitStack() as attached:
        left = attached.enter_context(plugged(tmp_path, "left", serial="276926", **pulled))
        right = attached.enter_context(plugged(tmp_path, "right", serial="276925"))
        both = right + left
        assert {found.serial for found in discover(both)} == {"276926", "276925"}
        with pytest.raises(DeviceFault, match="several cameras fit: 276925, 276926"):
            BosonCamera(context(both)).open()
        device = BosonCamera(context(both, serial="276926"))
        assert device.open().serial == "276926"
        assert device._number == 276926
        device.configure(QUICK)
        device.arm(TriggerMode.FREE_RUN, 60)
        with pytest.raises(DeviceDisconnected):
            take(device, 100)
        device.close()
        with pytest.raises(DeviceDisconnected, match="276926"):
            device.open()
        for end in (*left.serial, *left.video):
            end.plug()
        identity = device.open()
        device.configure(QUICK)
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, told = take(device, 5)
        device.close()
    assert identity.serial == "276926"
    assert (len(frames), told) == (5, [])


def test_a_slave_gives_one_frame_for_each_pulse_from_the_first_on(tmp_path):
    with camera(tmp_path) as device:
        writer = LineWriter(tmp_path, "trigger")
        device.arm(TriggerMode.HARDWARE, 50)
        writer.start_session()
        for index in range(20):
            writer.emit(device.clock.now_ns() + (1 + index) * NS_PER_S // 50)
        frames, told = take(device, 20)
    assert told == []
    assert [frame_number(frame.counts) for frame in frames] == list(range(20))
    assert gaps(frames) == 0
    assert {frame.trigger_index for frame in frames} == {-1}
    assert {two.ticks - one.ticks for one, two in pairwise(frames)} == {20}


def test_a_slave_without_pulses_times_out_and_runs_free_again(tmp_path):
    with camera(tmp_path, {"timeout_s": 0.3}, clock=RealClock()) as device:
        device.arm(TriggerMode.HARDWARE, 50)
        with pytest.raises(DeviceTimeout, match="no frame came") as caught:
            take(device, 1)
        assert "trigger line" in caught.value.remedy
        device.arm(TriggerMode.FREE_RUN, 60)
        assert len(take(device, 3)[0]) == 3


def test_a_master_leads_a_slave_that_runs_free(tmp_path):
    with (
        camera(tmp_path, {"sync_in_free_run": "slave"}, name="right", clock=RealClock()) as slave,
        camera(tmp_path, {"sync_in_free_run": "master"}, clock=RealClock()) as master,
    ):
        slave.arm(TriggerMode.FREE_RUN, 60)
        slave._acquisition._stream.begin()
        time.sleep(0.1)
        master.arm(TriggerMode.FREE_RUN, 60)
        leading, following = master.frames(Host(master)), slave.frames(Host(slave))
        both = [(next(leading), next(following)) for _ in range(15)]
    # The emulated line carries host time: the slave's exposures are the master's.
    led = np.diff([frame.ticks for frame, _ in both])
    followed = np.diff([frame.ticks for _, frame in both])
    assert np.abs(led - followed).max() <= 1


def test_rates_that_it_cannot_make_are_refused(tmp_path):
    with camera(tmp_path) as device:
        with pytest.raises(DeviceFault, match="by itself it makes 60"):
            device.arm(TriggerMode.FREE_RUN, 50)
        with pytest.raises(DeviceFault, match="at most 60"):
            device.arm(TriggerMode.HARDWARE, 61)
        with pytest.raises(DeviceFault, match="software"):
            device.arm(TriggerMode.SOFTWARE, 50)
        with pytest.raises(DeviceFault, match="no software trigger"):
            device.trigger(0)
        with pytest.raises(DeviceFault, match="not armed"):
            next(device.frames(Host(device)))


def test_a_camera_whose_port_is_missing_is_told_from_one_that_is_missing(tmp_path):
    with plugged(tmp_path) as transports:
        transports.serial = ()
        with pytest.raises(DeviceDisconnected, match="serial port of camera") as caught:
            BosonCamera(context(transports)).open()
        assert "cdc_acm" in caught.value.remedy
        transports.video = ()
        with pytest.raises(DeviceDisconnected, match="attached: none"):
            BosonCamera(context(transports)).open()


def test_all_faults_that_were_injected_are_known(tmp_path):
    kinds = [kind for kind in FaultKind if kind not in (FaultKind.DISCONNECT, FaultKind.GARBAGE)]
    faults = [{"kind": kind, "at": 10 * place + 10} for place, kind in enumerate(kinds)]
    log = tmp_path / "left.faults.jsonl"
    with camera(tmp_path, faults=faults) as device:
        device.arm(TriggerMode.FREE_RUN, 60)
        frames, told = take(device, 110)
    assert len(log.read_text().splitlines()) == len(kinds)
    # Lost: timeout, short read, stall, drop, damaged row, and one that the counter leapt over.
    assert gaps(frames) == 6
    assert len(told) == 2
