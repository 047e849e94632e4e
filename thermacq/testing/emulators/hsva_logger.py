"""Emulated Arduino wave-gauge logger of the HSVA tank: waits for its trigger, then sends records at 200 Hz."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from pydantic import Field

from thermacq.errors import DeviceDisconnected, DeviceTimeout
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import EmulatorSettings, FaultKind, FaultSchedule, schedule_for
from thermacq.testing.emulation.pty import PtyPort
from thermacq.testing.emulation.timing import DeviceClock
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.trigger_line import LineReader
from thermacq.transports import SerialNode, Transports

# Arduino Mega 2560.
VID, PID = 0x2341, 0x0042
_WAITING_RATE_HZ = 200.0
_CHANNEL_DELAY_US = 112
_TRIGGER_CHECK_S = 0.05
_WAVE_HZ = 0.5


class HsvaEmulation(EmulatorSettings):
    """Settings of the emulated logger; faults of the wire strike messages (signs of waiting and records)."""

    channels: int = Field(4, ge=1, le=15)
    rate_hz: float = Field(200.0, gt=0, le=1000)
    line: str = Field("", description="trigger line at its input A15; empty: it starts at once")
    first_number: int = Field(1, ge=0, lt=2**32, description="number of the first record")
    first_us: int = Field(5000, ge=0, lt=2**32, description="time of the first record")
    log_for_s: float = Field(800.0, gt=0, description="then it stops and waits for its trigger again")


class Logger:
    """The logic: `thermacq.testing.emulation.pty.SerialDevice`."""

    def __init__(self, emulation: Emulation, settings: HsvaEmulation, schedule: FaultSchedule) -> None:
        self._settings = settings
        self._host = emulation.clock
        self._faults = schedule
        self._clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self._line = LineReader(emulation.runtime_dir, settings.line) if settings.line else None
        self.power_up()

    def power_up(self) -> None:
        """Wait for the trigger."""
        self._started_ns: int | None = None if self._line else self._host.now_ns()
        self._waits = self._clock.ticks(self._host.now_ns(), _WAITING_RATE_HZ)
        self._scan = 0

    def receive(self, _data: bytes) -> Sequence[bytes]:
        """It listens to nothing."""
        return ()

    def due_ns(self) -> int | None:
        """Next record, or next sign of waiting."""
        if self._started_ns is None:
            return self._clock.host_ns(self._waits + 1, _WAITING_RATE_HZ)
        return self._started_ns + round(
            self._clock.host_interval_ns((self._scan + 1) / self._settings.rate_hz)
        )

    def act(self) -> Sequence[bytes]:
        """Say what is due."""
        if self._started_ns is None:
            self._waits += 1
            self._look_at_trigger()
            return [b"W"]
        if self._scan / self._settings.rate_hz >= self._settings.log_for_s:
            self._started_ns = None
            self._waits = self._clock.ticks(self._host.now_ns(), _WAITING_RATE_HZ)
            return [b"W" * 500]
        self._scan += 1
        kinds = {fault.kind for fault in self._faults.strike(self._scan, FaultKind.COUNTER_JUMP)}
        self._scan += 3 if FaultKind.COUNTER_JUMP in kinds else 0
        return [self._record()]

    def _look_at_trigger(self) -> None:
        if self._line is not None and self._line.waiting:
            _, pulse_ns = self._line.take()
            self._started_ns = pulse_ns + round(self._clock.host_interval_ns(_TRIGGER_CHECK_S))
            self._scan = 0

    def _record(self) -> bytes:
        settings, count = self._settings, self._settings.channels
        step_us = (self._scan - 1) / settings.rate_hz * 1e6
        times = [(settings.first_us + round(step_us) + _CHANNEL_DELAY_US * c) % 2**32 for c in range(count)]
        wave = math.sin(2 * math.pi * _WAVE_HZ * step_us * 1e-6)
        values = [512 + 10 * channel + round(100 * wave) for channel in range(count)]
        number = (settings.first_number + self._scan - 1) % 2**32
        return b"S" + struct.pack(f"<{count}I{count}hIB", *times, *values, number, 4) + b"E"

    def let_go(self) -> None:
        """Let go of the trigger line."""
        if self._line is not None:
            self._line.close()


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a logger to life behind a pseudo-terminal."""
    settings = HsvaEmulation.model_validate(dict(emulation.settings))
    schedule = schedule_for(emulation, settings)
    logger = Logger(emulation, settings, schedule)
    node = SerialNode("", VID, PID, settings.serial_for(emulation.name), "Arduino Mega 2560")
    with PtyPort(logger, node, emulation.clock, schedule) as port:
        yield EmulatedTransports(serial=[port])
    logger.let_go()


EMULATOR = Emulator(
    driver="hsva_logger",
    summary="Arduino wave-gauge logger: trigger input, records without checksum, lost and damaged ones",
    settings=lambda: HsvaEmulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 100}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 100, "seconds": 20}]},
    },
)
