"""Emulated LabJack U6 and U6-Pro: its commands, calibration memory, and a stream by its own clock.

Analogue inputs see a sine each, FIO and EIO the trigger line of the recording. What the device keeps for a
late host is limited; then it drops scans and reports how many. That it keeps whole packets of whole scans, so
that the dropped ones lie just before the reporting packet, is assumed.
"""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from thermacq.errors import DeviceDisconnected, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import (
    EmulatorSettings,
    FaultKind,
    FaultSchedule,
    FaultSettings,
    schedule_for,
)
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
from thermacq.testing.emulators.labjack_u6_stream import Stream, framed, sum8
from thermacq.timing.clock import NS_PER_S
from thermacq.timing.trigger_line import LineReader
from thermacq.transports import Transports

VID, PID = 0x0CD5, 0x0006
_RANGES = (1, 10, 100, 1000)
_DIGITAL = 193
_LINE_PATIENCE_S = 5.0
_POLL_S = 0.0005


class U6Emulation(EmulatorSettings):
    """Settings of the emulated device; its faults strike packets of the stream, counted since it came to life.

    ``slow`` lets the host be late by `seconds`: the device then drops what it cannot keep.
    """

    serial: str = Field("", pattern=r"^\d*$", description="serial number; empty: made from its name")
    pro: bool = Field(False, description="a U6-Pro")
    amplitude_v: float = Field(1.0, ge=0, le=10, description="of the sine at each input")
    wave_hz: float = Field(0.5, gt=0, le=1000)
    offset_v: float = Field(0.1, ge=-10, le=10, description="AINn stands this much times n above 0 V")
    blank_calibration: bool = Field(False, description="its calibration memory was never written")
    line: str = Field("", pattern=r"^[\w-]*$", description="trigger line that it sees; empty: none")
    line_input: int = Field(0, ge=0, le=15, description="input that the line is wired to: 0-7 FIO, 8-15 EIO")
    pulse_width_s: float = Field(0.005, gt=0, le=1)
    line_lag_s: float = Field(
        0.05, ge=0, le=1, description="in real time it sends this late, for pulses that the host tells late"
    )
    kept_samples: int = Field(984, ge=100, le=100_000, description="what it keeps for a late host")
    left_running: bool = Field(False, description="another program left its stream running")

    def serial_for(self, name: str) -> str:
        """A number of nine digits."""
        return self.serial or str(360_000_000 + zlib.crc32(name.encode()) % 10_000_000)


class U6Device:
    """The logic: `thermacq.testing.emulation.usb.UsbDevice`."""

    def __init__(self, emulation: Emulation, settings: U6Emulation, schedule: FaultSchedule) -> None:
        self._settings = settings
        self._serial = int(settings.serial_for(emulation.name))
        self.description = UsbDescription(
            VID,
            PID,
            "",
            "LabJack U6",
            "LabJack Corporation",
            (Interface(0, 0, (Endpoint(0x01, packet_bytes=64), Endpoint(0x82), Endpoint(0x83))),),
        )
        self._clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self._line = LineReader(emulation.runtime_dir, settings.line) if settings.line else None
        self._pulses_ns: list[int] = []
        self._schedule = schedule
        self._struck = 0
        self.plug: UsbPlug | None = None
        # Constants as they leave the factory: near the nominal ones, different for each gain.
        self.slope = [3.1580578e-4 / gain * (1 + 2e-3 * place) for place, gain in enumerate(_RANGES, 1)]
        self.negative = [-3.158058e-4 / gain * (1 - 1e-3 * place) for place, gain in enumerate(_RANGES, 1)]
        self.centre = [33523.0 + 7.25 * place for place in range(1, 5)]
        self._left_running = settings.left_running

    def power_up(self) -> None:
        """No stream runs, unless another program left one."""
        self._offset_ns = 0
        self._replies: list[bytes] = []
        self._stream: Stream | None = None
        self._running = False
        self._halted = False
        self._held: list[FaultSettings] = []
        if self._left_running:
            self._left_running = False
            left = framed(0xF8, 5, 0x11, bytes([1, 0, 25, 0, 0, 8, 0x80, 0xBB, 0, 0]))
            self._stream = Stream(left)
            self._start()

    # Commands

    def bulk_out(self, endpoint: int, data: bytes, _timeout_s: float) -> int:
        """Take a command and prepare its answer."""
        if endpoint != 0x01:
            raise UsbStall
        if data[:2] == b"\xa8\xa8":
            self._replies.append(self._short(0xA9, self._start()))
        elif data[:2] == b"\xb0\xb0":
            self._replies.append(self._short(0xB1, 0 if self._running else 52))
            self._running = False
        elif len(data) >= 6 and data == framed(0xF8, (len(data) - 6) // 2, data[3], data[6:]):
            self._replies.append(self._extended(data))
        else:
            self._replies.append(b"\xb8\xb8")  # bad checksum
        return len(data)

    def _short(self, kind: int, error: int) -> bytes:
        body = bytes([kind, error, 0])
        return bytes([sum8(body)]) + body

    def _extended(self, data: bytes) -> bytes:
        number = data[3]
        if number == 0x08:
            said = struct.pack("<BBBBBBBBBI", 0, 0, 0, 45, 1, 15, 6, 0, 2, self._serial)
            body = said + bytes([6, 0, 1]) + bytes(15) + bytes([12 if self._settings.pro else 4])
            return framed(0xF8, 0x10, number, body)
        if number == 0x2D and len(data) == 8:
            return framed(0xF8, 0x11, number, bytes(2) + self._memory(data[7]))
        if number == 0x11:
            return framed(0xF8, 1, number, bytes([self._configure(data), 0]))
        return framed(0xF8, 1, number, b"\x05\x00")  # unknown command

    def _memory(self, block: int) -> bytes:
        if self._settings.blank_calibration or block > 3:
            return b"\xff" * 32
        first, second = (0, 1) if block % 2 == 0 else (2, 3)
        if block < 2:
            numbers = [self.slope[first], -10.5 / _RANGES[first], self.slope[second], -10.5 / _RANGES[second]]
        else:
            numbers = [self.negative[first], self.centre[first], self.negative[second], self.centre[second]]
        return struct.pack("<4q", *(round(number * 2**32) for number in numbers))

    def _configure(self, data: bytes) -> int:
        if self._running:
            return 48
        if len(data) != 14 + 2 * data[6] or not 1 <= data[8] <= 25:
            return 50
        stream = Stream(data)
        if stream.rate_hz * len(stream.inputs) > 50_100:
            return 58
        self._stream = stream
        return 0

    def _start(self) -> int:
        if self._running:
            return 48
        if self._stream is None:
            return 50
        self._stream.restart()
        self._offset_ns = self._clock.host.now_ns() - self._clock.start_ns
        self._running = True
        return 0

    # Stream

    def bulk_in(self, endpoint: int, length: int, timeout_s: float, gone: Callable[[], bool]) -> bytes:
        """An answer, or packets of the stream."""
        if endpoint == 0x82 and self._replies:
            return self._replies.pop(0)[:length]
        if endpoint == 0x83 and self._halted:
            raise UsbStall
        stream = self._stream
        if endpoint != 0x83 or stream is None or not self._running:
            time.sleep(min(timeout_s, 0.01))
            raise UsbTimeout
        # A packet that is not full ends the transfer.
        wanted = max(1, length // 64) if stream.per_packet == 25 else 1
        host = self._clock.host
        if not stream.kept and self._backlog(stream) > self._settings.kept_samples:
            stream.overflow(self._settings.kept_samples)
        if not stream.kept:
            due_ns = self._scan_ns(stream.scans_needed(wanted) - 1) + self._lag_ns()
            wait_until(host, min(due_ns, host.now_ns() + round(timeout_s * NS_PER_S)), gone)
        return self._send(stream, wanted)

    def _send(self, stream: Stream, wanted: int) -> bytes:
        """Up to so many packets that are ready; a packet that a fault strikes goes alone."""
        data = b""
        for _ in range(wanted):
            ready = stream.kept > 0 or self._taken() >= stream.scans_needed()
            if not ready and not self._held:
                break
            faults = self._held or self._schedule.strike(self._struck)
            if faults and data:
                self._held = faults
                break
            self._held = []
            self._struck += 1
            data += self._through_wire(self._packet(stream), faults)
            if faults:
                break
        if not data:
            raise UsbTimeout
        return data

    def _through_wire(self, packet: bytes, faults: list[FaultSettings]) -> bytes:
        assert self.plug is not None
        for fault in faults:
            if fault.kind is FaultKind.SLOW:
                host = self._clock.host
                wait_until(host, host.now_ns() + round(fault.seconds * NS_PER_S))
        try:
            return through_wire(packet, [one for one in faults if one.kind is not FaultKind.SLOW], self.plug)
        except UsbStall:
            self._halted = True
            raise

    def _packet(self, stream: Stream) -> bytes:
        """The next packet."""
        error = 59 if stream.kept else 60 if stream.report else 0
        width = len(stream.inputs)
        first, last = stream.sent, stream.sent + stream.per_packet
        scans = np.arange(first // width, -(-last // width)) + stream.dropped
        codes = self._codes(stream, scans).reshape(-1)
        skipped = first % width
        body = (stream.report if error == 60 else 0).to_bytes(4, "little")
        body += bytes([stream.packets % 256, error])
        body += codes[skipped : skipped + stream.per_packet].astype("<u2").tobytes()
        body += bytes([min(255, self._backlog(stream) * 2 // 64), 0])
        stream.packets += 1
        stream.sent = last
        stream.report = 0 if error == 60 else stream.report
        if stream.kept:
            stream.kept -= stream.per_packet
            if not stream.kept:
                stream.resume(self._taken())
        return framed(0xF9, 4 + stream.per_packet, 0xC0, body)

    def _codes(self, stream: Stream, scans: NDArray[np.int64]) -> NDArray[np.int64]:
        """Codes (scans, inputs) as sampled."""
        since_s = scans / stream.rate_hz
        columns = [
            self._line_codes(scans)
            if number == _DIGITAL
            else self._analogue(number, option >> 4 & 3, since_s)
            for number, option in stream.inputs
        ]
        return np.stack(columns, axis=1)

    def _analogue(self, number: int, gain: int, since_s: NDArray[np.float64]) -> NDArray[np.int64]:
        settings = self._settings
        volts = settings.offset_v * number + settings.amplitude_v * np.sin(
            2 * np.pi * settings.wave_hz * since_s
        )
        slope = np.where(volts < 0, -self.negative[gain], self.slope[gain])
        return np.clip(np.rint(self.centre[gain] + volts / slope), 0, 65535).astype(np.int64)

    def _line_codes(self, scans: NDArray[np.int64]) -> NDArray[np.int64]:
        """FIO and EIO: inputs that nothing is wired to are pulled up."""
        at_ns = np.array([self._scan_ns(int(scan)) for scan in scans])
        if self._line is None:
            return np.full(scans.size, 0xFFFF)
        self._hear_line(int(at_ns[-1]))
        pulses = np.array(self._pulses_ns, np.int64)
        width_ns = round(self._settings.pulse_width_s * NS_PER_S)
        before = np.searchsorted(pulses, at_ns, "right") - 1
        high = np.zeros(scans.size, bool)
        known = before >= 0
        high[known] = at_ns[known] - pulses[before[known]] < width_ns
        return np.where(high, 0xFFFF, 0xFFFF ^ 1 << self._settings.line_input)

    def _hear_line(self, end_ns: int) -> None:
        """Take the pulses up to a time; in virtual time their source may be behind, and is waited for."""
        line = self._line
        assert line is not None
        deadline_s = time.monotonic() + _LINE_PATIENCE_S
        while True:
            while line.waiting and line.peek_ns() <= end_ns:
                self._pulses_ns = [*self._pulses_ns[-9:], line.take()[1]]
            if line.waiting or line.finished or not self._clock.host.is_virtual:
                return
            if time.monotonic() > deadline_s:
                return
            time.sleep(_POLL_S)

    def _lag_ns(self) -> int:
        wired = self._line is not None and not self._clock.host.is_virtual
        return round(self._settings.line_lag_s * NS_PER_S) if wired else 0

    def _scan_ns(self, scan: int) -> int:
        """Host time of a scan."""
        assert self._stream is not None
        since_ns = self._clock.host_interval_ns(scan / self._stream.rate_hz)
        return self._clock.start_ns + self._offset_ns + round(since_ns)

    def _taken(self) -> int:
        """Scans taken by now."""
        assert self._stream is not None
        since_ns = self._clock.host.now_ns() - self._lag_ns() - self._clock.start_ns - self._offset_ns
        # A nanosecond more: the scan that was waited for is taken.
        return int((since_ns + 1) / self._clock.host_interval_ns(1 / self._stream.rate_hz)) + 1

    def _backlog(self, stream: Stream) -> int:
        """Samples taken and not yet sent."""
        return (self._taken() - stream.dropped) * len(stream.inputs) - stream.sent

    def control_in(self, _type: int, _request: int, _value: int, _index: int, _length: int) -> bytes:
        """It has no control requests of its own."""
        raise UsbStall

    def control_out(self, _type: int, _request: int, _value: int, _index: int, _data: bytes) -> None:
        """It has no control requests of its own."""
        raise UsbStall

    def clear_halt(self, _endpoint: int) -> None:
        """Go on."""
        self._halted = False

    def select(self, _interface: int, _alternate: int) -> None:
        """It has one alternate setting."""

    def let_go(self) -> None:
        """Let go of the trigger line."""
        if self._line is not None:
            self._line.close()


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a device to life on an emulated bus."""
    settings = U6Emulation.model_validate(dict(emulation.settings))
    device = U6Device(emulation, settings, schedule_for(emulation, settings))
    device.plug = UsbPlug(device)
    yield EmulatedTransports(usb=[device.plug])
    device.let_go()


EMULATOR = Emulator(
    driver="labjack_u6",
    summary="LabJack U6: commands, calibration memory, stream with auto-recovery, trigger line",
    settings=lambda: U6Emulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 10}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 10, "items": 100_000}]},
        IncompleteFrame: {"faults": [{"kind": "bad_crc", "at": 10}]},
        DeviceOverrun: {"faults": [{"kind": "slow", "at": 10, "seconds": 1.5}]},
    },
)
