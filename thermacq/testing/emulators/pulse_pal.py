"""Emulated Pulse Pal 2: the serial protocol of its firmware, and four outputs on a grid of 50 µs.

Played are monophasic and biphasic trains with delay, duration and continuous loop, started by software.
Custom trains and bursts are taken and acknowledged but not played; the trigger inputs are not wired. The
byte order and channel base of command 82 differ between the firmware (state, then channel from 0) and what
hosts send (channel from 1, then state); only its acknowledgement is emulated.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import Field, field_validator

from thermacq.errors import DeviceDisconnected
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import (
    EmulatorSettings,
    FaultKind,
    FaultSchedule,
    FaultSettings,
    schedule_for,
)
from thermacq.testing.emulation.pty import PtyPort
from thermacq.testing.emulation.timing import DeviceClock
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.clock import NS_PER_S
from thermacq.timing.trigger_line import LineWriter
from thermacq.transports import SerialNode, Transports

# Arduino Due, native port: the board inside a Pulse Pal 2.
VID, PID = 0x2341, 0x003E
CYCLES_PER_S = 20_000
# What a logic input takes for high.
_HIGH_V = 2.0
_MARK = 213
_CHANNELS = 4
_LARGEST_LEAD = 64
# How long a command waits, in virtual time, for followers that hold pulses back.
_FOLLOWERS_PATIENCE_S = 2.0
_FOLLOWERS_POLL_S = 0.001
_SETTINGS_BYTES = 178
# Bytes after mark and command; commands whose length follows from their content are handled apart.
_LENGTHS = {72: 0, 73: _SETTINGS_BYTES, 77: 1, 79: 3, 80: 0, 81: 0, 82: 2, 85: 0, 86: 2, 87: 1, 89: 6}
_TIMES = ["phase1", "interphase", "phase2", "interpulse", "burst", "interburst", "duration", "delay"]


class PulsePalEmulation(EmulatorSettings):
    """Settings of the emulated box: `faults` strike its answers, `pulse_faults` the pulses of its first line.

    Pulses know the faults ``drop``, ``duplicate`` (again after `seconds`), ``slow`` (late by `seconds`) and
    ``disconnect``.
    """

    lines: tuple[str, ...] = Field(
        ("trigger",), max_length=_CHANNELS, description="trigger line wired to each output; empty: none"
    )
    firmware: int = Field(21, ge=0, description="version that it reports")
    pulse_faults: tuple[FaultSettings, ...] = ()

    @field_validator("lines")
    @classmethod
    def _one_output_each(cls, lines: tuple[str, ...]) -> tuple[str, ...]:
        wired = [line for line in lines if line]
        if len(wired) != len(set(wired)):
            raise ValueError("a trigger line can be wired to one output only")
        return lines


@dataclass
class Output:
    """One output channel: its programme, and the train that it plays."""

    times: dict[str, int] = field(
        default_factory=lambda: dict(zip(_TIMES, (20, 20, 20, 200, 0, 0, 20_000, 0), strict=True))
    )
    volts: dict[str, float] = field(default_factory=lambda: {"phase1": 5.0, "phase2": -5.0, "rest": 0.0})
    biphasic: bool = False
    first_cycle: int | None = None
    pulse: int = 0

    def period(self) -> int:
        """Cycles from pulse to pulse."""
        times = self.times
        second = times["interphase"] + times["phase2"] if self.biphasic else 0
        return max(1, times["phase1"] + second + times["interpulse"])

    def next_cycle(self) -> int | None:
        """Cycle of the next pulse; None when nothing is played."""
        if self.first_cycle is None:
            return None
        return self.first_cycle + self.pulse * self.period()

    def is_over(self) -> bool:
        """Whether the train has ended before the next pulse."""
        return self.pulse * self.period() >= self.times["duration"]

    def seen(self) -> bool:
        """Whether a logic input sees its pulses."""
        return self.volts["phase1"] >= _HIGH_V > self.volts["rest"]


class PulsePalBox:
    """The logic of the box: `thermacq.testing.emulation.pty.SerialDevice`."""

    def __init__(self, emulation: Emulation, settings: PulsePalEmulation) -> None:
        self._settings = settings
        self._host = emulation.clock
        self._clock = DeviceClock(emulation.clock, settings.clock_ppm)
        log: Path = emulation.fault_log
        self._faults = FaultSchedule(settings.pulse_faults, emulation.clock, log)
        self._lines = [LineWriter(emulation.runtime_dir, name) if name else None for name in settings.lines]
        self._lines += [None] * (_CHANNELS - len(self._lines))
        self._pulses = 0
        self._last_ns = [-1] * _CHANNELS
        self.port: PtyPort | None = None
        self.outputs: list[Output] = []
        self.power_up()

    def power_up(self) -> None:
        """Start afresh with the programme of the factory."""
        self._abort()
        self._buffer = b""
        self.outputs = [Output() for _ in range(_CHANNELS)]

    def receive(self, data: bytes) -> Sequence[bytes]:
        """Carry out what has arrived in full; pulses that were due before are emitted first."""
        deadline_s = time.monotonic() + _FOLLOWERS_PATIENCE_S
        self._emit_due()
        while self._holds_pulses_back() and time.monotonic() < deadline_s:
            time.sleep(_FOLLOWERS_POLL_S)
            self._emit_due()
        self._buffer += data
        answers: list[bytes] = []
        while True:
            # Anything but the mark is not for this box.
            start = self._buffer.find(_MARK)
            self._buffer = self._buffer[start:] if start >= 0 else b""
            length = self._length()
            if length is None or len(self._buffer) < 2 + length:
                return answers
            command, content = self._buffer[1], self._buffer[2 : 2 + length]
            self._buffer = self._buffer[2 + length :]
            answer = self._obey(command, content)
            if answer:
                answers.append(answer)

    def _length(self) -> int | None:
        """Bytes after mark and command; None when too little has arrived to know."""
        if len(self._buffer) < 2:
            return None
        command, content = self._buffer[1], self._buffer[2:]
        if command == 74:
            return None if not content else 2 + _value_bytes(content[0])
        if command in (75, 76):
            return None if len(content) < 4 else 4 + 6 * int.from_bytes(content[:4], "little")
        if command == 78:
            return None if not content else 1 + content[0]
        return _LENGTHS.get(command, 0)

    def _obey(self, command: int, content: bytes) -> bytes:
        """Do what a command says and return the answer, empty for those that have none."""
        if command == 72:
            return b"K" + struct.pack("<I", self._settings.firmware)
        if command == 73:
            self._programme_all(content)
        elif command == 74:
            self._programme_one(content[0], content[1], int.from_bytes(content[2:], "little"))
        elif command == 77:
            self._start(content[0])
        elif command in (80, 81):
            self._abort()
        elif command == 85:
            return bytes(_SETTINGS_BYTES)
        elif command == 87:
            return b"\x00"
        return b"\x01" if command in (73, 74, 75, 76, 79, 82) else b""

    def _programme_all(self, content: bytes) -> None:
        words = struct.unpack("<32I12H16B8B2B", content)
        for channel, output in enumerate(self.outputs):
            # Each parameter for all channels, then the next one.
            output.times = {name: words[4 * place + channel] for place, name in enumerate(_TIMES)}
            output.volts = {
                name: _volts(words[32 + 4 * place + channel]) for place, name in enumerate(output.volts)
            }
            output.biphasic = bool(words[44 + channel])

    def _programme_one(self, parameter: int, channel: int, value: int) -> None:
        if not 1 <= channel <= _CHANNELS:
            return
        output = self.outputs[channel - 1]
        if parameter == 1:
            output.biphasic = bool(value)
        elif 4 <= parameter <= 11:
            output.times[_TIMES[parameter - 4]] = value
        elif parameter in (2, 3, 17):
            output.volts[{2: "phase1", 3: "phase2", 17: "rest"}[parameter]] = _volts(value)

    def _start(self, bits: int) -> None:
        """Trains begin with the next cycle; one that plays already goes on."""
        now_cycle = self._clock.ticks(self._host.now_ns(), CYCLES_PER_S)
        for channel, output in enumerate(self.outputs):
            if bits >> channel & 1 and output.first_cycle is None:
                output.first_cycle, output.pulse = now_cycle + 1 + output.times["delay"], 0
                line = self._lines[channel]
                if line is not None:
                    line.start_session()

    def _abort(self) -> None:
        for channel in range(len(self.outputs)):
            self._end(channel)

    def _end(self, channel: int) -> None:
        line = self._lines[channel]
        if self.outputs[channel].first_cycle is not None and line is not None:
            line.finish_session()
        self.outputs[channel].first_cycle = None

    def let_go(self) -> None:
        """End all trains and let go of the lines."""
        self._abort()
        self._lines = [None] * _CHANNELS
        self.port = None

    def due_ns(self) -> int | None:
        """Host time of the next pulse of any output."""
        cycles = [cycle for output in self.outputs if (cycle := output.next_cycle()) is not None]
        return self._clock.host_ns(min(cycles), CYCLES_PER_S) if cycles else None

    def act(self) -> Sequence[bytes]:
        """Emit what is due; the box says nothing unasked."""
        self._emit_due()
        return ()

    def _emit_due(self) -> None:
        now_ns = self._host.now_ns()
        for channel, output in enumerate(self.outputs):
            while (cycle := output.next_cycle()) is not None:
                due_ns = self._clock.host_ns(cycle, CYCLES_PER_S)
                if due_ns > now_ns or self._is_far_ahead(channel):
                    break
                if output.is_over():
                    self._end(channel)
                    break
                output.pulse += 1
                line = self._lines[channel]
                if line is not None and output.seen():
                    self._emit(channel, line, due_ns)

    def _holds_pulses_back(self) -> bool:
        """Whether pulses that are due wait for slow followers, in virtual time."""
        due_ns = self.due_ns()
        return self._host.is_virtual and due_ns is not None and due_ns <= self._host.now_ns()

    def _is_far_ahead(self, channel: int) -> bool:
        """In virtual time the box waits when its slowest follower is many pulses behind."""
        line = self._lines[channel]
        return self._host.is_virtual and line is not None and line.lead() >= _LARGEST_LEAD

    def _emit(self, channel: int, line: LineWriter, due_ns: int) -> None:
        """Put a pulse on the wire, as the faults leave it; times on a line never go back."""
        times = [due_ns]
        for fault in self._strike(channel):
            if fault.kind is FaultKind.DROP:
                times = []
            elif fault.kind is FaultKind.DUPLICATE:
                times = [*times, due_ns + round(fault.seconds * NS_PER_S)]
            elif fault.kind is FaultKind.SLOW:
                times = [time_ns + round(fault.seconds * NS_PER_S) for time_ns in times]
            elif fault.kind is FaultKind.DISCONNECT and self.port is not None:
                self.port.unplug(fault.seconds)
                self._abort()
                times = []
        for time_ns in times:
            self._last_ns[channel] = max(time_ns, self._last_ns[channel] + 1)
            line.emit(self._last_ns[channel])

    def _strike(self, channel: int) -> list[FaultSettings]:
        if any(self._lines[:channel]):
            return []
        self._pulses += 1
        return self._faults.strike(self._pulses - 1)


def _value_bytes(parameter: int) -> int:
    """Length of the value of a parameter: times are 4 bytes, voltages 2, switches 1."""
    if 4 <= parameter <= 11:
        return 4
    return 2 if parameter in (2, 3, 17) else 1


def _volts(code: int) -> float:
    return code / 65535 * 20 - 10


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a box to life behind a pseudo-terminal."""
    settings = PulsePalEmulation.model_validate(dict(emulation.settings))
    box = PulsePalBox(emulation, settings)
    node = SerialNode("", VID, PID, settings.serial_for(emulation.name), "Arduino Due")
    schedule = schedule_for(emulation, settings)
    with PtyPort(box, node, emulation.clock, schedule, drives_time=False) as port:
        box.port = port
        yield EmulatedTransports(serial=[port])
    box.let_go()


EMULATOR = Emulator(
    driver="pulse_pal",
    summary="Pulse Pal 2: serial protocol, four outputs on a 50 µs grid, lost, late and doubled pulses",
    settings=lambda: PulsePalEmulation,
    attach=attach,
    faults={DeviceDisconnected: {"pulse_faults": [{"kind": "disconnect", "at": 3}]}},
)
