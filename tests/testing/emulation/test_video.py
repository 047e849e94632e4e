"""The emulated UVC camera answers as `cv2.VideoCapture` does; exposures and scene of emulated cameras."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.testing.emulation import video
from thermacq.testing.emulation.scene import ThermalScene, frame_number
from thermacq.testing.emulation.timing import DeviceClock, FreeRun, Slaved
from thermacq.testing.emulation.video import VideoFormat, VideoPlug
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.clock import NS_PER_S, RealClock, VirtualClock
from thermacq.timing.trigger_line import LineWriter
from thermacq.transports import VideoNode

FORMATS = (
    VideoFormat(64, 51, "Y16 ", 60.0),
    VideoFormat(64, 48, "YUYV", 60.0),
    VideoFormat(32, 24, "YUYV", 9.0),
)


class Eye:
    """A camera whose clock is the host's."""

    formats = FORMATS

    def __init__(self, clock):
        self.clock = DeviceClock(clock)
        self.run = None

    def start(self, chosen):
        self.chosen = chosen
        self.scene = ThermalScene(chosen.rows, chosen.columns)
        self.run = FreeRun(self.clock, chosen.rate_hz)

    def picture(self, timeout_s, gone):
        exposure = self.run.next(timeout_s, gone)
        if exposure is None:
            return None
        picture = self.scene.picture(exposure.number)
        return picture if self.chosen.fourcc == "Y16 " else picture[..., None].view(np.uint8)

    def stop(self):
        self.run = None


@pytest.fixture
def plug():
    return VideoPlug(Eye(VirtualClock()), VideoNode("/dev/video7", 1, 2, "S", "eye"))


def test_property_numbers_are_those_of_opencv():
    for name in ("FRAME_WIDTH", "FRAME_HEIGHT", "FPS", "FOURCC", "CONVERT_RGB"):
        assert getattr(video, name) == getattr(cv2, f"CAP_PROP_{name}")
    assert video.READ_TIMEOUT_MS == cv2.CAP_PROP_READ_TIMEOUT_MSEC
    assert FORMATS[0].code == cv2.VideoWriter.fourcc(*"Y16 ")


def test_sixteen_bits_come_when_conversion_is_switched_off(plug):
    world = EmulatedTransports(video=[plug])
    (node,) = world.video_nodes()
    capture = world.open_video(node.path)
    assert capture.isOpened()
    assert capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"Y16 "))
    assert capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    pictures = [capture.read()[1] for _ in range(3)]
    assert [frame_number(picture) for picture in pictures] == [0, 1, 2]
    assert (pictures[0].shape, pictures[0].dtype) == ((51, 64), np.uint16)
    capture.set(cv2.CAP_PROP_CONVERT_RGB, 1)
    converted = capture.read()[1]
    assert (converted.shape, converted.dtype) == ((51, 64, 3), np.uint8)


def test_a_size_that_it_lacks_is_refused_and_what_is_in_force_is_told(plug):
    capture = plug.open()
    assert not capture.set(cv2.CAP_PROP_FRAME_WIDTH, 1000)
    assert capture.get(cv2.CAP_PROP_FRAME_WIDTH) == 64
    assert capture.set(cv2.CAP_PROP_FRAME_WIDTH, 32)
    assert (capture.get(cv2.CAP_PROP_FRAME_HEIGHT), capture.get(cv2.CAP_PROP_FPS)) == (24, 9.0)


def test_a_pulled_camera_reads_nothing_even_when_it_is_back(plug):
    capture = plug.open()
    assert capture.read()[0]
    plug.unplug()
    assert capture.read() == (False, None)
    assert plug.node() is None
    plug.plug()
    assert capture.read() == (False, None)
    assert plug.open().read()[0]


def test_a_node_that_does_not_exist_is_not_opened(plug):
    missing = EmulatedTransports(video=[plug]).open_video("/dev/video0")
    assert not missing.isOpened()
    assert missing.read() == (False, None)


@given(number=st.integers(0, 2**32 - 1), offset=st.integers(-2000, 2000))
def test_a_picture_tells_its_number_through_an_offset(number, offset):
    picture = ThermalScene(8, 16).picture(number).astype(int) + offset
    assert frame_number(picture.astype(np.uint16)) == number


def test_other_pictures_tell_no_number():
    with pytest.raises(ValueError, match="no picture"):
        frame_number(np.full((8, 16), 3000, np.uint16))


def test_free_running_exposures_follow_a_clock_that_is_off():
    clock = VirtualClock()
    run = FreeRun(DeviceClock(clock, ppm=1000.0), 50.0)
    starts = [run.next(1.0).start_ns for _ in range(101)]
    assert starts[-1] - starts[0] == pytest.approx(2 * NS_PER_S / 1.001, abs=2)


def test_a_camera_goes_on_when_virtual_time_begins_anew():
    clock = VirtualClock()
    run = FreeRun(DeviceClock(clock), 10.0)
    before = [run.next(1.0).start_ns for _ in range(5)]
    clock.start()
    assert before[-1] == 400_000_000
    assert [run.next(1.0).start_ns for _ in range(2)] == [100_000_000, 200_000_000]


def test_a_camera_that_waits_less_than_a_period_gets_nothing_yet():
    clock = VirtualClock()
    run = FreeRun(DeviceClock(clock), 10.0)
    assert run.next(0.05).number == 0
    assert run.next(0.05) is None
    assert run.next(0.06).number == 1


def test_a_late_host_loses_exposures_but_not_their_numbers():
    class Hurried(RealClock):
        now = 0

        def now_ns(self):
            return self.now

    clock = Hurried()
    run = FreeRun(DeviceClock(clock), 10.0, queued=2)
    assert run.next(0.0).number == 0
    clock.now = NS_PER_S
    assert [run.next(0.0).number for _ in range(2)] == [8, 9]


def test_a_slave_takes_one_picture_for_each_pulse(tmp_path):
    clock = VirtualClock()
    slave = Slaved(DeviceClock(clock), tmp_path, "trigger")
    source = LineWriter(tmp_path, "trigger")
    source.start_session()
    times = [5_000_000, 25_000_000, 45_000_000]
    for time_ns in times:
        source.emit(time_ns)
    exposures = [slave.next(1.0) for _ in times]
    assert [(item.number, item.pulse, item.start_ns) for item in exposures] == list(
        zip(range(3), range(3), times, strict=True)
    )
    assert clock.now_ns() == times[-1]
    assert slave.next(0.01) is None
    slave.close()


def test_a_slave_overlooks_pulses_that_come_too_soon(tmp_path):
    slave = Slaved(DeviceClock(VirtualClock()), tmp_path, "trigger", shortest_s=0.01)
    source = LineWriter(tmp_path, "trigger")
    source.start_session()
    for time_ns in (0, 5_000_000, 20_000_000):
        source.emit(time_ns)
    assert [slave.next(1.0).pulse for _ in range(2)] == [0, 2]
    slave.close()
