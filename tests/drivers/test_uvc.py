"""The driver for any video camera: formats, a Lepton's telemetry rows, and faults, on emulated cameras."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from thermacq.devices import DeviceContext, FrameFlag, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Emulation
from thermacq.plugins import plugins
from thermacq.testing.emulation.scene import frame_number
from thermacq.testing.emulators import uvc as emulated
from thermacq.testing.kit import NotApplicable, Subject, checks_for
from thermacq.timing.clock import RealClock, VirtualClock
from thermacq_drivers.uvc.camera import UvcCamera, discover
from thermacq_drivers.uvc.lepton import WORD_ORDERS, read_row, word_order

from .bench import take_frames as take

LEPTON = {"model": "lepton"}
FOOTER = {"columns": 160, "rows": 122}


@contextmanager
def plugged(tmp_path, name="eye", clock=None, **settings):
    with emulated.attach(Emulation(name, clock or RealClock(), tmp_path, settings)) as transports:
        yield transports


def context(transports, clock=None, serial="", settings=None):
    return DeviceContext(
        "eye", clock or RealClock(), transports=transports, serial=serial, settings=settings or {}
    )


@contextmanager
def camera(tmp_path, settings=None, clock=None, **emulation):
    clock = clock or VirtualClock()
    with plugged(tmp_path, clock=clock, **emulation) as transports:
        device = UvcCamera(context(transports, clock))
        device.plug = transports.video[0]
        try:
            device.open()
            device.applied = device.configure(settings or {})
            device.arm(TriggerMode.FREE_RUN, device.capabilities.max_frame_rate_hz)
            yield device
        finally:
            device.close()


def gaps(frames):
    return sum((two.counter - one.counter) % 2**32 - 1 for one, two in pairwise(frames))


def test_sixteen_bits_come_as_they_are(tmp_path):
    with camera(tmp_path) as device:
        declared = device.capabilities
        frames, told = take(device, 10)
    assert (declared.rows, declared.columns, declared.bit_depth) == (240, 320, 16)
    assert declared.max_frame_rate_hz == 60
    assert (declared.counter_bits, declared.tick_rate_hz) == (0, 0)
    assert [frame_number(frame.counts) for frame in frames] == list(range(10))
    assert {(frame.counter, frame.ticks, frame.flags) for frame in frames} == {(-1, -1, FrameFlag.NONE)}
    assert np.isnan(frames[0].fpa_temperature_k)
    assert told == []


@pytest.mark.parametrize("fourcc", ["YUYV", "GREY"])
def test_luminance_of_eight_bits(tmp_path, fourcc):
    asked = {"fourcc": fourcc, "columns": 320, "rows": 240}
    with camera(tmp_path, asked, model="webcam") as device:
        frames, _ = take(device, 2)
        assert device.capabilities.bit_depth == 8
    values = frames[0].counts
    # The emulated chrominance is 128 throughout, the texture goes over 100 counts.
    assert values.max() <= 255
    assert np.unique(values[8:]).size > 40


def test_what_was_granted_is_returned(tmp_path):
    with camera(tmp_path, {"columns": 640}) as device:
        assert (device.applied["columns"], device.applied["rows"]) == (640, 480)
        assert device.capabilities.max_frame_rate_hz == 30
        device.disarm()
        with pytest.raises(DeviceFault, match="the camera grants 640 x 480"):
            device.arm(TriggerMode.FREE_RUN, 20)
        with pytest.raises(DeviceFault, match="at most 30"):
            device.arm(TriggerMode.FREE_RUN, 31)
        with pytest.raises(DeviceFault, match="only free_run"):
            device.arm(TriggerMode.HARDWARE, 30)


def test_a_format_that_it_lacks_is_refused_with_what_it_has(tmp_path):
    with plugged(tmp_path, model="webcam") as transports:
        device = UvcCamera(context(transports))
        device.open()
        with pytest.raises(
            DeviceFault, match="'Y16' was asked for, the camera grants 640 x 480 'YUYV'"
        ) as told:
            device.configure({})
        assert "Formats that it offers" in told.value.remedy
        with pytest.raises(DeviceFault, match="has no telemetry rows"):
            device.configure({"fourcc": "YUYV", "telemetry": "lepton"})
        device.close()


@pytest.mark.parametrize("order", WORD_ORDERS)
def test_a_leptons_telemetry_is_read_in_both_word_orders(tmp_path, order):
    with camera(tmp_path, FOOTER, **LEPTON, word_order=order, counter_start=70_000) as device:
        assert device.applied["telemetry"] == "lepton"
        assert device.applied["word_order"] == order
        declared = device.capabilities
        frames, told = take(device, 10)
    assert (declared.rows, declared.columns, declared.counter_bits) == (120, 160, 32)
    assert frames[0].counter >= 70_000
    assert gaps(frames) == 0
    assert {two.ticks - one.ticks for one, two in pairwise(frames)} <= {111, 112}
    assert [frame.fpa_temperature_k for frame in frames] == pytest.approx(10 * [305.15])
    assert told == []


def test_a_lepton_without_telemetry_rows_is_a_plain_camera(tmp_path):
    with camera(tmp_path, **LEPTON) as device:
        assert (device.applied["rows"], device.applied["telemetry"]) == (120, "none")
        assert device.capabilities.counter_bits == 0


def test_counter_and_time_of_a_lepton_wrap(tmp_path):
    near = {"counter_start": 2**32 - 9, "uptime_ms": 2**32 - 1500}
    with camera(tmp_path, FOOTER, **LEPTON, **near) as device:
        frames, told = take(device, 20)
    assert (gaps(frames), told) == (0, [])
    assert {two.ticks - one.ticks for one, two in pairwise(frames)} <= {111, 112}
    assert min(frame.counter for frame in frames) == 0


@pytest.mark.parametrize(
    ("fault", "announced", "missing"),
    [
        ({"kind": "drop", "at": 10, "items": 3}, 0, 3),
        ({"kind": "short_read", "at": 10}, 0, 1),
        ({"kind": "stall", "at": 10}, 0, 1),
        ({"kind": "bad_crc", "at": 10, "items": 2}, 2, 2),
        ({"kind": "duplicate", "at": 10}, 1, 0),
        ({"kind": "counter_jump", "at": 10, "amount": 5}, 0, 5),
        ({"kind": "slow", "at": 10, "seconds": 0.05}, 0, 0),
    ],
    ids=lambda value: value["kind"] if isinstance(value, dict) else "",
)
def test_each_fault_of_a_lepton_is_noticed_and_counted(tmp_path, fault, announced, missing):
    with camera(tmp_path, FOOTER, **LEPTON, faults=[fault]) as device:
        frames, told = take(device, 20)
    assert (len(told), gaps(frames)) == (announced, missing)


def test_frames_under_a_leptons_shutter_are_flagged(tmp_path):
    fault = {"kind": "shutter_freeze", "at": 10, "seconds": 1.0}
    with camera(tmp_path, FOOTER, **LEPTON, faults=[fault]) as device:
        frames, _ = take(device, 25)
    assert sum(frame.flags == FrameFlag.SHUTTER for frame in frames) == 9


def test_silence_and_unplugging_are_typed_and_it_works_again(tmp_path):
    silent = [{"kind": "timeout", "at": 5, "seconds": 60}]
    with (
        camera(tmp_path, {"timeout_s": 0.4}, RealClock(), faults=silent) as device,
        pytest.raises(DeviceTimeout, match="no frame came"),
    ):
        take(device, 100)
    pulled = [{"kind": "disconnect", "at": 5}]
    with camera(tmp_path, {"columns": 320}, RealClock(), faults=pulled) as device:
        with pytest.raises(DeviceDisconnected, match="is gone"):
            take(device, 100)
        device.close()
        with pytest.raises(DeviceDisconnected, match="EMU-eye"):
            device.open()
        device.plug.plug()
        assert device.open().serial == "EMU-eye"
        device.configure({"columns": 320})
        device.arm(TriggerMode.FREE_RUN, 60)
        assert len(take(device, 3)[0]) == 3


def test_cameras_are_told_apart_by_serial_number_or_socket(tmp_path):
    with (
        plugged(tmp_path, "one") as one,
        plugged(tmp_path, "two", has_serial=False, model="webcam") as two,
    ):
        both = one + two
        assert [found.serial for found in discover(both)] == ["EMU-one", "046d:0825@1-2"]
        with pytest.raises(DeviceFault, match="several cameras fit"):
            UvcCamera(context(both)).open()
        by_path = UvcCamera(context(both, settings={"node": "/dev/video-two"}))
        assert by_path.open().serial == "046d:0825@1-2"
        assert by_path.open().serial == "046d:0825@1-2"
        assert UvcCamera(context(both, serial="EMU-one")).open().model == "thermal camera"
        with pytest.raises(DeviceDisconnected, match="'X9' was not found; attached: EMU-one"):
            UvcCamera(context(both, serial="X9")).open()


def row_a(order, time_ms, counter, status=0):
    row = np.zeros(160, np.uint16)
    for place, value in ((1, time_ms), (3, status), (20, counter)):
        halves = value & 0xFFFF, value >> 16
        row[place : place + 2] = halves if order == "low_first" else halves[::-1]
    row[24] = 30_515
    return row


@given(
    st.sampled_from(WORD_ORDERS), st.integers(0, 2**32 - 1), st.integers(1, 1000), st.integers(0, 2**32 - 1)
)
def test_the_word_order_is_told_from_the_time(order, time_ms, step_ms, counter):
    later_ms = (time_ms + step_ms) % 2**32
    # Where the upper half moves too, the other order could look as good.
    assume(time_ms >> 16 == later_ms >> 16)
    rows = row_a(order, time_ms, counter), row_a(order, later_ms, counter)
    assert word_order(*rows) == order
    said = read_row(rows[0], order)
    assert (said.time_ms, said.counter, said.fpa_k) == (time_ms, counter, 305.15)


@given(st.lists(st.integers(0, 0xFFFF), min_size=320, max_size=320), st.sampled_from(WORD_ORDERS))
def test_any_rows_are_read_or_refused(words, order):
    one, two = np.array(words, np.uint16).reshape(2, 160)
    told = word_order(one, two)
    before, after = read_row(one, order), read_row(two, order)
    if told == order:
        assert before.may_follow(None)
        assert after.may_follow(before)


@pytest.mark.parametrize(("state", "closed"), [(0, False), (1, False), (2, True), (3, False)])
@pytest.mark.parametrize("order", WORD_ORDERS)
def test_bits_4_and_5_of_the_status_are_the_state_of_the_shutter(order, state, closed):
    row = row_a(order, 1, 1, status=0x8 | state << 4)
    assert read_row(row, order).ffc_in_progress is closed


def lepton_subject():
    """The suite on a Lepton with telemetry rows; by itself it meets the emulated thermal camera."""
    plain = plugins().emulator("uvc")
    damaged = {"faults": [{"kind": "bad_crc", "at": 10}]}
    return Subject(
        plugins().driver("uvc"),
        FOOTER,
        replace(
            plain,
            attach=lambda told: plain.attach(replace(told, settings={**LEPTON, **told.settings})),
            faults={**plain.faults, IncompleteFrame: damaged},
        ),
    )


@pytest.mark.slow
@pytest.mark.parametrize("check", checks_for(plugins().driver("uvc").kind), ids=lambda check: check.__name__)
def test_a_lepton_conforms(check):
    try:
        check(lepton_subject())
    except NotApplicable as reason:
        pytest.skip(str(reason))
