"""Video nodes as drivers read them: formats to counts, waits that can be left, and the kernel's list of formats."""

from __future__ import annotations

import struct
import threading
import time

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.errors import DeviceDisconnected, DeviceFault
from thermacq.testing.emulation.video import NoVideo
from thermacq.timing.clock import RealClock
from thermacq.transports import RealTransports, VideoNode
from thermacq_drivers.transports import v4l2, video
from thermacq_drivers.transports.video import VideoFormat, VideoStream, as_counts, find_video, identity_of

SIZE = (4, 3)


def test_property_numbers_are_those_of_opencv():
    for name in ("FRAME_WIDTH", "FRAME_HEIGHT", "FPS", "FOURCC", "CONVERT_RGB"):
        assert getattr(video, name) == getattr(cv2, f"CAP_PROP_{name}")
    assert video.READ_TIMEOUT_MS == cv2.CAP_PROP_READ_TIMEOUT_MSEC


PIXELS = np.arange(12, dtype=np.uint16).reshape(3, 4) * 300


@pytest.mark.parametrize(
    "picture",
    [
        PIXELS,
        PIXELS.view(np.uint8).reshape(3, 4, 2),
        PIXELS.view(np.uint8).reshape(1, 24),
        PIXELS.reshape(12),
    ],
    ids=["pixels", "pairs of bytes", "a row of bytes", "a row of pixels"],
)
def test_sixteen_bits_in_whatever_shape_opencv_gives_them(picture):
    np.testing.assert_array_equal(as_counts(picture, VideoFormat(*SIZE, "Y16 ", 30)), PIXELS)


def test_luminance_without_chrominance():
    luminance = np.arange(12, dtype=np.uint8).reshape(3, 4)
    grey = np.full_like(luminance, 128)
    for fourcc, picture in (
        ("GREY", luminance),
        ("YUYV", np.dstack([luminance, grey])),
        ("UYVY", np.dstack([grey, luminance])),
    ):
        counts = as_counts(picture, VideoFormat(*SIZE, fourcc, 30))
        np.testing.assert_array_equal(counts, luminance)
        assert counts.dtype == np.uint16


@given(st.binary(max_size=64), st.sampled_from(["Y16 ", "GREY", "YUYV", "UYVY", "MJPG", "\0\0\0\0"]))
def test_any_bytes_are_a_picture_or_refused(data, fourcc):
    fits = {"Y16 ": 24, "GREY": 12, "YUYV": 24, "UYVY": 24}.get(fourcc) == len(data)
    wanted = VideoFormat(*SIZE, fourcc, 30)
    if fits:
        assert as_counts(np.frombuffer(data, np.uint8), wanted).shape == (3, 4)
    else:
        with pytest.raises(ValueError, match=r"bytes came|is none of"):
            as_counts(np.frombuffer(data, np.uint8), wanted)


class Patient:
    """A video that answers when it is told to; anything else is as with a camera that waits for a trigger."""

    def __init__(self):
        self.go = threading.Event()
        self.released = False
        self.answer = True, PIXELS

    def isOpened(self):
        return True

    def set(self, number, value):
        return False

    def get(self, number):
        return 0.0

    def read(self):
        self.go.wait(5)
        return self.answer

    def release(self):
        self.released = True


class OneVideo:
    def __init__(self, it):
        self.it = it

    def open_video(self, path):
        return self.it


def test_a_read_that_lasts_can_be_left_and_its_picture_comes_later():
    it = Patient()
    stream = VideoStream("eye", OneVideo(it), "/dev/video9", RealClock())
    began_s = time.monotonic()
    assert stream.take(0.01) is None
    assert time.monotonic() - began_s < 20
    it.go.set()
    shot = stream.take(20)
    np.testing.assert_array_equal(shot.picture, PIXELS)
    stream.close()
    assert it.released


def test_a_camera_that_fails_at_once_again_and_again_is_gone():
    it = Patient()
    it.go.set()
    it.answer = False, None
    stream = VideoStream("eye", OneVideo(it), "/dev/video9", RealClock())
    assert [stream.take(20) for _ in range(4)] == [None] * 4
    with pytest.raises(DeviceDisconnected, match="camera at /dev/video9 is gone"):
        stream.take(20)
    stream.close()


def test_errors_of_opencv_count_as_failures(monkeypatch):
    it = Patient()

    def read():
        raise cv2.error("select")

    it.read = read
    stream = VideoStream("eye", OneVideo(it), "/dev/video9", RealClock())
    assert stream.take(20) is None
    stream.close()


def test_a_node_that_may_not_be_opened_says_what_to_do():
    with pytest.raises(DeviceFault, match="cannot be opened") as told:
        VideoStream("eye", OneVideo(NoVideo()), "/dev/video9", RealClock())
    assert "group" in told.value.remedy


def test_identities_do_not_hang_on_the_path():
    assert identity_of(VideoNode("/dev/video0", 1, 2, "S1", "", "1-2")) == "S1"
    assert identity_of(VideoNode("/dev/video0", 0x1E4E, 0x0100, "", "", "1-2.3")) == "1e4e:0100@1-2.3"
    assert identity_of(VideoNode("/dev/video7")) == "/dev/video7"
    nodes = [VideoNode("/dev/video0", 1, 2, "S1"), VideoNode("/dev/video2", 1, 2, "S2")]
    assert find_video(nodes, "eye", serial="S2").path == "/dev/video2"
    assert find_video(nodes, "eye", path="/dev/video0").serial == "S1"


def test_the_system_tells_serial_number_and_socket_of_a_node(tmp_path, monkeypatch):
    usb = tmp_path / "devices" / "usb1" / "1-2.3"
    node = tmp_path / "class" / "video4"
    (usb / "1-2.3:1.0").mkdir(parents=True)
    node.mkdir(parents=True)
    (node / "device").symlink_to(usb / "1-2.3:1.0")
    for file, text in {
        usb / "idVendor": "09cb",
        usb / "idProduct": "4007",
        usb / "serial": "276926",
        usb / "product": "Boson",
        node / "index": "0",
    }.items():
        file.write_text(text + "\n")
    monkeypatch.setattr("thermacq.transports._VIDEO_CLASS", tmp_path / "class")
    assert RealTransports().video_nodes() == [
        VideoNode("/dev/video4", 0x09CB, 0x4007, "276926", "Boson", "1-2.3")
    ]


class Kernel:
    """The ioctls of one camera with two formats; the second of them with a range of sizes, which is not listed."""

    def __call__(self, number, record):
        index = struct.unpack_from("<I", record)[0]
        if number == 0xC0405602:
            assert struct.unpack_from("<I", record, 4)[0] == 1
            return bytes(record[:44]) + (b"Y16 ", b"YUYV")[index] + bytes(16) if index < 2 else None
        letters = bytes(record[4:8])
        if number == 0xC02C564A:
            if letters == b"YUYV":
                return None if index else bytes(record[:8]) + struct.pack("<3I", 3, 16, 16) + bytes(24)
            sizes = ((640, 512), (640, 514))
            return bytes(record[:8]) + struct.pack("<3I", 1, *sizes[index]) + bytes(24) if index < 2 else None
        assert number == 0xC034564B
        intervals = (166_666, 333_333)
        if index >= 2:
            return None
        return bytes(record[:16]) + struct.pack("<3I", 1, intervals[index], 10_000_000) + bytes(24)


def test_the_kernels_formats_are_listed():
    assert list(v4l2.list_formats(Kernel())) == [
        "640 x 512 'Y16 ' at 60, 30 frames/s",
        "640 x 514 'Y16 ' at 60, 30 frames/s",
    ]


def test_what_is_no_video_node_lists_nothing(tmp_path):
    assert v4l2.offered_formats(str(tmp_path / "missing")) == []
    (tmp_path / "file").write_text("no node")
    assert v4l2.offered_formats(str(tmp_path / "file")) == []
