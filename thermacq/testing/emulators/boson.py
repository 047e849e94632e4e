"""Emulated FLIR Boson 640 or 320: pictures with telemetry rows over UVC, FSLP on a serial port, external sync.

One core stands behind both: what is set over the serial port shows in the pictures. How the telemetry row is
packed over USB is described in conflicting ways; both are played, and cameras without it. What a real camera
shows in the two extra rows while telemetry is off, and whether it follows pulses at 50 Hz, is not known.
"""

from __future__ import annotations

import struct
import threading
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from thermacq.errors import DeviceDisconnected, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import (
    EmulatorSettings,
    FaultKind,
    FaultSchedule,
    FaultSettings,
    schedule_for,
)
from thermacq.testing.emulation.pty import PtyPort
from thermacq.testing.emulation.scene import ThermalScene
from thermacq.testing.emulation.timing import DeviceClock, Exposure, FreeRun, Slaved, wait_until
from thermacq.testing.emulation.video import VideoFormat, VideoPlug
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.testing.emulators.boson_fslp import FslpPort
from thermacq.timing.clock import NS_PER_S
from thermacq.timing.trigger_line import LineWriter
from thermacq.transports import SerialNode, Transports, VideoNode

VID, PID = 0x09CB, 0x4007
_SIZES = {"640": (640, 512), "320": (320, 256)}
_RATE_HZ = 60.0
# A slave overlooks pulses that come before it has read out the last picture.
_SHORTEST_S = 0.97 / _RATE_HZ
_SLICE_S = 0.02
_ORDINARY, _MASTER, _SLAVE = 0, 1, 2
_TURN = 1 << 32


class BosonEmulation(EmulatorSettings):
    """Settings of the emulated camera: `faults` strike frames, `serial_faults` the answers of its serial port.

    Frames know the faults ``drop`` and ``short_read`` (the kernel throws incomplete frames away), ``duplicate``,
    ``bad_crc`` (the telemetry row is damaged), ``timeout`` and ``stall`` (no frame for `seconds`, or this one
    is lost), ``slow``, ``counter_jump``, ``shutter_freeze`` and ``disconnect``.
    """

    size: Literal["640", "320"] = "640"
    telemetry: Literal["16-bit", "8-bit", "none"] = Field(
        "16-bit", description="how its firmware packs the row by default; none: it has no telemetry on USB"
    )
    sync_line: str = Field("trigger", description="trigger line at its external sync")
    fpa_celsius: float = Field(31.4, gt=-40, lt=100, description="temperature of the focal-plane array")
    ffc_s: float = Field(0.2, ge=0, le=10, description="how long its shutter stays closed")
    counter_start: int = Field(0, ge=0, le=0xFFFFFFFF, description="its frame counter at power-up")
    serial_faults: tuple[FaultSettings, ...] = Field(default=(), description="faults of the serial port")

    def serial_for(self, name: str) -> str:
        """Decimal, as the maker's."""
        return self.serial or str(200_000 + zlib.crc32(name.encode()) % 100_000)


class BosonCore:
    """The camera proper: exposures, shutter, counter. Its two sides call it from threads of their own."""

    def __init__(self, emulation: Emulation, settings: BosonEmulation) -> None:
        self.settings = settings
        self.serial = int(settings.serial_for(emulation.name))
        self.columns, self.rows = _SIZES[settings.size]
        self.clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self.lock = threading.RLock()
        self._folder = emulation.runtime_dir
        self._source: FreeRun | Slaved | None = None
        self._line: LineWriter | None = None
        self.power_up()

    def power_up(self) -> None:
        """Start afresh, with the settings of the factory."""
        with self.lock:
            self.stop()
            self.sync, self.ffc_mode, self.gain = _ORDINARY, 1, 0
            self.telemetry_on, self.telemetry_location, self.telemetry_packing = False, 1, 0
            self.counter = self.settings.counter_start - 1
            self.rate_hz = _RATE_HZ
            self.last_ffc = 0
            self._shutter_opens_ns = self._now_ns()
            self._ffc_ran = False
            self._streams = False

    def start(self, rate_hz: float) -> None:
        """Begin to stream."""
        with self.lock:
            self.rate_hz, self._streams = rate_hz, True
            self._renew_source()

    def stop(self) -> None:
        """Stop streaming."""
        with self.lock:
            self._streams = False
            self._drop_source()

    def set_sync(self, mode: int) -> None:
        """Follow a line, lead it, or neither."""
        with self.lock:
            self.sync = mode
            if self._streams:
                self._renew_source()

    def _renew_source(self) -> None:
        self._drop_source()
        line = self.settings.sync_line
        if self.sync == _SLAVE:
            self._source = Slaved(self.clock, self._folder, line, _SHORTEST_S)
        else:
            self._source = FreeRun(self.clock, self.rate_hz)
        if self.sync == _MASTER:
            self._line = LineWriter(self._folder, line)
            self._line.start_session()
        self._first = self.counter + 1

    def _drop_source(self) -> None:
        if self._source is not None:
            self._source.close()
        if self._line is not None:
            self._line.finish_session()
        self._source, self._line = None, None

    def expose(self, timeout_s: float, gone: Callable[[], bool]) -> Exposure | None:
        """Wait a little for the next exposure; None when there was none, or it belongs to another sync mode."""
        source = self._source
        exposure = source.next(min(timeout_s, _SLICE_S), gone) if source is not None else None
        with self.lock:
            if exposure is None or source is not self._source:
                return None
            self.counter = self._first + exposure.number
            if self._line is not None:
                self._line.emit(exposure.start_ns)
            return exposure

    def leap(self, amount: int) -> None:
        """The frame counter leaps."""
        with self.lock:
            self.counter += amount
            self._first += amount

    def close_shutter(self, seconds: float) -> None:
        """Begin a flat-field correction."""
        with self.lock:
            self._shutter_opens_ns = self._now_ns() + round(seconds * NS_PER_S)
            self.last_ffc, self._ffc_ran = self.counter, True

    def shutter_is_closed(self) -> bool:
        """Whether the correction goes on."""
        return self._now_ns() < self._shutter_opens_ns

    def _now_ns(self) -> int:
        """Time since the camera came to life; goes on when virtual time begins anew."""
        return self.clock.ticks(self.clock.host.now_ns(), NS_PER_S)

    def ffc_status(self) -> int:
        """0 none, 2 in progress, 3 complete."""
        return 2 if self.shutter_is_closed() else 3 if self._ffc_ran else 0

    def record(self, exposure: Exposure) -> bytes:
        """The telemetry record of an exposure, in the order of the data sheet."""
        record = bytearray(640)
        struct.pack_into(">I", record, 2, self.serial)
        struct.pack_into(">I", record, 6, self.serial + 1000)
        record[10:30] = self.part_number()
        struct.pack_into(">H", record, 56, round(self.rate_hz))
        struct.pack_into(">II", record, 84, self.counter % _TURN, self.last_ffc % _TURN)
        kelvin_tenths = round(10 * (self.settings.fpa_celsius + 273.15))
        struct.pack_into(">HH", record, 94, kelvin_tenths, kelvin_tenths)
        struct.pack_into(">I", record, 280, self.clock.ticks(exposure.start_ns, 1000) % _TURN)
        return bytes(record)

    def part_number(self) -> bytes:
        """20 characters, filled up with NUL."""
        return f"20{self.settings.size}A050-9CAAX".encode().ljust(20, b"\0")


# Fields of the record that are wider than a byte: (offset, width).
_NUMBERS = ((2, 4), (6, 4), (56, 2), (84, 4), (88, 4), (94, 2), (96, 2), (280, 4))


def telemetry_row(record: bytes, columns: int, packing: str) -> NDArray[np.uint16]:
    """One row of the picture that carries a record: 16-bit words, or bytes with numbers low byte first."""
    row = np.zeros(columns, np.uint16)
    if packing == "16-bit":
        words = np.frombuffer(record, ">u2")[:columns]
    else:
        turned = bytearray(record)
        for offset, width in _NUMBERS:
            turned[offset : offset + width] = record[offset : offset + width][::-1]
        words = np.frombuffer(bytes(turned), np.uint8)[:columns]
    row[: words.size] = words
    return row


class BosonVideo:
    """The pictures: `thermacq.testing.emulation.video.VideoDevice`."""

    def __init__(self, core: BosonCore, schedule: FaultSchedule) -> None:
        self._core = core
        self._schedule = schedule
        self._scene = ThermalScene(core.rows, core.columns, level=20_000, span=8000)
        self._frames = 0
        self._silent_until_ns = -1
        self._queue: deque[NDArray[np.uint16]] = deque()
        self._seen: NDArray[np.uint16] | None = None
        self.pull: Callable[[float], None] | None = None
        extra = () if core.settings.telemetry == "none" else (2,)
        self.formats = tuple(
            VideoFormat(core.columns, core.rows + rows, letters, rate_hz)
            for letters in ("NV12", "Y16 ")
            for rows in (0, *extra)
            for rate_hz in (60.0, 30.0)
        )

    def start(self, chosen: VideoFormat) -> None:
        """Begin to stream."""
        self._chosen = chosen
        self._queue.clear()
        self._core.start(chosen.rate_hz)

    def stop(self) -> None:
        """Stop streaming."""
        self._core.stop()

    def picture(self, timeout_s: float, gone: Callable[[], bool]) -> NDArray[np.generic] | None:
        """The next picture, as the faults leave it."""
        clock = self._core.clock.host
        deadline_ns = clock.now_ns() + round(timeout_s * NS_PER_S)
        waits = 0
        while not gone() and waits * _SLICE_S < timeout_s:
            if self._queue:
                return self._in_format(self._queue.popleft())
            before_ns = clock.now_ns()
            exposure = self._core.expose((deadline_ns - before_ns) / NS_PER_S, gone)
            if exposure is None:
                waits += 1
            else:
                self._take(exposure, gone)
        return None

    def _take(self, exposure: Exposure, gone: Callable[[], bool]) -> None:
        """Put a frame into the queue once, twice, or not at all."""
        core, clock = self._core, self._core.clock.host
        faults = {fault.kind: fault for fault in self._schedule.strike(self._frames)}
        self._frames += 1
        if freeze := faults.get(FaultKind.SHUTTER_FREEZE):
            core.close_shutter(freeze.seconds)
        if jump := faults.get(FaultKind.COUNTER_JUMP):
            core.leap(jump.amount)
        if (pulled := faults.get(FaultKind.DISCONNECT)) and self.pull is not None:
            self.pull(pulled.seconds)
            return
        frame = self._expose(exposure, damaged=FaultKind.BAD_CRC in faults)
        if slow := faults.get(FaultKind.SLOW):
            wait_until(clock, clock.now_ns() + round(slow.seconds * NS_PER_S), gone)
        for kind in (FaultKind.TIMEOUT, FaultKind.STALL):
            if kind in faults:
                self._silent_until_ns = clock.now_ns() + round(faults[kind].seconds * NS_PER_S)
        lost = faults.keys() & {FaultKind.DROP, FaultKind.SHORT_READ, FaultKind.TIMEOUT, FaultKind.STALL}
        if not lost and clock.now_ns() >= self._silent_until_ns:
            self._queue.extend([frame] * (2 if FaultKind.DUPLICATE in faults else 1))

    def _expose(self, exposure: Exposure, *, damaged: bool) -> NDArray[np.uint16]:
        """One frame of 16 bits in the size that was chosen."""
        core = self._core
        if self._seen is None or not core.shutter_is_closed():
            # Slaves of one line show the number of the pulse, so that pairs can be told from their pictures.
            self._seen = self._scene.picture(exposure.pulse if exposure.pulse >= 0 else core.counter % _TURN)
        if self._chosen.rows == core.rows:
            return self._seen
        extra = np.zeros((2, core.columns), np.uint16)
        at_top = core.telemetry_location == 0
        if core.telemetry_on:
            packing = "8-bit" if core.telemetry_packing == 2 else core.settings.telemetry
            extra[0] = telemetry_row(core.record(exposure), core.columns, packing)
            if damaged:
                extra[0] ^= 0x55
        return np.vstack([extra, self._seen] if at_top else [self._seen, extra])

    def _in_format(self, frame: NDArray[np.uint16]) -> NDArray[np.generic]:
        if self._chosen.fourcc == "Y16 ":
            return frame
        grey = (frame >> 8).astype(np.uint8)
        return np.vstack([grey, np.full((grey.shape[0] // 2, grey.shape[1]), 128, np.uint8)])


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a camera to life: a video node and a serial port with the same serial number."""
    settings = BosonEmulation.model_validate(dict(emulation.settings))
    core = BosonCore(emulation, settings)
    serial = str(core.serial)
    video = BosonVideo(core, schedule_for(emulation, settings))
    plug = VideoPlug(video, VideoNode(f"/dev/video-{emulation.name}", VID, PID, serial, "Boson", "1-1"))
    wire = FaultSchedule(settings.serial_faults, emulation.clock, emulation.fault_log)
    node = SerialNode("", VID, PID, serial, "Boson")
    with PtyPort(FslpPort(core), node, emulation.clock, wire) as port:

        def pull(seconds: float) -> None:
            plug.unplug(seconds)
            port.unplug(seconds)

        video.pull = pull
        yield EmulatedTransports(serial=[port], video=[plug])
    core.stop()


EMULATOR = Emulator(
    driver="boson",
    summary="FLIR Boson: Y16 with telemetry in both packings or none, FSLP, slave and master of a trigger line",
    settings=lambda: BosonEmulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 20}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 20, "seconds": 60}]},
        IncompleteFrame: {"faults": [{"kind": "bad_crc", "at": 20}]},
    },
    driver_settings={"timeout_s": 1.0},
)
