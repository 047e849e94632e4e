"""Driver ``modbus_level``: ultrasonic level probes that answer Modbus RTU, through pymodbus.

The defaults are those of a Senix ToughSonic: 9600 8N1, slave 1, holding register 0x0208. UNCERTAIN: the public
source of its scale (trdenton/rs485_toughsonic) multiplies counts by 0.00384 inch, while Senix' usual
resolution is 0.003384 inch (0.0859 mm), 13 % less; the driver takes the latter as `metres_per_count`. Calibrate
the probe (`thermacq calibrate probe`) before any of its numbers is used.

The probe is asked at fixed times and has no clock or counter of its own: an answer that is late, damaged or
missing is one lost sample, and shows as a gap in the count.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from thermacq.devices import (
    DeviceContext,
    DeviceIdentity,
    DeviceKind,
    ProbeCapabilities,
    SampleBlock,
    Settings,
    StreamHost,
)
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Driver, Evidence
from thermacq.settings import check_settings
from thermacq.timing import NS_PER_S
from thermacq.transports import Transports
from thermacq_drivers.transports.serial import PortFinder

if TYPE_CHECKING:
    from pymodbus.client import ModbusSerialClient

_INCH_M = 0.0254
# Longest wait for an answer; a register takes 8 + 7 bytes, 16 ms at 9600 baud.
_ANSWER_S = 0.2
_OPENING_TRIES = 3

Encoding = Literal["uint16", "int16", "uint32", "uint32_swapped", "float32", "float32_swapped"]
_LAYOUTS = {"uint16": ">H", "int16": ">h", "uint32": ">I", "float32": ">f"}


def decode_registers(registers: Sequence[int], encoding: Encoding) -> float:
    """Number in one or two registers, high word first unless ``swapped``; NaN when they are not of that size."""
    words = list(registers)[::-1] if encoding.endswith("_swapped") else list(registers)
    layout = _LAYOUTS[encoding.removesuffix("_swapped")]
    if len(words) * 2 != struct.calcsize(layout):
        return math.nan
    return float(struct.unpack(layout, struct.pack(f">{len(words)}H", *words))[0])


class ModbusLevelSettings(BaseModel):
    """Settings of a Modbus level probe; the defaults are those of a Senix ToughSonic."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field("", description="path of the port, when the adapter has no serial number")
    baud: int = Field(9600, ge=1200, le=4_000_000)
    frame: str = Field("8N1", pattern=r"^8[NEO][12]$", description="data bits, parity, stop bits")
    slave: int = Field(1, ge=1, le=247, description="Modbus address")
    register_address: int = Field(0x0208, ge=0, le=0xFFFF, description="first register of the distance")
    table: Literal["holding", "input"] = "holding"
    encoding: Encoding = "uint16"
    metres_per_count: float = Field(0.003384 * _INCH_M, description="scale; see the driver's docstring")
    rate_hz: float = Field(10.0, gt=0, le=200, description="how often it is asked")
    timeout_s: float = Field(2.0, gt=0, le=60, description="longest time without a good answer")


class ModbusLevelProbe:
    """The wave probe behind ``driver = "modbus_level"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._transports = context.transports
        self._finder = PortFinder(context)
        self._path = ""
        self._settings = ModbusLevelSettings()
        self._client: ModbusSerialClient | None = None
        self._armed = False

    @property
    def capabilities(self) -> ProbeCapabilities:
        """One channel: the distance that the probe measures."""
        return ProbeCapabilities(("distance",), "m", max_sample_rate_hz=self._settings.rate_hz)

    def open(self) -> DeviceIdentity:
        """Find the port by the adapter's serial number or by its path; `configure` speaks to the probe."""
        self.close()
        node = self._finder.find()
        return DeviceIdentity("modbus_level", "Modbus level probe", node.serial or node.path)

    def configure(self, settings: Settings) -> Settings:
        """Apply settings, and ask the probe once, so that a wrong address is told before recording."""
        self.disarm()
        checked = check_settings(ModbusLevelSettings, settings, self._name)
        self._path = self._finder.confirm(checked.port).path
        self._close_client()
        self._settings = checked
        self._client = self._connect("configure")
        if not any(math.isfinite(self._ask("configure")) for _ in range(_OPENING_TRIES)):
            raise DeviceTimeout(
                self._name,
                "configure",
                f"slave {checked.slave} gives no register {checked.register_address:#06x}",
                remedy="Check slave address, baud rate, register_address, table and wiring (A and B exchanged?).",
            )
        return checked.model_dump()

    def arm(self) -> None:
        """Get ready; the probe is asked when `samples` begins."""
        if self._client is None:
            raise DeviceFault(self._name, "arm", "it is not open and configured")
        self._armed = True

    def samples(self, host: StreamHost) -> Iterator[SampleBlock]:
        """Ask at fixed times; a question without a good answer leaves a gap in the count."""
        self._require_armed()
        period_ns = NS_PER_S / self._settings.rate_hz
        start_ns = good_ns = self._clock.now_ns()
        index = first = 0
        while self._armed and not host.stopping():
            if not self._wait(start_ns + round(index * period_ns), host):
                return
            distance_m = self._ask("acquire")
            now_ns = self._clock.now_ns()
            if math.isfinite(distance_m):
                good_ns = now_ns
                yield SampleBlock(np.array([[distance_m]]), np.array([-1], np.int64), index - first, now_ns)
            elif index == first:
                # Before the first good answer nothing was lost.
                first += 1
            if now_ns - good_ns > self._settings.timeout_s * NS_PER_S:
                what = f"no good answer within {self._settings.timeout_s:g} s"
                raise DeviceTimeout(self._name, "acquire", what, last_frame=index - first)
            # Questions that are due already are skipped and count as lost, never caught up.
            index = max(index + 1, math.floor((self._clock.now_ns() - start_ns) / period_ns))

    def _require_armed(self) -> None:
        if not self._armed:
            raise DeviceFault(self._name, "acquire", "it is not armed")

    def _wait(self, due_ns: int, host: StreamHost) -> bool:
        """Wait for the next question; False when the host asked to stop."""
        self._clock.wait_until_ns(due_ns, host.stopping)
        return not host.stopping()

    def _connect(self, stage: str) -> ModbusSerialClient:
        from pymodbus.client import ModbusSerialClient

        settings = self._settings
        client = ModbusSerialClient(
            self._path,
            baudrate=settings.baud,
            bytesize=8,
            parity=settings.frame[1],
            stopbits=int(settings.frame[2]),
            timeout=_ANSWER_S,
            retries=0,
        )
        if not client.connect():
            raise DeviceDisconnected(
                self._name,
                stage,
                f"the port {self._path} cannot be opened",
                remedy="Check cable and permissions (group dialout); `thermacq doctor` says more.",
            )
        return client

    def _ask(self, stage: str) -> float:
        """Distance now, metres; NaN when there was no good answer."""
        from pymodbus.exceptions import ConnectionException, ModbusException

        settings, client = self._settings, self._client
        if client is None:
            raise DeviceFault(self._name, stage, "it is not open")
        ask = client.read_holding_registers if settings.table == "holding" else client.read_input_registers
        count = 1 if settings.encoding.endswith("16") else 2
        try:
            answer: Any = ask(settings.register_address, count=count, device_id=settings.slave)
        except ConnectionException:
            raise self._gone(stage) from None
        except ModbusException:
            # Nothing came, or it was damaged; whether the port still exists tells which.
            if self._path not in {node.path for node in self._transports.serial_ports()}:
                raise self._gone(stage) from None
            return math.nan
        except (OSError, TypeError):
            raise self._gone(stage) from None
        if answer.isError():
            return math.nan
        return decode_registers(answer.registers, settings.encoding) * settings.metres_per_count

    def _gone(self, stage: str) -> DeviceDisconnected:
        what = f"the port {self._path} is gone"
        return DeviceDisconnected(self._name, stage, what, remedy="Check power and cable, then try again.")

    def disarm(self) -> None:
        """Stop asking."""
        self._armed = False

    def close(self) -> None:
        """Let go of the port."""
        self.disarm()
        self._close_client()
        self._finder.close()

    def _close_client(self) -> None:
        if self._client is not None:
            with suppress(Exception):
                self._client.close()  # type: ignore[no-untyped-call]
            self._client = None


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Serial adapters with a serial number; the probes behind them are not asked."""
    return [
        DeviceIdentity("modbus_level", f"serial port of {node.product or 'an adapter'}", node.serial)
        for node in transports.serial_ports()
        if node.serial
    ]


DRIVER = Driver(
    name="modbus_level",
    kind=DeviceKind.WAVE_PROBE,
    summary="level probes that answer Modbus RTU (Senix ToughSonic and the like)",
    evidence=Evidence.EMULATED,
    make=ModbusLevelProbe,
    settings=lambda: ModbusLevelSettings,
    discover=discover,
)
