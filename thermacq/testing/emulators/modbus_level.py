"""Emulated Modbus RTU level probe: answers the functions 3 and 4 from a few registers.

Frame: address, function, content, CRC-16/MODBUS (polynomial 0xA001 reflected, start 0xFFFF, low byte first).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from pydantic import Field

from thermacq.errors import DeviceDisconnected, DeviceTimeout
from thermacq.hooks import Emulation, Emulator
from thermacq.testing.emulation.faults import EmulatorSettings, schedule_for
from thermacq.testing.emulation.pty import PtyPort
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.timing.clock import NS_PER_S
from thermacq.transports import SerialNode, Transports

# A USB adapter to RS-485 (FTDI FT232R).
VID, PID = 0x0403, 0x6001
_REQUEST_BYTES = 8
_BAD_FUNCTION, _BAD_ADDRESS = 1, 2
_WAVE_HZ = 0.5


class ModbusProbeEmulation(EmulatorSettings):
    """Settings of the emulated probe; its faults strike answers."""

    slave: int = Field(1, ge=1, le=247)
    register_address: int = Field(0x0208, ge=0, le=0xFFFF)
    mean_counts: int = Field(7000, ge=0, le=0xFFFF)
    amplitude_counts: int = Field(200, ge=0, le=0x7FFF)


def crc16(data: bytes) -> bytes:
    """CRC-16/MODBUS of a frame, as it is sent."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


class ModbusProbe:
    """The logic: `thermacq.testing.emulation.pty.SerialDevice`."""

    def __init__(self, emulation: Emulation, settings: ModbusProbeEmulation) -> None:
        self._settings = settings
        self._clock = emulation.clock
        self._start_ns = emulation.clock.now_ns()
        self.power_up()

    def power_up(self) -> None:
        """Start afresh."""
        self._buffer = b""

    def receive(self, data: bytes) -> Sequence[bytes]:
        """Answer requests to this slave; anything else is skipped byte by byte."""
        self._buffer += data
        answers = []
        while len(self._buffer) >= _REQUEST_BYTES:
            frame = self._buffer[:_REQUEST_BYTES]
            if crc16(frame[:-2]) != frame[-2:]:
                self._buffer = self._buffer[1:]
                continue
            self._buffer = self._buffer[_REQUEST_BYTES:]
            if frame[0] == self._settings.slave:
                content = self._obey(frame)
                answers.append(content + crc16(content))
        return answers

    def _obey(self, frame: bytes) -> bytes:
        function, address, count = (
            frame[1],
            int.from_bytes(frame[2:4], "big"),
            int.from_bytes(frame[4:6], "big"),
        )
        if function not in (3, 4):
            return bytes((frame[0], function | 0x80, _BAD_FUNCTION))
        if address != self._settings.register_address or count != 1:
            return bytes((frame[0], function | 0x80, _BAD_ADDRESS))
        return bytes((frame[0], function, 2)) + self.counts().to_bytes(2, "big")

    def counts(self) -> int:
        """Distance now, counts."""
        seconds = (self._clock.now_ns() - self._start_ns) / NS_PER_S
        wave = math.sin(2 * math.pi * _WAVE_HZ * seconds)
        return self._settings.mean_counts + round(self._settings.amplitude_counts * wave)

    def due_ns(self) -> int | None:
        """It only answers."""
        return None

    def act(self) -> Sequence[bytes]:
        """Nothing unasked."""
        return ()


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Bring a Modbus probe to life behind a pseudo-terminal."""
    settings = ModbusProbeEmulation.model_validate(dict(emulation.settings))
    probe = ModbusProbe(emulation, settings)
    node = SerialNode("", VID, PID, settings.serial_for(emulation.name), "FT232R USB UART")
    with PtyPort(probe, node, emulation.clock, schedule_for(emulation, settings)) as port:
        yield EmulatedTransports(serial=[port])


EMULATOR = Emulator(
    driver="modbus_level",
    summary="a level probe that answers Modbus RTU, as a Senix ToughSonic does",
    settings=lambda: ModbusProbeEmulation,
    attach=attach,
    faults={
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 5}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 5, "seconds": 30}]},
    },
    driver_settings={"timeout_s": 1.0},
)
