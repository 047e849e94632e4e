"""Driver ``lab-gauge`` and its emulator: a gauge that sends ``A5 low high sum`` fifty times a second."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from thermacq import devices
from thermacq.devices import DeviceContext, DeviceIdentity, SampleBlock, Settings, StreamHost
from thermacq.errors import DeviceDisconnected, DeviceTimeout
from thermacq.hooks import Driver, Emulation, Emulator, Evidence, hookimpl
from thermacq.settings import check_settings
from thermacq.testing.emulation.faults import EmulatorSettings, schedule_for
from thermacq.testing.emulation.pty import PtyPort
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.transports import SerialNode, Transports
from thermacq_drivers.transports.serial import SerialPort, find_port

IDS = (0x1209, 0x0001)
RATE_HZ = 50.0


def ports(transports: Transports) -> list[SerialNode]:
    """Serial ports of gauges; real or emulated, the transports say."""
    return [node for node in transports.serial_ports() if (node.vid, node.pid) == IDS]


def parse(data: bytes) -> tuple[list[float | None], bytes]:
    """Metres of each message, None for a damaged one; and the bytes that belong to the next."""
    values: list[float | None] = []
    while (start := data.find(0xA5)) >= 0 and len(data) - start >= 4:
        message = data[start : start + 4]
        whole = sum(message[:3]) % 256 == message[3]
        values.append(int.from_bytes(message[1:3], "little", signed=True) * 1e-4 if whole else None)
        data = data[start + (4 if whole else 1) :]
    return values, data[start:] if start >= 0 else b""


class GaugeSettings(BaseModel):
    """What the rig file may say under ``[probes.NAME.settings]``."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    timeout_s: float = Field(1.0, gt=0, le=60, description="longest silence")


class Gauge:
    """The verbs of `thermacq.devices.WaveProbe`, in the order in which the host calls them."""

    capabilities = devices.ProbeCapabilities(("elevation",), "m", max_sample_rate_hz=RATE_HZ)

    def __init__(self, context: DeviceContext) -> None:
        self._context, self._armed = context, False
        self._port: SerialPort | None = None

    def open(self) -> DeviceIdentity:
        """Find the gauge by its serial number."""
        self.close()
        node = find_port(ports(self._context.transports), self._context.name, serial=self._context.serial)
        self._port = SerialPort(self._context.name, node.path)
        return DeviceIdentity("lab-gauge", "lab gauge", node.serial)

    def configure(self, settings: Settings) -> Settings:
        """Apply the settings and return all that is in force."""
        self._settings = check_settings(GaugeSettings, settings, self._context.name)
        return self._settings.model_dump()

    def arm(self) -> None:
        """Get ready."""
        self._armed = self._port is not None

    def samples(self, host: StreamHost) -> Iterator[SampleBlock]:
        """One block for each good message; a damaged one leaves a gap in the count."""
        rest, index, heard_ns = b"", 0, self._context.clock.now_ns()
        while self._port is not None and self._armed and not host.stopping():
            values, rest = parse(rest + self._port.read_some(0.05, "acquire"))
            for value in values:
                if value is not None:
                    heard_ns = self._context.clock.now_ns()
                    yield SampleBlock(np.array([[value]]), np.array([-1]), index, heard_ns)
                index += 1
            if self._context.clock.now_ns() - heard_ns > self._settings.timeout_s * 1e9:
                raise DeviceTimeout(self._context.name, "acquire", "it fell silent", last_frame=index - 1)

    def disarm(self) -> None:
        """Stop; legal in every state."""
        self._armed = False

    def close(self) -> None:
        """Let go of the port; legal in every state."""
        self.disarm()
        if self._port is not None:
            self._port.close()
            self._port = None


class EmulatedGauge:
    """The gauge itself: what it sends, and when. Written from its description, not from the driver."""

    def __init__(self, emulation: Emulation) -> None:
        self._clock, self._sent, self._start_ns = emulation.clock, 0, emulation.clock.now_ns()

    def power_up(self) -> None: ...

    def receive(self, _data: bytes) -> Sequence[bytes]:
        return ()

    def due_ns(self) -> int:
        return self._start_ns + round((self._sent + 1) * 1e9 / RATE_HZ)

    def act(self) -> Sequence[bytes]:
        self._sent += 1
        value = round(300 * math.sin(math.tau * self._sent / RATE_HZ))
        content = b"\xa5" + value.to_bytes(2, "little", signed=True)
        return [content + bytes([sum(content) % 256])]


@contextmanager
def attach(emulation: Emulation) -> Iterator[Transports]:
    """Plug an emulated gauge in behind a pseudo-terminal, for as long as the context lasts."""
    settings = EmulatorSettings.model_validate(dict(emulation.settings))
    node = SerialNode("", *IDS, settings.serial_for(emulation.name), "lab gauge")
    with PtyPort(EmulatedGauge(emulation), node, emulation.clock, schedule_for(emulation, settings)) as port:
        yield EmulatedTransports(serial=[port])


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Gauges that are attached; none is opened."""
    return [DeviceIdentity("lab-gauge", "lab gauge", node.serial) for node in ports(transports)]


@hookimpl
def thermacq_drivers() -> Sequence[Driver]:
    """The driver; `Evidence.EMULATED` until it has met a real gauge."""
    kind, summary = devices.DeviceKind.WAVE_PROBE, "example: a gauge on a serial port"
    return [Driver("lab-gauge", kind, summary, Evidence.EMULATED, Gauge, lambda: GaugeSettings, discover)]


@hookimpl
def thermacq_emulators() -> Sequence[Emulator]:
    """Its emulator, and how it acts out each fault."""
    faults = {
        DeviceDisconnected: {"faults": [{"kind": "disconnect", "at": 20}]},
        DeviceTimeout: {"faults": [{"kind": "timeout", "at": 20, "seconds": 30}]},
    }
    return [Emulator("lab-gauge", "plays the gauge", lambda: EmulatorSettings, attach, faults)]
