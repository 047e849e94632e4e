"""Emulated FLIR Tau 2 behind a TeAx grabber: FTDI's packets, frames with synchronisation words, wrapped UART."""

from __future__ import annotations

import struct
import time
import zlib
from binascii import crc_hqx
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

import numpy as np
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
from thermacq.testing.emulation.scene import ThermalScene
from thermacq.testing.emulation.timing import DeviceClock, Exposure, FreeRun, Slaved
from thermacq.testing.emulation.usb import (
    Endpoint,
    Interface,
    UsbDescription,
    UsbPlug,
    UsbStall,
    UsbTimeout,
    through_wire,
)
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.clock import NS_PER_S
from thermacq.transports import Transports

VID, PID = 0x0403, 0x6010
_SIZES = {"640": (512, 640), "336": (256, 336)}
_PACKET, _PAYLOAD = 512, 510
_MODEM_STATUS = b"\x32\x60"
_SYNC_FIFO, _RESET_MODE = 0x40, 0x00
_LATENCY_S = 0.004
_PIXEL, _BETWEEN_ROWS = 0xC000, 0x4000


class Tau2Emulation(EmulatorSettings):
    """Settings of the emulated camera; its faults strike frames, counted since it came to life.

    Besides those of the wire: ``drop`` and ``timeout`` (silent for `seconds`, or this frame only),
    ``duplicate``, ``short_read`` (bytes from the middle of a frame are lost in the grabber), ``garbage``,
    ``bad_crc`` (the mark of the frame is damaged), ``shutter_freeze``. `serial_faults` strike answers:
    ``bad_crc``, ``drop`` and ``garbage``.
    """

    size: Literal["640", "336"] = "640"
    own_rate_hz: float = Field(30.0, gt=0, le=120, description="frame rate of the camera running free")
    sync_line: str = Field("trigger", description="trigger line at its external sync")
    slave_number: int = Field(1, description="number of function 21 that makes it follow the line")
    left_as_slave: bool = Field(False, description="another program left it as a slave")
    output_on: bool = Field(True, description="its digital output is switched on")
    fpa_celsius: float = Field(25.3, gt=-40, lt=100)
    housing_celsius: float = Field(22.75, gt=-40, lt=100)
    ffc_s: float = Field(0.2, ge=0, le=10, description="how long its shutter stays closed")
    serial_faults: tuple[FaultSettings, ...] = ()


class TauCore:
    """The camera: answers to its serial protocol, exposures, shutter."""

    def __init__(self, emulation: Emulation, settings: Tau2Emulation) -> None:
        self.settings = settings
        self.clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self._folder = emulation.runtime_dir
        self._number = zlib.crc32(settings.serial_for(emulation.name).encode()) % 1_000_000
        self._serial_schedule = FaultSchedule(settings.serial_faults, emulation.clock, emulation.fault_log)
        self._answers = 0
        self._source: FreeRun | Slaved | None = None
        self.power_up()

    def power_up(self) -> None:
        """Start afresh."""
        self.close()
        self.words = {0x0B: 1, 0x21: self.settings.slave_number if self.settings.left_as_slave else 0}
        self._shutter_opens_ns = self.clock.host.now_ns() - 1
        self._heard = b""
        self._renew_source()

    def close(self) -> None:
        """Let go of the line."""
        if self._source is not None:
            self._source.close()
        self._source = None

    def _renew_source(self) -> None:
        self.close()
        if self.words[0x21] == self.settings.slave_number:
            shortest_s = 0.97 / self.settings.own_rate_hz
            self._source = Slaved(self.clock, self._folder, self.settings.sync_line, shortest_s)
        else:
            self._source = FreeRun(self.clock, self.settings.own_rate_hz)

    def expose(self, timeout_s: float, gone: Callable[[], bool]) -> Exposure | None:
        """The next exposure, or None when there is none in time."""
        source = self._source
        return source.next(timeout_s, gone) if source is not None and self.settings.output_on else None

    def close_shutter(self, seconds: float) -> None:
        """The picture stands still."""
        self._shutter_opens_ns = self.clock.host.now_ns() + round(seconds * NS_PER_S)

    def shutter_is_closed(self) -> bool:
        """Whether the shutter is closed now."""
        left_ns = self._shutter_opens_ns - self.clock.host.now_ns()
        return 0 < left_ns <= 10 * NS_PER_S

    def receive(self, data: bytes) -> bytes:
        """Take bytes of the serial port, and answer."""
        self._heard += data
        said = b""
        while len(self._heard) >= 10:
            head = self._heard[:8]
            length = struct.unpack(">H", head[4:6])[0]
            if head[0] != 0x6E or crc_hqx(head, 0):
                self._heard = self._heard[1:]
                continue
            if len(self._heard) < 10 + length:
                break
            content = self._heard[8 : 8 + length]
            crc = struct.unpack(">H", self._heard[8 + length : 10 + length])[0]
            self._heard = self._heard[10 + length :]
            if crc == crc_hqx(content, 0):
                said += self._through_wire(self._answer(head[3], content))
        return said

    def _answer(self, function: int, data: bytes) -> bytes:
        if function == 0x04 and not data:
            return _packet(function, struct.pack(">II", self._number, self._number + 1))
        if function == 0x05 and not data:
            return _packet(function, struct.pack(">4H", 12, 0, 3, 44))
        if function == 0x0C and not data:
            self.close_shutter(self.settings.ffc_s)
            return _packet(function, b"")
        if function == 0x20 and len(data) == 2:
            return self._sensor(int.from_bytes(data, "big"))
        if function in self.words and len(data) in (0, 2):
            if data:
                self.words[function] = int.from_bytes(data, "big")
                if function == 0x21:
                    self._renew_source()
            return _packet(function, struct.pack(">H", self.words[function]))
        return _packet(function, b"", status=0x06)

    def _sensor(self, which: int) -> bytes:
        values = {
            0x00: round(10 * self.settings.fpa_celsius),
            0x0A: round(100 * self.settings.housing_celsius),
            0x11: 0x40 if self.shutter_is_closed() else 0,
        }
        return _packet(0x20, struct.pack(">h", values[which])) if which in values else _packet(0x20, b"", 3)

    def _through_wire(self, answer: bytes) -> bytes:
        faults = self._serial_schedule.strike(self._answers)
        self._answers += 1
        for fault in faults:
            if fault.kind is FaultKind.BAD_CRC:
                answer = answer[:-1] + bytes([answer[-1] ^ 0x55])
            elif fault.kind is FaultKind.DROP:
                answer = b""
            elif fault.kind is FaultKind.GARBAGE:
                answer = bytes([0x6E] * fault.amount) + answer
        return answer


def _packet(function: int, data: bytes, status: int = 0) -> bytes:
    head = bytes([0x6E, status, 0, function]) + struct.pack(">H", len(data))
    return head + struct.pack(">H", crc_hqx(head, 0)) + data + struct.pack(">H", crc_hqx(data, 0))


class Grabber:
    """The grabber: `thermacq.testing.emulation.usb.UsbDevice`."""

    def __init__(self, core: TauCore, serial: str, schedule: FaultSchedule) -> None:
        ends = (Endpoint(0x81), Endpoint(0x02)), (Endpoint(0x83), Endpoint(0x04))
        self.description = UsbDescription(
            VID, PID, serial, "USB device", "FTDI", (Interface(0, 0, ends[0]), Interface(1, 0, ends[1]))
        )
        self._core = core
        self._schedule = schedule
        self._rows, self._columns = _SIZES[core.settings.size]
        self._scene = ThermalScene(self._rows, self._columns, level=7500, span=1500)
        self.plug: UsbPlug | None = None
        self._made = 0
        self._started = False

    def power_up(self) -> None:
        """The chip is an ordinary serial port until it is set up."""
        self._fifo = False
        self._halted = False
        self._stream = bytearray()
        self._host_said = b""
        self._silent_until = -1
        self._seen: bytes | None = None
        if self._started:
            self._core.power_up()
        self._started = True

    def control_out(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:  # noqa: ARG002
        """FTDI's requests for interface A."""
        if request_type != 0x40 or index != 1 or request not in (0x00, 0x09, 0x0B):
            raise UsbStall
        if request == 0x0B:
            self._fifo = value >> 8 == _SYNC_FIFO
            if value >> 8 not in (_SYNC_FIFO, _RESET_MODE):
                raise UsbStall
        if request == 0x00 or not self._fifo:
            self._stream.clear()

    def control_in(self, request_type: int, request: int, value: int, index: int, length: int) -> bytes:  # noqa: ARG002
        """Nothing that is used can be asked for."""
        raise UsbStall

    def bulk_out(self, endpoint: int, data: bytes, timeout_s: float) -> int:  # noqa: ARG002
        """Bytes for the camera's serial port, wrapped; they come back wrapped one by one."""
        if endpoint != 0x02:
            raise UsbStall
        if not self._fifo:
            raise UsbTimeout
        self._host_said += data
        while (place := self._host_said.find(b"UART")) >= 0 and len(self._host_said) > place + 4:
            begins = place + 5
            ends = begins + self._host_said[place + 4]
            if len(self._host_said) < ends:
                break
            said = self._core.receive(self._host_said[begins:ends])
            self._host_said = self._host_said[ends:]
            self._stream += b"".join(b"UART\x01" + bytes([byte]) for byte in said)
        return len(data)

    def bulk_in(self, endpoint: int, length: int, timeout_s: float, gone: Callable[[], bool]) -> bytes:
        """Packets of 512 bytes that begin with the chip's status; without data, the status alone."""
        if endpoint != 0x81 or self._halted or not self._fifo:
            raise UsbStall
        if not self._stream:
            exposure = self._core.expose(min(timeout_s, _LATENCY_S), gone)
            if exposure is not None:
                self._make(exposure)
            elif not self._core.settings.output_on:
                time.sleep(min(timeout_s, _LATENCY_S))
        packets = max(1, length // _PACKET)
        payload, self._stream = self._stream[: packets * _PAYLOAD], self._stream[packets * _PAYLOAD :]
        pieces = (payload[place : place + _PAYLOAD] for place in range(0, max(1, len(payload)), _PAYLOAD))
        return b"".join(_MODEM_STATUS + bytes(piece) for piece in pieces)[:length]

    def _make(self, exposure: Exposure) -> None:
        """Put a frame into the stream, as the faults leave it."""
        number, self._made = self._made, self._made + 1
        faults = self._schedule.strike(number)
        kinds = {fault.kind: fault for fault in faults}
        if freeze := kinds.get(FaultKind.SHUTTER_FREEZE):
            self._core.close_shutter(freeze.seconds)
        if quiet := kinds.get(FaultKind.TIMEOUT):
            self._silent_until = number + 1 + round(quiet.seconds * self._core.settings.own_rate_hz)
        if FaultKind.DROP in kinds or number < self._silent_until:
            return
        if self._seen is None or not self._core.shutter_is_closed():
            # Slaves of one line show the number of the pulse, so that pairs can be told from their pictures.
            self._seen = self._frame(exposure.pulse if exposure.pulse >= 0 else number)
        frame = self._seen
        if FaultKind.BAD_CRC in kinds:
            frame = b"TEAK" + frame[4:]
        if lost := kinds.get(FaultKind.SHORT_READ):
            middle = len(frame) // 2
            frame = frame[:middle] + frame[middle + lost.amount :]
        on_wire = (
            FaultKind.GARBAGE,
            FaultKind.DUPLICATE,
            FaultKind.SLOW,
            FaultKind.STALL,
            FaultKind.DISCONNECT,
        )
        assert self.plug is not None
        try:
            self._stream += through_wire(frame, [one for one in faults if one.kind in on_wire], self.plug)
        except UsbStall:
            self._halted = True
            raise

    def _frame(self, number: int) -> bytes:
        """A frame: mark, number of words, time stamp, rows between synchronisation words."""
        words = np.full((self._rows, self._columns + 2), _BETWEEN_ROWS, "<u2")
        words[:, 1:-1] = self._scene.picture(number) | _PIXEL
        words[-1, -1] = 0
        return b"TEAX" + struct.pack("<IH", words.size + 1, number & 0x3FFF) + words.tobytes()

    def clear_halt(self, endpoint: int) -> None:  # noqa: ARG002
        """Go on."""
        self._halted = False

    def select(self, interface: int, alternate: int) -> None:
        """It has one alternate setting."""


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring grabber and camera to life on an emulated bus."""
    settings = Tau2Emulation.model_validate(dict(emulation.settings))
    core = TauCore(emulation, settings)
    grabber = Grabber(core, settings.serial_for(emulation.name), schedule_for(emulation, settings))
    grabber.plug = UsbPlug(grabber)
    try:
        yield EmulatedTransports(usb=[grabber.plug])
    finally:
        core.close()


EMULATOR = Emulator(
    driver="tau2",
    summary="FLIR Tau 2 on a TeAx grabber: stream with wrapped serial port, FFC, temperatures, slave of a line",
    settings=lambda: Tau2Emulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 30}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 30, "seconds": 60}]},
        IncompleteFrame: {"faults": [{"kind": "short_read", "at": 30, "amount": 1000}]},
    },
    driver_settings={"timeout_s": 1.0},
)
