"""The driver against cameras that nobody here wrote: Aravis' fake GigE Vision cameras."""

from __future__ import annotations

import signal
import time
from itertools import pairwise

import pytest

from thermacq.devices import DeviceIdentity, FrameFlag, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.transports import RealTransports
from thermacq_drivers.gige import DRIVER
from thermacq_drivers.gige.aravis import load

from .conftest import SMALL, Host

BOTH = [DeviceIdentity("gige", "Aravis Fake", serial) for serial in ("GV01", "GV02")]
# Ample for the 5 to 6 s in which Aravis notices that a camera is gone, on a busy machine.
_GONE_WITHIN_S = 12.0


def test_discovery_tells_two_cameras_apart(pair):
    assert list(DRIVER.discover(RealTransports())) == BOTH
    assert list(DRIVER.discover(RealTransports())) == BOTH


def test_the_camera_with_the_serial_is_opened(pair, gige):
    right, left = gige("GV02"), gige("GV01")
    assert [left.open().serial, right.open().serial] == ["GV01", "GV02"]
    with pytest.raises(DeviceFault, match="several cameras answer: Fake GV01, Fake GV02"):
        gige().open()


@pytest.mark.slow
def test_a_camera_is_driven_by_one_program_only(fake_camera, gige):
    fake_camera()
    gige(address="127.0.0.1").open()
    with pytest.raises(DeviceFault, match=r"another program.* controls it|no answer"):
        gige(address="127.0.0.1").open()


def test_no_camera_is_said_in_words(aravis, gige):
    with pytest.raises(DeviceDisconnected, match="no camera with serial 'NOBODY' answers") as fault:
        gige("NOBODY").open()
    assert "power, cable and network" in fault.value.remedy


def test_what_was_applied_is_what_the_camera_answers(fake_camera, gige):
    fake_camera()
    camera = gige(address="127.0.0.1")
    camera.open()
    whole = camera.configure({})
    assert (whole["columns"], whole["rows"]) == (2048, 2048)
    wanted = {
        "columns": 640,
        "rows": 512,
        "offset_x": 8,
        "offset_y": 16,
        "pixel_format": "Mono8",
        "exposure_us": 2000.0,
        "packet_size": 1000,
        "features": {"GainRaw": 3, "GainAuto": "Once", "TestBoolean": True},
    }
    applied = camera.configure(wanted)
    assert {key: applied[key] for key in wanted} == wanted
    declared = camera.capabilities
    assert (declared.rows, declared.columns, declared.bit_depth) == (512, 640, 8)
    assert camera.configure({"columns": 1000, "rows": 2000})["offset_x"] == 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"pixel_format": "Mono14"}, "it has no pixel format Mono14; it has .*Mono16"),
        ({"columns": 5000}, "'5000' greater than allowed maximum '2048'"),
        ({"features": {"Nonsense": 1}}, "no feature 'Nonsense'"),
        ({"features": {"GainAuto": "Perhaps"}}, "'Perhaps' not an entry"),
        ({"features": {"GainRaw": "high"}}, "'GainRaw' cannot be set to 'high'"),
        ({"features": {"GainRaw": 99}}, "greater than allowed maximum"),
        ({"exposure_us": 1e9}, "greater than allowed maximum"),
        ({"ptp": True}, "it has no PTP"),
        ({"serial": "GV09"}, "ask for serial 'GV09', the open camera is 'GV01'"),
        ({"colums": 5}, "did you mean 'columns'"),
    ],
)
def test_what_the_camera_refuses_is_refused_in_words(fake_camera, gige, wrong, message):
    fake_camera()
    camera = gige(address="127.0.0.1")
    camera.open()
    with pytest.raises(DeviceFault, match=message):
        camera.configure(wrong)
    camera.configure(SMALL)
    camera.arm(TriggerMode.FREE_RUN, 50.0)
    assert Host(camera).take(3)


def test_the_frame_counter_goes_on_where_the_cameras_wraps(fake_camera, running):
    """A fresh fake camera starts at 65400 and goes from 65535 to 1."""
    fake_camera()
    _, host = running(200.0, address="127.0.0.1", buffers=500)
    counters = [frame.counter for frame in host.take(180)]
    assert counters[0] < 65_535 < counters[-1]
    assert sum(two - one - 1 for one, two in pairwise(counters)) == len(host.losses)


def test_device_times_are_the_cameras_own(fake_camera, running):
    """The clock of the fake camera is the wall clock of this machine."""
    fake_camera()
    _, host = running(50.0, address="127.0.0.1")
    frames = host.take(10)
    assert abs(frames[-1].ticks - time.time_ns()) < 5e9
    steps = [(two.ticks - one.ticks) / (two.counter - one.counter) for one, two in pairwise(frames)]
    assert min(steps) > 0


def test_software_triggers_carry_their_index(fake_camera, gige):
    fake_camera()
    camera = gige(address="127.0.0.1")
    camera.open()
    camera.configure(SMALL)
    camera.arm(TriggerMode.SOFTWARE, 20.0)
    host = Host(camera)
    for index in (0, 1, 5):
        camera.trigger(index)
        host.take(1)
    assert [frame.trigger_index for frame in host.frames] == [0, 1, 5]
    assert host.losses == []


def test_a_silent_trigger_line_times_out(fake_camera, gige):
    fake_camera()
    camera = gige(address="127.0.0.1")
    camera.open()
    camera.configure(SMALL | {"timeout_s": 0.3})
    camera.arm(TriggerMode.HARDWARE, 20.0)
    with pytest.raises(DeviceTimeout, match="though the camera answers") as fault:
        Host(camera).take(1)
    assert "trigger line" in fault.value.remedy


def test_every_frame_that_lost_packets_is_counted(fake_camera, running):
    """Of each thousand packets the camera throws five away; it does not send them again."""
    fake_camera(lost_per_thousand=5)
    # As many buffers as a host can need that is late by seconds: only packets may be lost here.
    _, host = running(50.0, address="127.0.0.1", buffers=500)
    frames = host.take(80, within_s=30.0)
    missing = sum(two.counter - one.counter - 1 for one, two in pairwise(frames))
    assert host.losses
    assert all(isinstance(loss, IncompleteFrame) for loss in host.losses)
    before_the_first = [loss for loss in host.losses if loss.last_frame < 0]
    # A frame whose very first packet was lost leaves no trace but the gap of the counter.
    assert missing >= len(host.losses) - len(before_the_first)
    assert missing <= len(host.losses) + 0.02 * len(frames) + 2


def test_damaged_frames_can_be_kept(fake_camera, running):
    fake_camera(lost_per_thousand=20)
    _, host = running(100.0, address="127.0.0.1", incomplete_frames="keep")
    flags = [frame.flags for frame in host.take(60)]
    assert FrameFlag.INCOMPLETE in flags
    assert FrameFlag.NONE in flags
    assert host.losses == []


def test_a_late_host_is_told_apart_from_a_bad_network(fake_camera, running):
    fake_camera()
    # Slow enough that a busy computer is not late by itself.
    _, host = running(20.0, address="127.0.0.1", buffers=4)
    host.take(3)
    time.sleep(1.0)
    host.take(10)
    assert [type(loss) for loss in host.losses] == [DeviceOverrun]
    counters = [frame.counter for frame in host.frames]
    assert max(two - one for one, two in pairwise(counters)) > 10


@pytest.mark.slow
def test_a_camera_that_pauses_goes_on(fake_camera, running):
    fake = fake_camera()
    _, host = running(50.0, address="127.0.0.1")
    host.take(20)
    fake.signal(signal.SIGSTOP)
    time.sleep(2.0)
    fake.signal(signal.SIGCONT)
    frames = host.take(20)
    assert len(frames) == 40
    assert len(host.losses) <= 1  # the frame that was under way
    assert max(two.ticks - one.ticks for one, two in pairwise(frames)) > 1.9e9


@pytest.mark.slow
def test_a_killed_camera_is_a_disconnection_and_comes_back(fake_camera, running):
    fake = fake_camera()
    camera, host = running(50.0, address="127.0.0.1")
    host.take(10)
    fake.kill()
    killed_s = time.monotonic()
    with pytest.raises(DeviceDisconnected, match="after frame") as fault:
        host.take(10**6, within_s=_GONE_WITHIN_S)
    assert 2.0 < time.monotonic() - killed_s < _GONE_WITHIN_S
    assert fault.value.remedy
    before_s = time.monotonic()
    camera.disarm()
    camera.close()
    assert time.monotonic() - before_s < 1.0
    with pytest.raises(DeviceDisconnected):
        camera.open()
    fake.start()
    assert camera.open().serial == "GV01"
    camera.configure(SMALL)
    camera.arm(TriggerMode.FREE_RUN, 50.0)
    assert len(Host(camera).take(5)) == 5


def test_settings_in_force_are_read_without_being_set(fake_camera, gige):
    fake_camera("GV01")
    first = gige("GV01")
    first.open()
    applied = first.configure({**SMALL, "exposure_us": 3000.0})
    first.close()
    second = gige("GV01")
    second.open()
    adopted = second.adopt()
    assert adopted == applied
    assert (adopted["columns"], adopted["rows"], adopted["exposure_us"]) == (128, 96, 3000.0)
    assert (second.capabilities.rows, second.capabilities.columns) == (96, 128)


def test_a_camera_without_a_network_is_driven_too(aravis, running):
    """Aravis' in-process camera: neither packets nor sockets, as with USB3 Vision."""
    library = load()
    library.enable_interface("Fake")
    try:
        camera, host = running(50.0, serial="1")
        assert camera.open().model == "Aravis Fake"
        applied = camera.configure(SMALL)
        camera.arm(TriggerMode.FREE_RUN, 50.0)
        frames = host.take(10)
    finally:
        library.disable_interface("Fake")
    assert applied["socket_buffer_bytes"] == 4 << 20
    assert len(frames) == 10
    assert host.losses == []
    assert len({frame.counter for frame in frames}) == 10
