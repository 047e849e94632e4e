"""Emulated UVC cameras: a thermal one with 16 bits, a Lepton on a PureThermal board, a webcam."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from thermacq.errors import DeviceDisconnected, DeviceTimeout
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import EmulatorSettings, FaultKind, FaultSchedule, schedule_for
from thermacq.testing.emulation.scene import ThermalScene
from thermacq.testing.emulation.timing import DeviceClock, FreeRun, wait_until
from thermacq.testing.emulation.video import VideoFormat, VideoPlug
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.clock import NS_PER_S
from thermacq.transports import Transports, VideoNode

_IDS = {"thermal": (0x1514, 0x0001), "lepton": (0x1E4E, 0x0100), "webcam": (0x046D, 0x0825)}
_PRODUCTS = {"thermal": "thermal camera", "lepton": "PureThermal 2", "webcam": "webcam"}
_FORMATS = {
    "thermal": (
        VideoFormat(320, 240, "YUYV", 60.0),
        VideoFormat(320, 240, "Y16 ", 60.0),
        VideoFormat(320, 240, "Y16 ", 30.0),
        VideoFormat(640, 480, "Y16 ", 30.0),
    ),
    "lepton": (
        VideoFormat(160, 120, "Y16 ", 9.0),
        VideoFormat(160, 122, "Y16 ", 9.0),
        VideoFormat(160, 120, "UYVY", 9.0),
    ),
    "webcam": (
        VideoFormat(640, 480, "YUYV", 30.0),
        VideoFormat(320, 240, "YUYV", 30.0),
        VideoFormat(320, 240, "GREY", 30.0),
    ),
}
_LEPTON_ROWS = 120
_TURN = 1 << 32


class UvcEmulation(EmulatorSettings):
    """Settings of the emulated camera; its faults strike frames, counted since it came to life.

    It knows ``drop``, ``short_read``, ``stall`` and ``timeout`` (the frame is lost; ``timeout`` and ``stall`` for
    `seconds`), ``duplicate``, ``slow``, ``shutter_freeze``, ``disconnect``; a Lepton also ``counter_jump`` and
    ``bad_crc`` (its telemetry row is damaged).
    """

    model: Literal["thermal", "lepton", "webcam"] = "thermal"
    has_serial: bool = Field(True, description="whether it has a USB serial number")
    word_order: Literal["low_first", "high_first"] = Field("low_first", description="Lepton's 32-bit numbers")
    counter_start: int = Field(0, ge=0, le=0xFFFFFFFF)
    uptime_ms: int = Field(100_000, ge=0, le=0xFFFFFFFF, description="Lepton's time at the start")
    fpa_k: float = Field(305.15, gt=200, lt=400)


class UvcDevice:
    """The logic: `thermacq.testing.emulation.video.VideoDevice`."""

    def __init__(self, emulation: Emulation, settings: UvcEmulation, schedule: FaultSchedule) -> None:
        self.formats = _FORMATS[settings.model]
        self._settings = settings
        self._clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self._schedule = schedule
        self._made = 0
        self._jumped = 0
        self._silent_until_ns = self._shutter_opens_ns = -1
        self._source: FreeRun | None = None
        self._queue: deque[NDArray[np.generic]] = deque()
        self._seen: NDArray[np.uint16] | None = None
        self.plug: VideoPlug | None = None

    def start(self, chosen: VideoFormat) -> None:
        """Begin to stream."""
        self._chosen = chosen
        lepton_rows = chosen.rows == _LEPTON_ROWS + 2 and self._settings.model == "lepton"
        rows = _LEPTON_ROWS if lepton_rows else chosen.rows
        sixteen = chosen.fourcc == "Y16 "
        self._scene = ThermalScene(
            rows, chosen.columns, level=29_000 if sixteen else 120, span=4000 if sixteen else 100
        )
        self._telemetry = lepton_rows
        self._source = FreeRun(self._clock, chosen.rate_hz)
        self._first = self._made
        self._queue.clear()
        self._seen = None

    def stop(self) -> None:
        """Stop streaming."""
        self._source = None

    def picture(self, timeout_s: float, gone: Callable[[], bool]) -> NDArray[np.generic] | None:
        """The next picture, as the faults leave it."""
        source, host = self._source, self._clock.host
        if not self._queue and source is not None:
            exposure = source.next(timeout_s, gone)
            if exposure is not None:
                self._take(self._first + exposure.number, exposure.start_ns, gone)
        if self._queue:
            return self._queue.popleft()
        if host.now_ns() < self._silent_until_ns:
            wait_until(host, host.now_ns() + round(timeout_s * NS_PER_S), gone)
        return None

    def _take(self, number: int, start_ns: int, gone: Callable[[], bool]) -> None:
        """Put a frame into the queue once, twice, or not at all."""
        host = self._clock.host
        faults = {fault.kind: fault for fault in self._schedule.strike(self._made)}
        self._made = number + 1
        if jump := faults.get(FaultKind.COUNTER_JUMP):
            self._jumped += jump.amount
        if freeze := faults.get(FaultKind.SHUTTER_FREEZE):
            self._shutter_opens_ns = host.now_ns() + round(freeze.seconds * NS_PER_S)
        if pulled := faults.get(FaultKind.DISCONNECT):
            assert self.plug is not None
            self.plug.unplug(pulled.seconds)
            return
        if slow := faults.get(FaultKind.SLOW):
            wait_until(host, host.now_ns() + round(slow.seconds * NS_PER_S), gone)
        for kind in (FaultKind.TIMEOUT, FaultKind.STALL):
            if kind in faults:
                self._silent_until_ns = host.now_ns() + round(faults[kind].seconds * NS_PER_S)
        frame = self._frame(number, start_ns, damaged=FaultKind.BAD_CRC in faults)
        lost = faults.keys() & {FaultKind.DROP, FaultKind.SHORT_READ, FaultKind.TIMEOUT, FaultKind.STALL}
        if not lost and host.now_ns() >= self._silent_until_ns:
            self._queue.extend([frame] * (2 if FaultKind.DUPLICATE in faults else 1))

    def _frame(self, number: int, start_ns: int, *, damaged: bool) -> NDArray[np.generic]:
        closed = self._clock.host.now_ns() < self._shutter_opens_ns
        if self._seen is None or not closed:
            self._seen = self._scene.picture(number)
        fourcc = self._chosen.fourcc
        if fourcc == "Y16 ":
            return np.vstack([self._seen, self._rows(number, start_ns, closed, damaged)])
        luminance = np.minimum(self._seen, 255).astype(np.uint8)
        if fourcc == "GREY":
            return luminance
        grey = np.full_like(luminance, 128)
        return np.dstack([luminance, grey] if fourcc == "YUYV" else [grey, luminance])

    def _rows(self, number: int, start_ns: int, closed: bool, damaged: bool) -> NDArray[np.uint16]:
        """Telemetry rows A and B of a Lepton; none for other pictures."""
        if not self._telemetry:
            return np.zeros((0, self._chosen.columns), np.uint16)
        rows = np.zeros((2, self._chosen.columns), np.uint16)
        row = rows[0]
        row[0] = 0x0E
        self._put(row, 1, self._settings.uptime_ms + self._clock.ticks(start_ns, 1000))
        self._put(row, 3, (2 if closed else 3) << 4)
        self._put(row, 20, self._settings.counter_start + number + self._jumped)
        row[24] = row[29] = round(100 * self._settings.fpa_k)
        if damaged:
            row ^= 0x5555
        return rows

    def _put(self, row: NDArray[np.uint16], place: int, value: int) -> None:
        halves = value % _TURN & 0xFFFF, value % _TURN >> 16
        row[place : place + 2] = halves if self._settings.word_order == "low_first" else halves[::-1]


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a camera to life behind a video node."""
    settings = UvcEmulation.model_validate(dict(emulation.settings))
    device = UvcDevice(emulation, settings, schedule_for(emulation, settings))
    serial = settings.serial_for(emulation.name) if settings.has_serial else ""
    node = VideoNode(
        f"/dev/video-{emulation.name}", *_IDS[settings.model], serial, _PRODUCTS[settings.model], "1-2"
    )
    device.plug = VideoPlug(device, node)
    yield EmulatedTransports(video=[device.plug])


EMULATOR = Emulator(
    driver="uvc",
    summary="thermal UVC camera with 16 bits, Lepton on PureThermal with telemetry rows, or webcam",
    settings=lambda: UvcEmulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 10}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 10, "seconds": 60}]},
    },
    driver_settings={"timeout_s": 1.0},
)
