"""Emulated InfiRay P2 Pro: pictures over UVC with a thermal half, vendor requests that need a running stream."""

from __future__ import annotations

import struct
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from thermacq.errors import DeviceDisconnected, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import EmulatorSettings, FaultKind, FaultSchedule, schedule_for
from thermacq.testing.emulation.scene import ThermalScene
from thermacq.testing.emulation.timing import DeviceClock, FreeRun, wait_until
from thermacq.testing.emulation.usb import Interface, UsbDescription, UsbPlug, UsbStall, UsbTimeout
from thermacq.testing.emulation.video import VideoFormat, VideoPlug
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.clock import NS_PER_S
from thermacq.transports import Transports, VideoNode

VID, PID = 0x0BDA, 0x5830
_ROWS, _COLUMNS, _RATE_HZ = 192, 256, 25.0
_AMBIENT = round(64 * 293.15)
_SLICE_S = 0.02
_BUSY = b"\x01"


class P2ProEmulation(EmulatorSettings):
    """Settings of the emulated camera; its faults strike pictures, counted since it came to life.

    ``drop`` and ``short_read`` (the kernel throws incomplete pictures away), ``garbage`` (a picture of a wrong
    size), ``duplicate``, ``timeout`` and ``stall`` (silent for `seconds`, or this one is lost), ``slow``,
    ``shutter_freeze`` and ``disconnect``.
    """

    serial_on_usb: bool = Field(True, description="its USB descriptor holds the serial number")
    busy_polls: int = Field(2, ge=0, le=10_000, description="how often its status says busy after a command")
    refuses: int = Field(0, ge=0, le=255, description="status after every command, 4 to 255: an error")
    only_picture: bool = Field(False, description="it offers 256 x 192 without a thermal half")


class P2ProControlSide:
    """The vendor requests: `thermacq.testing.emulation.usb.UsbDevice`."""

    def __init__(self, settings: P2ProEmulation, serial: str, streams: Callable[[], bool]) -> None:
        self.description = UsbDescription(
            VID,
            PID,
            serial if settings.serial_on_usb else "",
            "USB Camera",
            "Generic",
            (Interface(0, interface_class=0x0E), Interface(1, interface_class=0x0E)),
        )
        self._settings = settings
        self._streams = streams
        self._texts = {1: b"20230101", 6: b"P2 Pro", 7: serial.encode()}
        self.power_up()

    def power_up(self) -> None:
        """Start afresh."""
        # Emissivity 0.95, high gain; the others as they came.
        self.parameters = {0: 40, 1: 300, 2: 300, 3: 121, 4: 127, 5: 1}
        self._held = b""
        self._short = self._long = b""
        self._busy = 0

    def control_out(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """A command, or a part of one; without a running picture the camera hangs."""
        if (request_type, request, value) != (0x41, 0x45, 0x78):
            raise UsbStall
        if not self._streams():
            raise UsbTimeout
        if index == 0x9D00 and len(data) == 8:
            self._held = data
        elif index == 0x1D08 and self._held and len(data) == 8:
            self._do_long(self._held + data)
            self._held = b""
        elif index == 0x1D00 and len(data) == 8:
            self._do_short(data)
        else:
            raise UsbStall

    def _do_short(self, data: bytes) -> None:
        number, parameter = struct.unpack("<HI", data[:6])
        length = struct.unpack(">H", data[6:])[0]
        if number != 0x8405 or parameter not in self._texts:
            raise UsbStall
        self._short = self._texts[parameter].ljust(length, b"\0")[:length]
        self._busy = self._settings.busy_polls

    def _do_long(self, data: bytes) -> None:
        number = struct.unpack("<H", data[:2])[0]
        which, value, _, length = struct.unpack(">HIII", data[2:])
        if which not in self.parameters:
            raise UsbStall
        if number == 0x8514:
            self._long = self.parameters[which].to_bytes(length, "big")
        elif number == 0xC514:
            self.parameters[which] = value
        else:
            raise UsbStall
        self._busy = self._settings.busy_polls

    def control_in(self, request_type: int, request: int, value: int, index: int, length: int) -> bytes:
        """The status, or an answer."""
        if (request_type, request, value) != (0xC1, 0x44, 0x78):
            raise UsbStall
        if not self._streams():
            raise UsbTimeout
        if index == 0x0200:
            if self._busy:
                self._busy -= 1
                return _BUSY
            return bytes([self._settings.refuses])
        answers = {0x1D08: self._short, 0x1D10: self._long}
        if self._busy or index not in answers:
            raise UsbStall
        return answers[index][:length]

    def bulk_in(self, endpoint: int, length: int, timeout_s: float, gone: Callable[[], bool]) -> bytes:  # noqa: ARG002
        """Its picture goes through the kernel."""
        raise UsbStall

    def bulk_out(self, endpoint: int, data: bytes, timeout_s: float) -> int:  # noqa: ARG002
        """It takes nothing."""
        raise UsbStall

    def clear_halt(self, endpoint: int) -> None:
        """Nothing halts."""

    def select(self, interface: int, alternate: int) -> None:
        """The kernel's business."""


class P2ProVideo:
    """The pictures: `thermacq.testing.emulation.video.VideoDevice`."""

    def __init__(self, emulation: Emulation, settings: P2ProEmulation, schedule: FaultSchedule) -> None:
        self._clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self._schedule = schedule
        self._scene = ThermalScene(_ROWS, _COLUMNS, level=_AMBIENT, span=640)
        rows = _ROWS if settings.only_picture else 2 * _ROWS
        self.formats: tuple[VideoFormat, ...] = (VideoFormat(_COLUMNS, rows, "YUYV", _RATE_HZ),)
        self._lock = threading.Lock()
        self._source: FreeRun | None = None
        self._number = 0
        self._made = 0
        self._still = self._still_until = self._silent_until = -1
        self._queue: deque[NDArray[np.uint8]] = deque()
        self.pull: Callable[[float], None] | None = None

    @property
    def streams(self) -> bool:
        """Whether it streams now."""
        return self._source is not None

    def start(self, chosen: VideoFormat) -> None:
        """Begin to stream."""
        with self._lock:
            self._source = FreeRun(self._clock, chosen.rate_hz)
            self._made = self._number
            self._queue.clear()

    def stop(self) -> None:
        """Stop streaming."""
        with self._lock:
            self._source = None

    def picture(self, timeout_s: float, gone: Callable[[], bool]) -> NDArray[np.generic] | None:
        """The next picture, as the faults leave it."""
        host = self._clock.host
        deadline_ns = host.now_ns() + round(timeout_s * NS_PER_S)
        while not gone() and (source := self._source) is not None:
            if self._queue:
                return self._queue.popleft()
            left_s = (deadline_ns - host.now_ns()) / NS_PER_S
            if left_s <= 0:
                return None
            exposure = source.next(min(left_s, _SLICE_S), gone)
            if exposure is not None:
                self._number = self._made + exposure.number + 1
                self._take(self._number - 1, gone)
        return None

    def _take(self, number: int, gone: Callable[[], bool]) -> None:
        faults = {fault.kind: fault for fault in self._schedule.strike(number)}
        if (pulled := faults.get(FaultKind.DISCONNECT)) and self.pull is not None:
            self.pull(pulled.seconds)
            return
        if freeze := faults.get(FaultKind.SHUTTER_FREEZE):
            self._still, self._still_until = number, number + round(freeze.seconds * _RATE_HZ)
        if slow := faults.get(FaultKind.SLOW):
            now_ns = self._clock.host.now_ns()
            wait_until(self._clock.host, now_ns + round(slow.seconds * NS_PER_S), gone)
        for kind in (FaultKind.TIMEOUT, FaultKind.STALL):
            if kind in faults:
                self._silent_until = number + 1 + round(faults[kind].seconds * _RATE_HZ)
        if faults.keys() & {FaultKind.DROP, FaultKind.SHORT_READ} or number < self._silent_until:
            return
        picture = self._picture(self._still if number < self._still_until else number)
        if FaultKind.GARBAGE in faults:
            picture = picture[:-1]
        self._queue.extend([picture] * (2 if FaultKind.DUPLICATE in faults else 1))

    def _picture(self, number: int) -> NDArray[np.uint8]:
        """(384, 256, 2) uint8: a picture to look at, and below it the temperatures in 1/64 K."""
        counts = self._scene.picture(number)
        shown = np.full((_ROWS, _COLUMNS, 2), 128, np.uint8)
        shown[..., 0] = counts >> 4 & 0xFF
        below = counts.astype("<u2").view(np.uint8).reshape(_ROWS, _COLUMNS, 2)
        whole = np.concatenate((shown, below))
        return whole[: self.formats[0].rows]


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a camera to life: a video node, and a USB device with the same serial number."""
    settings = P2ProEmulation.model_validate(dict(emulation.settings))
    serial = settings.serial_for(emulation.name)[:16]
    video = P2ProVideo(emulation, settings, schedule_for(emulation, settings))
    on_usb = serial if settings.serial_on_usb else ""
    plug = VideoPlug(video, VideoNode(f"/dev/video-{emulation.name}", VID, PID, on_usb, "USB Camera", "1-1"))
    usb = UsbPlug(P2ProControlSide(settings, serial, lambda: video.streams))

    def pull(seconds: float) -> None:
        plug.unplug(seconds)
        usb.unplug(seconds)

    video.pull = pull
    yield EmulatedTransports(usb=[usb], video=[plug])
    video.stop()


EMULATOR = Emulator(
    driver="p2pro",
    summary="InfiRay P2 Pro, Topdon TC001: thermal half over UVC, vendor requests while it streams",
    settings=lambda: P2ProEmulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 8}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 8, "seconds": 60}]},
        IncompleteFrame: {"faults": [{"kind": "garbage", "at": 8}]},
    },
    driver_settings={"timeout_s": 1.0},
)
