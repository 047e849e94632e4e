"""Emulated Thermal Master P3 and P1: commands, start sequence, frames between markers, shutter."""

from __future__ import annotations

import struct
import time
from binascii import crc_hqx
from collections import deque
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
from thermacq.testing.emulation.timing import DeviceClock, FreeRun
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

VID = 0x3474
# name: (pid, columns, rows)
_MODELS = {"P3": (0x45A2, 256, 192), "P1": (0x45C2, 160, 120)}
_RATE_HZ = 25.0
_PARTIAL_BYTES = 9204
_LARGEST_TRANSFER = 204_800
_DONE_WRITING, _DONE_READING, _BUSY = b"\x02", b"\x03", b"\x01"
_AMBIENT = round(64 * 293.15)


class P3Emulation(EmulatorSettings):
    """Settings of the emulated camera; its faults strike frames, counted since it came to life."""

    model: Literal["P3", "P1"] = "P3"
    serial_on_usb: bool = Field(True, description="its USB descriptor holds the serial number")
    counter_start: int = Field(0, ge=0, le=255, description="frames that it counted before")
    busy_polls: int = Field(0, ge=0, le=1000, description="how often its status says busy after a command")
    shutter_every_s: float = Field(90.0, gt=0, description="it closes its shutter by itself so often")
    shutter_s: float = Field(0.4, ge=0, le=10, description="the picture stands still for so long")


class P3Device:
    """The logic: `thermacq.testing.emulation.usb.UsbDevice`."""

    def __init__(self, emulation: Emulation, settings: P3Emulation, schedule: FaultSchedule) -> None:
        pid, self._columns, self._rows = _MODELS[settings.model]
        self._settings = settings
        self._serial = settings.serial_for(emulation.name)
        self.description = UsbDescription(
            VID,
            pid,
            self._serial if settings.serial_on_usb else "",
            f"{settings.model} camera",
            "Thermal Master",
            (Interface(0), Interface(1), Interface(1, 1, (Endpoint(0x81),))),
        )
        self._clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self._schedule = schedule
        self._scene = ThermalScene(self._rows, self._columns, level=_AMBIENT, span=640)
        self.plug: UsbPlug | None = None
        self.commands: list[bytes] = []
        self._stream: FreeRun | None = None
        self._outbox: deque[bytes] = deque()
        # Frames made before the stream that runs now: the camera counts on.
        self._made = self._next = settings.counter_start
        self._next_shutter_s = settings.shutter_every_s

    def power_up(self) -> None:
        """Nothing streams."""
        self._answer = b""
        self._status = _DONE_READING
        self._busy = 0
        self._alternate = 0
        self._ready = self._halted = False
        self._end_stream()
        self._after_shutter = False
        self._still = self._still_until = -1
        self._silent_until = -1

    def control_out(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """A command, or the order to stream."""
        if (request_type, request, value, index) == (0x41, 0x20, 0, 0) and len(data) == 18:
            self._take(data)
        elif (request_type, request, value, index) == (0x40, 0xEE, 0, 1) and self._ready and self._alternate:
            self._stream = FreeRun(self._clock, _RATE_HZ)
        else:
            raise UsbStall

    def _take(self, data: bytes) -> None:
        """Stricter than the camera, which does not look at the CRC."""
        kind, parameter, register, _, _, _, length, _, crc = struct.unpack("<9H", data)
        if crc != crc_hqx(data[:16], 0):
            raise UsbStall
        self.commands.append(data)
        self._busy, self._status, self._answer = self._settings.busy_polls, _DONE_WRITING, b""
        texts = {
            1: self._settings.model,
            2: "00.00.02.17",
            7: self._serial,
            6: "part",
            0x0A: "hardware",
            0x0F: "long model",
        }
        if (kind, parameter) == (0x0101, 0x81) and register in texts:
            self._answer = texts[register].encode().ljust(length, b"\0")[:length]
        elif (kind, parameter) == (0x2F01, 0x81):
            self._answer = b"\x35" if self._ready else b"\x01"
            self._ready = True
        elif (kind, parameter) == (0x3601, 0x43):
            self._after_shutter = True
        elif (kind, parameter) != (0x2F01, 0x41):
            raise UsbStall

    def control_in(
        self,
        request_type: int,
        request: int,
        value: int,  # noqa: ARG002
        index: int,  # noqa: ARG002
        length: int,
    ) -> bytes:
        """The status, or the answer to the last command."""
        if (request_type, request) == (0xC1, 0x22):
            if self._busy:
                self._busy -= 1
                return _BUSY
            return self._status
        if (request_type, request) != (0xC1, 0x21) or self._busy:
            raise UsbStall
        self._status = _DONE_READING
        return self._answer[:length]

    def bulk_in(self, endpoint: int, length: int, timeout_s: float, gone: Callable[[], bool]) -> bytes:
        """What there is of the transfer under way, else of the next one."""
        if endpoint != 0x81 or not self._alternate or self._halted:
            raise UsbStall
        if not self._outbox:
            if self._stream is None:
                time.sleep(min(timeout_s, 0.05))
                raise UsbTimeout
            exposure = self._stream.next(timeout_s, gone)
            if exposure is None:
                raise UsbTimeout
            self._make(exposure.number)
        if not self._outbox:
            raise UsbTimeout
        transfer = self._outbox.popleft()
        if len(transfer) > length:
            self._outbox.appendleft(transfer[length:])
        return transfer[:length]

    def _make(self, exposed: int) -> None:
        """Make a frame and put its transfers in the outbox."""
        number = self._made + exposed
        faults = self._schedule.strike(number - self._settings.counter_start)
        kinds = {fault.kind: fault for fault in faults}
        if FaultKind.COUNTER_JUMP in kinds:
            self._made += kinds[FaultKind.COUNTER_JUMP].amount
            number = self._made + exposed
        self._next = number + 1
        if FaultKind.SHUTTER_FREEZE in kinds:
            self._hold_still(number, kinds[FaultKind.SHUTTER_FREEZE].seconds)
        elif number / _RATE_HZ >= self._next_shutter_s:
            self._next_shutter_s = number / _RATE_HZ + self._settings.shutter_every_s
            self._hold_still(number, self._settings.shutter_s)
        if FaultKind.TIMEOUT in kinds:
            self._silent_until = number + 1 + round(kinds[FaultKind.TIMEOUT].seconds * _RATE_HZ)
        if FaultKind.DROP in kinds or number < self._silent_until:
            return
        pictured, end = self._transfers(number)
        if FaultKind.BAD_CRC in kinds:
            end = end[:2] + bytes([end[2] ^ 0x55]) + end[3:]
        pictured = self._through_wire(pictured, faults)
        self._outbox.extend(self._irregular(pictured, end) if self._after_shutter else (pictured, end))
        if FaultKind.DUPLICATE in kinds:
            self._outbox.extend((pictured, end))
        self._after_shutter = False

    def _hold_still(self, number: int, seconds: float) -> None:
        self._still, self._still_until = number, number + round(seconds * _RATE_HZ)

    def _transfers(self, number: int) -> tuple[bytes, bytes]:
        shown = self._still if number < self._still_until else number
        picture = self._scene.picture(shown)
        eight_bits = (picture >> 4) & 0xFF
        metadata = np.zeros((2, self._columns), np.uint16)
        pixels = np.concatenate((eight_bits, metadata, picture)).astype("<u2").tobytes()
        # cnt1 and cnt2 mean nothing that is known; they go on from frame to frame.
        cnt1 = (601_097 + 40_000 * number) % 2**32
        sync, begins, ends = number & 1, 40 * number % 2048, 40 * (number + 1) % 2048
        start = struct.pack("<BBIIH", 12, 0x8C | sync, cnt1, (cnt1 + 7) % 2**32, begins)
        end = struct.pack("<BBIIH", 12, 0x8E | sync, cnt1, (cnt1 + 39_000) % 2**32, ends)
        return start + pixels, end

    def _irregular(self, pictured: bytes, end: bytes) -> tuple[bytes, ...]:
        """The first frame after a shutter command: a partial frame before it, other transfers, its end twice."""
        stream = pictured[-_PARTIAL_BYTES:] + pictured + end
        return stream[:_LARGEST_TRANSFER], stream[_LARGEST_TRANSFER:], end

    def _through_wire(self, data: bytes, faults: list[FaultSettings]) -> bytes:
        assert self.plug is not None
        made_here = (FaultKind.BAD_CRC, FaultKind.DUPLICATE)
        try:
            return through_wire(data, [fault for fault in faults if fault.kind not in made_here], self.plug)
        except UsbStall:
            self._halted = True
            raise

    def bulk_out(self, endpoint: int, data: bytes, timeout_s: float) -> int:  # noqa: ARG002
        """It takes nothing."""
        raise UsbStall

    def clear_halt(self, endpoint: int) -> None:  # noqa: ARG002
        """Go on."""
        self._halted = False

    def select(self, interface: int, alternate: int) -> None:
        """Interface 1 streams in its alternate setting 1 only."""
        if interface == 1:
            self._alternate = alternate
            if not alternate:
                self._end_stream()

    def _end_stream(self) -> None:
        self._stream = None
        self._outbox.clear()
        self._made = self._next


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a camera to life on an emulated bus."""
    settings = P3Emulation.model_validate(dict(emulation.settings))
    device = P3Device(emulation, settings, schedule_for(emulation, settings))
    device.plug = UsbPlug(device)
    yield EmulatedTransports(usb=[device.plug])


EMULATOR = Emulator(
    driver="p3",
    summary="Thermal Master P3 or P1: start sequence, markers and counters, shutter, irregular first frame",
    settings=lambda: P3Emulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 6}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 6, "items": 1000}]},
        IncompleteFrame: {"faults": [{"kind": "short_read", "at": 6, "amount": 512}]},
    },
    driver_settings={"settle_s": 0.02, "stream_settle_s": 0.05, "timeout_s": 1.0},
)
