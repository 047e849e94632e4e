"""Emulated probe that prints numbers: water that goes up and down, as lines of text on a serial port."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from pydantic import Field

from thermacq.errors import DeviceDisconnected, DeviceTimeout
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import EmulatorSettings, schedule_for
from thermacq.testing.emulation.pty import PtyPort
from thermacq.testing.emulation.timing import DeviceClock
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.transports import SerialNode, Transports

# A common USB adapter (FTDI FT232R).
VID, PID = 0x0403, 0x6001
_WAVE_HZ = 0.5


class PrintingProbeEmulation(EmulatorSettings):
    """Settings of the emulated probe; its faults strike lines."""

    line: str = Field("R{:04.0f}\r", description="format of a line, with the place of the number")
    rate_hz: float = Field(6.0, gt=0, le=1000, description="lines per second")
    mean: float = Field(1500.0, description="printed value of still water")
    amplitude: float = Field(50.0, ge=0, description="printed amplitude of its waves")
    ask: str = Field("", description="prints one line when it reads this; empty: prints by itself")


class PrintingProbe:
    """The logic: `thermacq.testing.emulation.pty.SerialDevice`."""

    def __init__(self, emulation: Emulation, settings: PrintingProbeEmulation) -> None:
        self._settings = settings
        self._host = emulation.clock
        self._clock = DeviceClock(emulation.clock, settings.clock_ppm)
        self.power_up()

    def power_up(self) -> None:
        """Print from now on."""
        self._next = self._clock.ticks(self._host.now_ns(), self._settings.rate_hz) + 1
        self._heard = b""

    def receive(self, data: bytes) -> Sequence[bytes]:
        """Answer each question with a line."""
        ask = self._settings.ask.encode()
        if not ask:
            return ()
        *questions, self._heard = (self._heard + data).split(ask)
        self._heard = self._heard[-len(ask) :]
        return [self._print(self._host.now_ns()) for _ in questions]

    def due_ns(self) -> int | None:
        """When the next line is due."""
        return None if self._settings.ask else self._clock.host_ns(self._next, self._settings.rate_hz)

    def act(self) -> Sequence[bytes]:
        """Print the line that is due."""
        due_ns = self._clock.host_ns(self._next, self._settings.rate_hz)
        self._next += 1
        return [self._print(due_ns)]

    def _print(self, host_ns: int) -> bytes:
        seconds = (host_ns - self._clock.start_ns) / 1e9
        value = self._settings.mean + self._settings.amplitude * math.sin(2 * math.pi * _WAVE_HZ * seconds)
        return self._settings.line.format(value).encode("ascii")


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a printing probe to life behind a pseudo-terminal."""
    settings = PrintingProbeEmulation.model_validate(dict(emulation.settings))
    probe = PrintingProbe(emulation, settings)
    node = SerialNode("", VID, PID, settings.serial_for(emulation.name), "FT232R USB UART")
    with PtyPort(probe, node, emulation.clock, schedule_for(emulation, settings)) as port:
        yield EmulatedTransports(serial=[port])


EMULATOR = Emulator(
    driver="serial_ascii",
    summary="a probe that prints lines, as a MaxBotix HRXL-MaxSonar-WR does",
    settings=lambda: PrintingProbeEmulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"rate_hz": 20, "faults": [{"kind": "disconnect", "at": 10}]},
        DeviceTimeout: {"rate_hz": 20, "faults": [{"kind": "timeout", "at": 5, "seconds": 20}]},
    },
    driver_settings={"timeout_s": 1.0},
)
