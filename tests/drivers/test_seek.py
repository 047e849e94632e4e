"""The Seek driver: bytes of its protocol, dead pixels, and the driver on emulated cameras with faults."""

from __future__ import annotations

import struct
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.devices import DeviceContext, FrameFlag, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Emulation
from thermacq.testing.emulation.scene import ThermalScene, frame_number
from thermacq.testing.emulators.seek import attach
from thermacq.timing.clock import RealClock, VirtualClock
from thermacq_drivers.seek import codec
from thermacq_drivers.seek.camera import SeekCamera, discover
from thermacq_drivers.seek.codec import COMPACT, COMPACT_PRO, Request

from .bench import take_frames


@contextmanager
def camera(tmp_path, settings=None, serial="", clock=None, **emulation):
    clock = clock or VirtualClock()
    with attach(Emulation("left", clock, tmp_path, emulation)) as transports:
        device = SeekCamera(DeviceContext("left", clock, transports=transports, serial=serial))
        device.plug = transports.usb[0]
        try:
            device.open()
            device.configure(settings or {})
            device.arm(TriggerMode.FREE_RUN, device.capabilities.max_frame_rate_hz)
            yield device
        finally:
            device.close()


def take(device, count):
    """Frames, and how many were announced as damaged."""
    frames, told = take_frames(device, count)
    return frames, len(told)


def test_worked_requests():
    assert codec.image_request(COMPACT) == bytes.fromhex("C0 7E 00 00")
    assert codec.image_request(COMPACT_PRO) == bytes.fromhex("58 5B 01 00")
    assert (COMPACT.words, COMPACT_PRO.words) == (32448, 88920)


def test_initialisation_of_the_compact_is_the_published_one():
    steps = [(int(request), content.hex(), length) for request, content, length in codec.init_steps(COMPACT)]
    assert steps == [
        (0x3C, "0000", 0),
        (0x4E, "", 4),
        (0x36, "", 12),
        (0x56, "200030000000", 0),
        (0x58, "", 64),
        (0x56, "200050000000", 0),
        (0x58, "", 64),
        (0x56, "0c0070000000", 0),
        (0x58, "", 24),
        (0x56, "060008000000", 0),
        (0x58, "", 12),
        (0x3E, "0800", 0),
        (0x3D, "", 2),
        (0x3E, "0800", 0),
        (0x3C, "0100", 0),
        (0x3D, "", 2),
    ]


def test_initialisation_of_the_pro_reads_eighty_blocks():
    steps = codec.init_steps(COMPACT_PRO)
    addresses = [struct.unpack("<3H", content)[1] for request, content, _ in steps if request == 0x56]
    assert addresses == [8, 0x0600, 0x0601, *range(0, 2529, 32)]
    assert steps[-1] == (Request.SET_OPERATION_MODE, b"\x01\x00", 0)


@given(st.binary(max_size=64))
def test_any_factory_bytes_give_a_printable_serial_number(data):
    serial = codec.parse_serial(data)
    assert serial.isascii()
    assert all(0x21 <= ord(letter) < 0x7F for letter in serial)


def test_the_published_serial_number():
    assert codec.parse_serial(b"140c10E42N71") == "140c10E42N71"


@given(st.binary(max_size=200))
def test_frames_of_the_wrong_length_are_refused(data):
    with pytest.raises(ValueError, match="of 64896 bytes"):
        codec.parse_frame(data, COMPACT, COMPACT.counter_word)


@given(st.integers(0, 65535), st.integers(0, 65535))
def test_frames_tell_their_type_and_counter(kind, counter):
    words = np.zeros(COMPACT_PRO.words, "<u2")
    words[2], words[1] = kind, counter
    if 1 <= kind <= 10:
        frame = codec.parse_frame(words.tobytes(), COMPACT_PRO, COMPACT_PRO.counter_word)
        assert (frame.type, frame.counter) == (kind, counter)
    else:
        with pytest.raises(ValueError, match="of type"):
            codec.parse_frame(words.tobytes(), COMPACT_PRO, COMPACT_PRO.counter_word)


@given(st.integers(0, 2**20 - 1))
def test_dead_pixels_are_filled_from_live_neighbours_only(bits):
    dead = np.array([bits >> place & 1 for place in range(20)], bool).reshape(4, 5)
    picture = np.where(dead, 0, 1000).astype(np.uint16)
    codec.fill(picture, codec.fill_order(dead))
    expected = 0 if dead.all() else 1000
    assert (picture == expected).all()


def test_dead_pixels_follow_the_published_rule():
    first = np.full((10, 10), 2000, np.uint16)
    first[3, 4], first[5, 6], first[7, 8] = 0, 1799, 2200
    dead = codec.dead_pixels(first)
    assert np.argwhere(dead).tolist() == [[3, 4], [5, 6]]
    assert codec.dead_pixels(np.zeros((2, 2), np.uint16)).all()


@pytest.mark.parametrize("model", ["compact", "compact_pro"])
def test_scenes_arrive_flat_and_whole(tmp_path, model):
    with camera(tmp_path, model=model, shutter_every=10) as device:
        frames, damaged = take(device, 25)
    scenes = [frame for frame in frames if not frame.flags]
    assert damaged == 0
    assert np.diff([frame.counter for frame in frames]).tolist() == [1] * 24
    assert [frame_number(frame.counts) for frame in scenes] == [frame.counter for frame in scenes]
    # The fixed pattern of the sensor (+-300 counts) is gone, and no pixel is dead.
    rows, columns = scenes[0].counts.shape
    true = ThermalScene(rows, columns, level=3000, span=1500).picture(scenes[0].counter)
    error = scenes[0].counts.astype(int) - (true.astype(int) + codec.LEVEL - 3000)
    assert np.abs(np.median(error)) == 0
    assert np.percentile(np.abs(error), 80) == 0
    assert np.abs(error).max() < 800  # filled pixels are the mean of their neighbours


def test_shutter_frames_are_flagged_and_raw_counts_can_be_had(tmp_path):
    with camera(tmp_path, {"flat": False}, shutter_every=5) as device:
        frames, _ = take(device, 18)
    flags = [bool(frame.flags & FrameFlag.SHUTTER) for frame in frames]
    places = np.flatnonzero(flags)
    assert np.diff(places).tolist() == [6] * (len(places) - 1)
    assert len(places) == 3
    assert (frames[0].counts == 0).any()  # dead pixels are left as they are


@pytest.mark.parametrize(
    ("fault", "damaged", "lost", "doubled"),
    [
        ({"kind": "short_read", "at": 12, "amount": 512}, 1, 1, 0),
        ({"kind": "bad_crc", "at": 12}, 1, 1, 0),
        ({"kind": "stall", "at": 12}, 1, 1, 0),
        ({"kind": "garbage", "at": 12, "amount": 64}, 1, 1, 0),
        ({"kind": "drop", "at": 12}, 0, 1, 0),
        ({"kind": "counter_jump", "at": 12, "amount": 7}, 0, 7, 0),
        ({"kind": "duplicate", "at": 12}, 0, 0, 1),
    ],
)
def test_every_fault_is_met_and_counted(tmp_path, fault, damaged, lost, doubled):
    with camera(tmp_path, counter_start=65_530, faults=[fault]) as device:
        frames, announced = take(device, 25)
    steps = np.diff([frame.counter for frame in frames]) % 65536
    assert announced == damaged
    assert int((steps - 1).clip(0).sum()) == lost
    assert int((steps == 0).sum()) == doubled


def test_silence_and_unplugging_are_typed(tmp_path):
    silent = [{"kind": "timeout", "at": 8, "items": 1000}]
    with (
        camera(tmp_path, {"timeout_s": 0.3}, clock=RealClock(), faults=silent) as device,
        pytest.raises(DeviceTimeout, match="no frame within"),
    ):
        take(device, 100)
    with (
        camera(tmp_path, faults=[{"kind": "disconnect", "at": 8}]) as device,
        pytest.raises(DeviceDisconnected, match="gone from USB"),
    ):
        take(device, 100)


def test_it_works_again_after_it_was_plugged_in_again(tmp_path):
    with camera(tmp_path, faults=[{"kind": "disconnect", "at": 8}]) as device:
        with pytest.raises(DeviceDisconnected):
            take(device, 100)
        device.close()
        with pytest.raises(DeviceDisconnected, match="attached: none"):
            device.open()
        device.plug.plug()
        device.open()
        device.configure({})
        device.arm(TriggerMode.FREE_RUN, 9.0)
        frames, damaged = take(device, 5)
    assert (len(frames), damaged) == (5, 0)


def test_a_short_first_frame_is_tried_again(tmp_path):
    with camera(tmp_path, faults=[{"kind": "short_read", "at": 0, "amount": 512}]) as device:
        frames, _ = take(device, 3)
    assert all((frame.counts > 0).all() for frame in frames if not frame.flags)


def test_a_camera_that_was_left_running_is_woken_anew(tmp_path):
    with camera(tmp_path, left_running=True) as device:
        assert len(take(device, 3)[0]) == 3


def test_the_wrong_camera_and_wrong_modes_are_refused(tmp_path):
    with pytest.raises(DeviceDisconnected, match="serial 'OTHER'"), camera(tmp_path, serial="OTHER"):
        pass
    with camera(tmp_path) as device:
        with pytest.raises(DeviceFault, match="knows no trigger"):
            device.arm(TriggerMode.HARDWARE, 9.0)
        with pytest.raises(DeviceFault, match="at most 9 possible"):
            device.arm(TriggerMode.FREE_RUN, 50.0)
    with attach(Emulation("left", VirtualClock(), tmp_path)) as transports:
        assert [found.model for found in discover(transports)] == ["Seek Compact"]
