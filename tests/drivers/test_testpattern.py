"""The test-pattern camera: what is in its pictures, and the faults that it acts out."""

from __future__ import annotations

import time
from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.devices import Counts, DeviceContext, Frame, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.store import encode_frame
from thermacq.timing import RealClock, VirtualClock
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.testpattern import DRIVER, MAX_FRAME_RATE_HZ, PatternCamera, check_pattern


class Host:
    """Hands out one buffer after another and stops after `frames` of them."""

    def __init__(self, shape: tuple[int, int], frames: int = 10**9) -> None:
        self.shape = shape
        self.left = frames

    def stopping(self) -> bool:
        return self.left <= 0

    def buffer(self) -> Counts:
        self.left -= 1
        return np.zeros(self.shape, np.uint16)


SMALL = {"rows": 24, "columns": 32}


def camera(clock=None, mode=TriggerMode.FREE_RUN, rate_hz=200.0, **settings) -> PatternCamera:
    device = PatternCamera(DeviceContext("left", clock or VirtualClock()))
    device.open()
    device.configure({**SMALL, **settings})
    device.arm(mode, rate_hz)
    return device


def collect(device: PatternCamera, number: int) -> list[Frame]:
    capabilities = device.capabilities
    return list(islice(device.frames(Host((capabilities.rows, capabilities.columns))), number))


def test_pictures_are_numbered_from_arming_and_verify():
    frames = collect(camera(), 40)
    assert [check_pattern(frame.counts) for frame in frames] == list(range(40))


def test_two_pictures_of_one_pattern_differ_in_their_number_only():
    frames = collect(camera(), 17)
    assert np.array_equal(frames[0].counts[1:], frames[16].counts[1:])
    assert not np.array_equal(frames[0].counts[0], frames[16].counts[0])


@given(position=st.integers(0, 24 * 32 - 1), bit=st.integers(0, 15), number=st.integers(0, 20))
def test_any_flipped_bit_is_found(position, bit, number):
    device = camera()
    counts = collect(device, number + 1)[number].counts.copy()
    counts.ravel()[position] ^= np.uint16(1 << bit)
    with pytest.raises(ValueError, match="damaged"):
        check_pattern(counts)


def test_a_picture_of_another_camera_is_refused():
    with pytest.raises(ValueError, match="header"):
        check_pattern(np.full((24, 32), 7000, np.uint16))
    with pytest.raises(ValueError, match="header"):
        check_pattern(np.zeros((2, 2), np.uint16))


def test_ticks_and_host_time_follow_the_frame_rate():
    frames = collect(camera(rate_hz=250.0, tick_rate_hz=1e6), 20)
    assert set(np.diff([frame.ticks for frame in frames])) == {4000}
    assert set(np.diff([frame.host_ns for frame in frames])) == {4_000_000}


def test_the_counter_wraps_at_its_width():
    frames = collect(camera(counter_bits=8, counter_start=250), 10)
    assert [frame.counter for frame in frames] == [250, 251, 252, 253, 254, 255, 0, 1, 2, 3]


def test_lost_frames_are_missing_from_counter_and_pictures():
    frames = collect(camera(lose_every=4, counter_start=0), 6)
    assert [frame.counter for frame in frames] == [0, 1, 2, 4, 5, 6]
    assert [check_pattern(frame.counts) for frame in frames] == [0, 1, 2, 4, 5, 6]


def test_a_software_trigger_gives_its_index_to_the_frame():
    device = camera(mode=TriggerMode.SOFTWARE)
    frames = device.frames(Host((24, 32)))
    for index in (3, 4, 9):
        device.trigger(index)
        assert next(frames).trigger_index == index


def test_a_lost_triggered_frame_is_reported_to_whoever_waits_for_it():
    device = camera(mode=TriggerMode.SOFTWARE, lose_every=2)
    device.trigger(0)
    next(device.frames(Host((24, 32))))
    device.trigger(1)
    with pytest.raises(IncompleteFrame, match="frame 1 did not come"):
        next(device.frames(Host((24, 32))))
    device.trigger(2)
    assert next(device.frames(Host((24, 32)))).trigger_index == 2


@pytest.mark.parametrize("clock", [RealClock(), VirtualClock()], ids=["real", "virtual"])
def test_no_trigger_ends_in_a_timeout_that_names_the_device(clock):
    device = camera(clock, TriggerMode.SOFTWARE, timeout_s=0.1)
    with pytest.raises(DeviceTimeout, match=r"device 'left' \(acquire\): no trigger within 0.1 s"):
        next(device.frames(Host((24, 32))))


@pytest.mark.parametrize(
    ("setting", "fault"),
    [
        ("fail_at_frame", DeviceDisconnected),
        ("stall_at_frame", DeviceTimeout),
        ("incomplete_at_frame", IncompleteFrame),
        ("overrun_at_frame", DeviceOverrun),
    ],
)
def test_ordered_faults_come_at_their_frame(setting, fault):
    frames = camera(timeout_s=0.05, **{setting: 3}).frames(Host((24, 32)))
    assert [check_pattern(next(frames).counts) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(fault, match="after frame 2") as caught:
        next(frames)
    assert caught.value.last_frame == 2


def test_the_stream_goes_on_after_an_incomplete_frame():
    device = camera(incomplete_at_frame=1, overrun_at_frame=2, counter_start=0)
    counters = []
    faults = []
    while len(counters) < 4:
        try:
            counters.extend(frame.counter for frame in islice(device.frames(Host((24, 32))), 4))
        except (IncompleteFrame, DeviceOverrun) as fault:
            faults.append(type(fault))
            counters.append(-1)
    assert faults == [IncompleteFrame, DeviceOverrun]
    assert counters[-4:] == [3, 4, 5, 6]


def test_what_a_late_host_lost_is_missing_from_the_counter():
    clock = VirtualClock()
    device = camera(clock, rate_hz=100.0, counter_start=0)
    frames = device.frames(Host((24, 32)))
    next(frames)
    clock.wait_until_ns(2_000_000_000)
    assert [next(frames).counter for _ in range(3)] == [136, 137, 138]


def test_pulses_on_its_line_expose_with_their_index(tmp_path):
    clock = VirtualClock()
    device = PatternCamera(DeviceContext("left", clock, {}, tmp_path))
    device.open()
    device.configure({**SMALL, "line": "box", "counter_start": 0})
    device.arm(TriggerMode.HARDWARE, 50.0)
    line = LineWriter(tmp_path, "box")
    line.start_session()
    for pulse in range(4):
        line.emit(pulse * 20_000_000)
    frames = list(islice(device.frames(Host((24, 32))), 4))
    assert [(frame.trigger_index, frame.counter, frame.ticks) for frame in frames] == [
        (index, index, 20_000 * index) for index in range(4)
    ]


def test_rates_keys_and_triggers_that_it_does_not_take_are_refused():
    with pytest.raises(DeviceFault, match="at most 1000"):
        camera(rate_hz=2 * MAX_FRAME_RATE_HZ)
    with pytest.raises(DeviceFault, match="unknown key 'colums'; did you mean 'columns'"):
        camera(colums=3)
    with pytest.raises(DeviceFault, match="not armed for software triggers"):
        camera().trigger(0)


def test_pictures_compress_like_thermal_ones():
    frame = collect(camera(rows=512, columns=640), 1)[0]
    assert 1.9 < frame.counts.nbytes / len(encode_frame(frame.counts, "lz4")) < 2.2


def test_the_driver_record_makes_this_camera():
    device = DRIVER.make(DeviceContext("left", VirtualClock()))
    assert isinstance(device, PatternCamera)
    assert DRIVER.settings()().model_dump() == device.configure({})


@pytest.mark.slow
def test_full_pictures_are_made_faster_than_500_per_second():
    """Best of five tries: the machine may be busy, the camera must not be slow."""
    device = camera(RealClock(), TriggerMode.SOFTWARE, rows=512, columns=640)
    buffer = np.zeros((512, 640), np.uint16)
    host = Host((512, 640))
    host.buffer = lambda: buffer
    frames = device.frames(host)
    seconds = []
    for _ in range(5):
        start = time.process_time()
        for index in range(100):
            device.trigger(index)
            next(frames)
        seconds.append((time.process_time() - start) / 100)
    assert 1 / min(seconds) > 500


def test_new_settings_end_the_stream_that_was_armed_with_the_old_ones():
    device = camera()
    frames = device.frames(Host((24, 32)))
    next(frames)
    device.configure({"rows": 8, "columns": 16})
    assert list(frames) == []
