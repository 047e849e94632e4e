"""What the driver makes of a camera's answers; the camera is acted by a plain object."""

from __future__ import annotations

import re
import sys
import time
import tomllib
from collections import deque
from pathlib import Path

import numpy as np
import pytest

from thermacq.devices import DeviceContext, FrameFlag, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.rig import Rig
from thermacq.timing.clock import RealClock
from thermacq.transports import RealTransports
from thermacq_drivers.gige import DRIVER
from thermacq_drivers.gige import camera as camera_module
from thermacq_drivers.gige.aravis import FoundCamera, LinkError
from thermacq_drivers.gige.camera import GigeCamera
from thermacq_drivers.gige.link import Delivery
from thermacq_drivers.gige.settings import GigeSettings

COLUMNS, ROWS = 4, 3
PIXELS = np.arange(COLUMNS * ROWS, dtype="<u2") * 1000


def delivery(frame_id: int, problem: str = "", data: bytes = PIXELS.tobytes(), **changed: int) -> Delivery:
    size = {"columns": COLUMNS, "rows": ROWS, "timestamp_ns": 10**9 * frame_id} | changed
    return Delivery(problem=problem, frame_id=frame_id, data=data, **size)


class ActedLink:
    """A camera with the methods of `AravisLink`; tests change its attributes."""

    def __init__(self, id_or_address: str) -> None:
        self.serial = id_or_address
        self.lost = False
        self.answers = True
        self.queue: deque[Delivery] = deque()
        self.short = False
        self.ptp = ["Listening", "Uncalibrated", "Slave"]
        self.rate_hz: float | None = None
        self.log: list[str] = []

    def about(self) -> FoundCamera:
        return FoundCamera(self.serial, "Lab", "Cam", self.serial, firmware="1.0")

    def region(self):
        return 0, 0, COLUMNS, ROWS

    def get(self, feature: str):
        return "as set"

    def set_exposure_us(self, exposure_us: float) -> float:
        return 0.0

    def max_frame_rate_hz(self) -> float:
        return 0.0 if self.rate_hz == 0 else 100.0

    def set_frame_rate(self, frame_rate_hz: float) -> float:
        return frame_rate_hz if self.rate_hz is None else self.rate_hz

    def trigger_sources(self):
        return ("Software", "Line0")

    def set_trigger(self, source: str) -> None:
        self.log.append(f"trigger {source}")

    def software_trigger(self) -> None:
        if not self.answers:
            self.lost = True
            raise LinkError("timeout", gone=True)
        self.log.append("fired")

    def enable_ptp(self) -> None:
        self.log.append("ptp")

    def ptp_status(self) -> str:
        return self.ptp.pop(0) if len(self.ptp) > 1 else self.ptp[0]

    def alive(self) -> bool:
        return self.answers

    def set_packet_size(self, size: int) -> int:
        return size

    def prepare_stream(self, settings) -> int:
        return 212_992

    def start(self) -> None:
        self.log.append("start")

    def pop(self, timeout_s: float) -> Delivery | None:
        if self.queue:
            return self.queue.popleft()
        time.sleep(min(timeout_s, 0.01))
        return None

    def ran_short_of_buffers(self) -> bool:
        return self.short

    def nothing(self, *_: object) -> None:
        """Answers to whatever needs no answer."""

    set = set_region = set_pixel_format = stop = drop_stream = drop = nothing


class Host:
    def __init__(self) -> None:
        self.counts = np.full((ROWS, COLUMNS), 9, np.uint16)

    def buffer(self):
        return self.counts

    def stopping(self) -> bool:
        return False


@pytest.fixture
def make(monkeypatch):
    """Makes an open, configured camera, and its acted link."""
    monkeypatch.setattr(camera_module, "AravisLink", ActedLink)
    monkeypatch.setattr(camera_module, "list_cameras", lambda: [FoundCamera("C1", "Lab", "Cam", "C1")])

    def made(**settings: object) -> tuple[GigeCamera, ActedLink]:
        camera = GigeCamera(DeviceContext("left", RealClock(), settings=settings))
        camera.open()
        camera.configure(settings)
        return camera, camera._link

    return made


def armed(camera: GigeCamera, mode: TriggerMode = TriggerMode.FREE_RUN):
    camera.arm(mode, 50.0)
    return camera.frames(Host())


def test_a_complete_frame_keeps_its_times_and_pixels(make):
    camera, link = make()
    link.queue.append(delivery(65_535))
    link.queue.append(delivery(1, timestamp_ns=0))
    frames = armed(camera)
    first = next(frames)
    assert first.counts.tolist() == PIXELS.reshape(ROWS, COLUMNS).tolist()
    assert (first.counter, first.ticks, first.trigger_index) == (65_535, 65_535 * 10**9, -1)
    second = next(frames)
    assert (second.counter, second.ticks) == (65_536, -1)


def test_eight_bit_pixels_become_counts(make):
    camera, link = make(pixel_format="Mono8")
    link.queue.append(delivery(1, data=bytes(range(12))))
    assert next(armed(camera)).counts.ravel().tolist() == list(range(12))
    assert camera.capabilities.bit_depth == 8


@pytest.mark.parametrize(
    "damaged", [delivery(5, "missing packets"), delivery(5, columns=2), delivery(5, rows=0, data=b"")]
)
def test_an_incomplete_frame_is_a_typed_loss_and_the_stream_goes_on(make, damaged):
    camera, link = make()
    link.queue.extend([damaged, delivery(6)])
    frames = armed(camera)
    with pytest.raises(IncompleteFrame, match="frame id 5 came incomplete"):
        next(frames)
    assert next(camera.frames(Host())).counter == 6


def test_an_incomplete_frame_can_be_kept_and_is_flagged(make):
    camera, link = make(incomplete_frames="keep")
    link.queue.append(delivery(5, "missing packets", data=PIXELS[:5].tobytes()))
    frame = next(armed(camera))
    assert frame.flags == FrameFlag.INCOMPLETE
    assert frame.counts.ravel().tolist() == [0, 1000, 2000, 3000, 4000, 0, 0, 0, 0, 0, 0, 0]


def test_frames_lost_for_want_of_a_buffer_are_an_overrun(make):
    camera, link = make()
    link.queue.extend([delivery(5), delivery(9)])
    frames = armed(camera)
    assert next(frames).counter == 5
    link.short = True
    with pytest.raises(DeviceOverrun, match="3 frames found no free buffer"):
        next(frames)
    assert next(camera.frames(Host())).counter == 9


def test_a_gap_without_underruns_is_left_to_the_counter(make):
    camera, link = make()
    link.queue.extend([delivery(5), delivery(9)])
    frames = armed(camera)
    assert [next(frames).counter, next(frames).counter] == [5, 9]


def test_each_software_trigger_gets_its_own_frame(make):
    camera, link = make(trigger_timeout_s=0.05)
    frames = armed(camera, TriggerMode.SOFTWARE)
    camera.trigger(7)
    link.queue.append(delivery(1))
    assert next(frames).trigger_index == 7
    camera.trigger(8)
    with pytest.raises(IncompleteFrame, match="trigger 8 gave no frame"):
        next(frames)
    link.queue.append(delivery(2))  # the frame of trigger 8, too late
    camera.trigger(9)
    link.queue.append(delivery(3))
    late = next(camera.frames(Host()))
    assert (late.trigger_index, late.counter) == (9, 3)
    assert link.log.count("fired") == 3


def test_a_trigger_without_an_answer_is_a_disconnection(make):
    camera, link = make()
    armed(camera, TriggerMode.SOFTWARE)
    link.answers = False
    with pytest.raises(DeviceDisconnected, match=r"device 'left' \(trigger\): no answer: timeout"):
        camera.trigger(0)


def test_a_trigger_that_nobody_armed_is_refused(make):
    camera, _ = make()
    armed(camera)
    with pytest.raises(DeviceFault, match="not armed for software triggers"):
        camera.trigger(0)


@pytest.mark.parametrize(("answers", "kind"), [(True, DeviceTimeout), (False, DeviceDisconnected)])
def test_silence_is_told_apart_from_loss(make, answers, kind):
    camera, link = make(timeout_s=0.05)
    frames = armed(camera, TriggerMode.HARDWARE)
    link.answers = answers
    with pytest.raises(kind, match="no frame came for") as fault:
        next(frames)
    assert fault.value.remedy


def test_a_lost_control_channel_is_a_disconnection(make):
    camera, link = make()
    link.queue.append(delivery(1))
    frames = armed(camera)
    next(frames)
    link.lost = True
    with pytest.raises(DeviceDisconnected, match=r"after frame 0.*control channel was lost"):
        next(frames)


def test_a_disarmed_camera_yields_no_more(make):
    camera, link = make()
    link.queue.extend([delivery(1), delivery(2)])
    frames = armed(camera)
    next(frames)
    camera.disarm()
    assert list(frames) == []
    assert list(camera.frames(Host())) == []


def test_arming_waits_until_ptp_is_in_step(make):
    camera, link = make(ptp=True)
    link.ptp = ["Listening", "Slave"]
    camera.arm(TriggerMode.HARDWARE, 50.0)
    assert link.log == ["trigger ", "ptp", "trigger ", "trigger Line0", "start"]


def test_a_clock_that_does_not_follow_is_refused(make):
    camera, link = make(ptp=True, ptp_wait_s=0.0)
    link.ptp = ["Listening"]
    with pytest.raises(DeviceFault, match="PTP is in state 'Listening'"):
        camera.arm(TriggerMode.FREE_RUN, 50.0)


def test_what_the_system_grants_is_what_was_applied(make):
    camera, _ = make()
    applied = camera.configure({"features": {"Gain": "High"}, "ptp": True})
    assert applied["socket_buffer_bytes"] == 212_992
    assert applied["ptp_status"] == "Uncalibrated"  # arming is what waits
    assert applied["features"] == {"Gain": "as set"}
    assert (applied["columns"], applied["rows"]) == (COLUMNS, ROWS)


def test_a_rate_that_the_camera_does_not_keep_is_refused(make):
    camera, link = make()
    link.rate_hz = 30.0
    with pytest.raises(DeviceFault, match="50 frames/s asked, it runs at 30"):
        camera.arm(TriggerMode.FREE_RUN, 50.0)


def test_a_fixed_rate_must_be_told(make):
    camera, link = make()
    link.rate_hz = 0.0
    with pytest.raises(DeviceFault, match="frame rate cannot be set"):
        camera.arm(TriggerMode.FREE_RUN, 50.0)
    camera.configure({"max_frame_rate_hz": 50.0})
    camera.arm(TriggerMode.FREE_RUN, 50.0)


def test_a_loss_is_parted_from_aside_and_the_same_camera_comes_back(make, monkeypatch):
    camera, link = make()
    parted: list[float] = []

    def slow_farewell() -> None:
        time.sleep(0.2)
        parted.append(time.monotonic())

    monkeypatch.setattr(link, "drop", slow_farewell)
    armed(camera)
    link.lost = True
    camera.disarm()
    camera.close()
    assert parted == []  # nobody waited
    found = [FoundCamera(serial, "Lab", "Cam", serial) for serial in ("C0", "C1", "C2")]
    monkeypatch.setattr(camera_module, "list_cameras", lambda: found)
    assert camera.open().serial == "C1"
    assert len(parted) == 1
    camera.configure({})
    armed(camera)


def test_several_cameras_need_a_serial(make, monkeypatch):
    make()
    found = [FoundCamera(serial, "Lab", "Cam", serial) for serial in ("C1", "C2")]
    monkeypatch.setattr(camera_module, "list_cameras", lambda: found)
    with pytest.raises(DeviceFault, match="several cameras answer: Cam C1, Cam C2"):
        GigeCamera(DeviceContext("left", RealClock())).open()
    assert GigeCamera(DeviceContext("left", RealClock(), serial="C2")).open().serial == "C2"
    with pytest.raises(DeviceDisconnected, match="no camera with serial 'C3' answers"):
        GigeCamera(DeviceContext("left", RealClock(), settings={"serial": "C3"})).open()


def test_another_camera_at_the_address_is_refused(make):
    make()
    context = DeviceContext("left", RealClock(), serial="C1", settings={"address": "10.0.0.9"})
    with pytest.raises(DeviceFault, match=r"at 10\.0\.0\.9 has serial '10\.0\.0\.9', not 'C1'"):
        GigeCamera(context).open()


def test_without_aravis_nothing_is_found_and_the_remedy_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "gi", None)
    assert DRIVER.discover(RealTransports()) == ()
    camera = DRIVER.make(DeviceContext("left", RealClock()))
    with pytest.raises(DeviceFault, match="Aravis cannot be loaded") as fault:
        camera.open()
    assert "apt install" in fault.value.remedy
    camera.close()


def test_the_rig_of_the_how_to_is_a_rig():
    page = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "use-a-gige-camera.md"
    first, features = re.findall(r"```toml\n(.*?)```", page.read_text(), re.DOTALL)
    rig = Rig.model_validate(tomllib.loads(first + features))
    assert rig.cameras["left"].settings["features"] == {"NUCMode": "Manual", "GevSCPD": 2000}
    for camera in rig.cameras.values():
        GigeSettings.model_validate(camera.settings)
