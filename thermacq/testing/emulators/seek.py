"""Emulated Seek Thermal Compact and CompactPRO: their initialisation, frame types and own shutter frames."""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from thermacq.errors import DeviceDisconnected, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import EmulatorSettings, FaultKind, FaultSchedule, schedule_for
from thermacq.testing.emulation.scene import ThermalScene
from thermacq.testing.emulation.timing import DeviceClock, wait_until
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
from thermacq.transports import Transports

VID = 0x289D
# name: (pid, raw columns, raw rows, (row, column, rows, columns) of the picture, type word, counter word, rate)
_MODELS = {
    "compact": (0x0010, 208, 156, (1, 0, 154, 207), 10, 40, 9.0),
    "compact_pro": (0x0011, 342, 260, (4, 1, 240, 320), 2, 1, 15.0),
}
_FIRST, _SHUTTER, _SCENE = 4, 1, 3
_LEVEL = 3000
_SERIAL_LENGTH = 12


class SeekEmulation(EmulatorSettings):
    """Settings of the emulated camera; its faults strike frames, counted since it came to life."""

    model: Literal["compact", "compact_pro"] = "compact"
    shutter_every: int = Field(60, ge=2, description="a shutter frame comes after so many scenes")
    dead: int = Field(20, ge=0, le=500, description="dead pixels, besides the dots of its maker")
    counter_start: int = Field(0, ge=0, le=0xFFFF)
    left_running: bool = Field(False, description="another program did not put it to sleep")

    def serial_for(self, name: str) -> str:
        """At most 12 characters, as in its factory settings."""
        made = f"EMU{zlib.crc32(name.encode()):08X}"
        return (self.serial or made)[:_SERIAL_LENGTH]


class SeekDevice:
    """The logic: `thermacq.testing.emulation.usb.UsbDevice`."""

    def __init__(self, emulation: Emulation, settings: SeekEmulation, schedule: FaultSchedule) -> None:
        pid, self._columns, self._rows, self._part, self._type_word, self._counter_word, rate_hz = _MODELS[
            settings.model
        ]
        self._settings = settings
        self._serial = settings.serial_for(emulation.name)
        self.description = UsbDescription(
            VID,
            pid,
            self._serial,
            "PIR206 Thermal Camera",
            "Seek Thermal",
            (Interface(0, 0, (Endpoint(0x81),)),),
        )
        self._clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self._period_ns = round(self._clock.host_interval_ns(1 / rate_hz))
        self._schedule = schedule
        self.plug: UsbPlug | None = None
        _, _, rows, columns = self._part
        self._scene = ThermalScene(rows, columns, level=_LEVEL, span=1500)
        rng = np.random.default_rng(zlib.crc32(self._serial.encode()))
        self.pattern = rng.integers(-300, 300, (rows, columns)).astype(np.int64)
        # Live pixels lie around one value; the brightest stands further off than the darkest.
        self.gain = 2000 + np.clip(np.rint(rng.normal(0, 8, (rows, columns))), -40, 40).astype(np.int64)
        self.gain[rows // 2, columns // 2] = 2060
        self.dead = self._dead_pixels(rng, rows, columns)
        self._made = 0
        self._running_before = settings.left_running
        self._previous = b""

    def _dead_pixels(self, rng: np.random.Generator, rows: int, columns: int) -> NDArray[np.bool_]:
        """The maker's dots, each 15th pixel of a row, and some others."""
        raw_row, raw_column = np.mgrid[0:rows, 0:columns]
        dead: NDArray[np.bool_] = (raw_column - 10 + 4 * raw_row) % 15 == 0
        dead[0, :16] = False  # the pixels that hold the frame number stay alive
        places = rng.integers(16, rows * columns, self._settings.dead)
        dead.reshape(-1)[places] = True
        return dead

    def power_up(self) -> None:
        """Asleep, unless another program left it running."""
        self._awake = 1 if getattr(self, "_running_before", self._settings.left_running) else 0
        self._running_before = False
        self._platform = self._awake == 1
        self._since_start = 0
        self._address = (0, 0)
        self._outbox = b""
        self._due_ns = self._clock.host.now_ns()
        self._halted = False

    def control_out(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """Requests of the host; refused while it was left running, until it is put to sleep three times."""
        if request_type != 0x41 or value or index:
            raise UsbStall
        if request == 0x54:
            if self._awake:
                raise UsbStall
            self._platform = True
        elif request == 0x3C and len(data) == 2:
            self._awake = struct.unpack("<H", data)[0]
            self._since_start = 0
        elif request == 0x56 and len(data) == 6:
            count, address, _ = struct.unpack("<3H", data)
            self._address = (count, address)
        elif request == 0x53 and len(data) == 4:
            self._begin_frame(struct.unpack("<I", data)[0])
        elif request not in (0x3E, 0x55):
            raise UsbStall

    def control_in(self, request_type: int, request: int, _value: int, _index: int, length: int) -> bytes:
        """Answers: firmware, chip, mode, factory settings."""
        if request_type != 0xC1 or not self._platform:
            raise UsbStall
        if request == 0x3D:
            return struct.pack("<H", self._awake)[:length]
        if request == 0x58:
            count, address = self._address
            text = self._serial.encode().ljust(_SERIAL_LENGTH, b"\0")
            return (text if address == 8 else bytes(2 * count))[:length]
        answers = {0x4E: bytes.fromhex("01030000"), 0x36: bytes.fromhex("14000C005600F800C7004500")}
        if request not in answers:
            raise UsbStall
        return answers[request].ljust(length, b"\0")[:length]

    def _begin_frame(self, words: int) -> None:
        if not self._awake or words != self._rows * self._columns:
            raise UsbStall
        now_ns = self._clock.host.now_ns()
        # It goes on by its own rate; a late host gets the next frame, and the others are lost.
        missed = max(0, (now_ns - self._due_ns) // self._period_ns)
        self._due_ns += (missed + 1) * self._period_ns
        lost = missed if self._since_start > 1 else 0
        self._made += int(lost)
        self._outbox = b""
        faults = self._schedule.strike(self._made)
        kinds = {fault.kind: fault for fault in faults}
        if FaultKind.DROP in kinds:
            self._made += 1
        if FaultKind.COUNTER_JUMP in kinds:
            self._made += kinds[FaultKind.COUNTER_JUMP].amount
        data = self._previous if FaultKind.DUPLICATE in kinds and self._previous else self._frame()
        self._faults = [fault for fault in faults if fault.kind not in (FaultKind.DROP, FaultKind.DUPLICATE)]
        self._outbox = self._previous = data
        self._fresh = True

    def _frame(self) -> bytes:
        """The next frame: the first for dead pixels, then a shutter frame, then scenes with shutters between."""
        since, self._since_start = self._since_start, self._since_start + 1
        every = self._settings.shutter_every + 1
        kind = _FIRST if since == 0 else _SHUTTER if (since - 1) % every == 0 else _SCENE
        row, column, rows, columns = self._part
        if kind == _SCENE:
            picture = self._scene.picture(self._made).astype(np.int64) + self.pattern
        elif kind == _SHUTTER:
            picture = _LEVEL + self.pattern
        else:
            picture = self.gain
        words = np.zeros((self._rows, self._columns), "<u2")
        words[row : row + rows, column : column + columns] = np.where(self.dead, 0, picture)
        flat = words.reshape(-1)
        flat[self._type_word] = kind
        flat[self._counter_word] = (self._settings.counter_start + self._made) & 0xFFFF
        self._made += 1
        return words.tobytes()

    def bulk_in(self, endpoint: int, length: int, timeout_s: float, gone: Callable[[], bool]) -> bytes:
        """Part of the frame that was asked for, once its time has come."""
        if endpoint != 0x81 or self._halted:
            raise UsbStall
        if not self._outbox:
            time.sleep(min(timeout_s, 0.05))
            raise UsbTimeout
        wait_until(self._clock.host, self._due_ns - self._period_ns, gone)
        if self._fresh:
            self._fresh = False
            self._outbox = self._through_wire(self._outbox)
        piece, self._outbox = self._outbox[:length], self._outbox[length:]
        return piece

    def _through_wire(self, data: bytes) -> bytes:
        assert self.plug is not None
        for fault in self._faults:
            if fault.kind is FaultKind.BAD_CRC:
                # Without a checksum what can be noticed is an impossible type.
                words = np.frombuffer(data, "<u2").copy()
                words[self._type_word] = 0x5555
                data = words.tobytes()
        rest = [fault for fault in self._faults if fault.kind is not FaultKind.BAD_CRC]
        self._outbox = b""
        try:
            return through_wire(data, rest, self.plug)
        except UsbStall:
            self._halted = True
            raise

    def bulk_out(self, _endpoint: int, _data: bytes, _timeout_s: float) -> int:
        """It takes nothing."""
        raise UsbStall

    def clear_halt(self, _endpoint: int) -> None:
        """Go on."""
        self._halted = False

    def select(self, _interface: int, _alternate: int) -> None:
        """It has one alternate setting."""


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a camera to life on an emulated bus."""
    settings = SeekEmulation.model_validate(dict(emulation.settings))
    device = SeekDevice(emulation, settings, schedule_for(emulation, settings))
    device.plug = UsbPlug(device)
    yield EmulatedTransports(usb=[device.plug])


EMULATOR = Emulator(
    driver="seek",
    summary="Seek Compact or CompactPRO: initialisation, frame types, shutter frames, dead pixels",
    settings=lambda: SeekEmulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 6}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 6, "items": 1000}]},
        IncompleteFrame: {"faults": [{"kind": "short_read", "at": 6, "amount": 512}]},
    },
    driver_settings={"timeout_s": 1.0},
)
