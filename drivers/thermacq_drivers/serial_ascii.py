"""Driver ``serial_ascii``: any wave probe that prints numbers as lines of text on a serial port.

A regular expression says where the numbers stand: each of its groups is a channel. Ready-made for a MaxBotix
HRXL-MaxSonar-WR (``R1234`` and a carriage return: 1234 mm, about 6 lines/s; protocol facts from the public
ESPHome and gage-beaglebone sources). Bytes that are not ASCII, which some of these sensors put between lines, are
thrown away; a line that does not fit the expression as a whole is counted as one lost sample.

Such a probe has no clock and no sample counter: its samples are counted here, and a sample that was never
printed cannot be noticed.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from thermacq.devices import (
    DeviceContext,
    DeviceIdentity,
    DeviceKind,
    ProbeCapabilities,
    SampleBlock,
    Settings,
    StreamHost,
)
from thermacq.errors import DeviceFault, DeviceTimeout
from thermacq.hooks import Driver, Evidence
from thermacq.settings import check_settings
from thermacq.transports import Transports
from thermacq_drivers.transports.serial import PortFinder, SerialPort

LONGEST_LINE = 256
_WAIT_S = 0.05


class LineSplitter:
    """Bytes to lines, in whatever pieces they come.

    Parameters
    ----------
    end
        The byte or bytes that end a line.
    """

    def __init__(self, end: bytes) -> None:
        self._end = end
        self._rest = b""
        self._overlong = False

    def feed(self, data: bytes) -> list[str]:
        """Take bytes and return the complete lines, printable ASCII only; an overlong one is empty."""
        *lines, rest = (self._rest + data).split(self._end)
        found = []
        for line in lines:
            found.append("" if self._overlong or len(line) > LONGEST_LINE else _printable(line))
            self._overlong = False
        if len(rest) > LONGEST_LINE:
            self._overlong = True
            # Only the beginning of a line end can matter of what was too long.
            rest = rest[-len(self._end) :]
        self._rest = rest
        return found


def _printable(line: bytes) -> str:
    return bytes(byte for byte in line if 0x20 <= byte < 0x7F or byte == 0x09).decode("ascii").strip()


def parse_line(line: str, pattern: re.Pattern[str], scale: float) -> list[float] | None:
    """Values of the channels in a line; None when the line does not fit as a whole."""
    match = pattern.fullmatch(line)
    if match is None:
        return None
    try:
        values = [float(group) * scale for group in match.groups()]
    except (TypeError, ValueError):
        return None
    return values if np.isfinite(values).all() else None


def channel_names(pattern: re.Pattern[str]) -> tuple[str, ...]:
    """Names of the groups of an expression; ``value1`` and so on for those without a name."""
    names = {number: name for name, number in pattern.groupindex.items()}
    return tuple(names.get(number, f"value{number}") for number in range(1, pattern.groups + 1))


class SerialAsciiSettings(BaseModel):
    """Settings of a probe that prints; the defaults are those of a MaxBotix HRXL-MaxSonar-WR."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field("", description="path of the port, when the adapter has no serial number")
    baud: int = Field(9600, ge=50, le=4_000_000)
    frame: str = Field("8N1", pattern=r"^[5-8][NEO][12]$", description="data bits, parity, stop bits")
    pattern: str = Field(r"R(?P<distance>\d{4})", description="expression of a whole line; groups: channels")
    line_end: str = Field("\r", min_length=1, max_length=4, description="what ends a line")
    scale: float = Field(1e-3, description="raw unit per printed unit")
    unit: str = Field("m", description="raw unit, after the scale")
    rate_hz: float = Field(10.0, gt=0, le=10_000, description="highest rate of its lines")
    ask: str = Field("", description="text sent at this rate, for a probe that prints only when asked")
    timeout_s: float = Field(3.0, gt=0, le=60, description="longest wait for a good line")

    @field_validator("pattern")
    @classmethod
    def _has_groups(cls, pattern: str) -> str:
        try:
            compiled = re.compile(pattern)
        except re.error as error:
            raise ValueError(f"this is no regular expression ({error})") from None
        if compiled.groups == 0:
            raise ValueError(r"it has no group: put the number in parentheses, such as R(\d{4})")
        return pattern

    @field_validator("line_end", "ask")
    @classmethod
    def _ascii(cls, text: str) -> str:
        if not text.isascii():
            raise ValueError("ASCII only")
        return text


class SerialAsciiProbe:
    """The wave probe behind ``driver = "serial_ascii"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._finder = PortFinder(context)
        self._settings = SerialAsciiSettings()
        self._armed = False
        self._count = 0

    @property
    def capabilities(self) -> ProbeCapabilities:
        """What the probe prints with the settings in force."""
        settings = self._settings
        return ProbeCapabilities(
            channel_names(re.compile(settings.pattern)), settings.unit, max_sample_rate_hz=settings.rate_hz
        )

    def open(self) -> DeviceIdentity:
        """Find the port by the adapter's serial number or by its path; it is opened by `configure`."""
        self.close()
        node = self._finder.find()
        model = f"serial probe on {node.product or 'a serial port'}"
        return DeviceIdentity("serial_ascii", model, node.serial or node.path)

    def configure(self, settings: Settings) -> Settings:
        """Apply settings and open the port with them."""
        self.disarm()
        checked = check_settings(SerialAsciiSettings, settings, self._name)
        self._finder.connect(checked.port, checked.baud, checked.frame)
        self._settings = checked
        return checked.model_dump()

    def arm(self) -> None:
        """Forget what was printed before, and count from 0."""
        self._finder.port("arm").discard("arm")
        self._count, self._armed = 0, True

    def samples(self, host: StreamHost) -> Iterator[SampleBlock]:
        """Yield what is printed; lines that do not fit leave a gap in the count."""
        port, settings = self._require_armed(), self._settings
        splitter, pattern = LineSplitter(settings.line_end.encode()), re.compile(settings.pattern)
        good_s, asked_s = time.monotonic(), -np.inf
        while self._armed and not host.stopping():
            if settings.ask and time.monotonic() - asked_s >= 1 / settings.rate_hz:
                port.write(settings.ask.encode(), "acquire")
                asked_s = time.monotonic()
            lines = splitter.feed(port.read_some(min(_WAIT_S, 1 / settings.rate_hz), "acquire"))
            for first, values in _consecutive([parse_line(line, pattern, settings.scale) for line in lines]):
                yield self._block(values, self._count + first)
                good_s = time.monotonic()
            self._count += len(lines)
            if time.monotonic() - good_s > settings.timeout_s:
                what = f"no line that fits '{settings.pattern}' came within {settings.timeout_s:g} s"
                raise DeviceTimeout(
                    self._name,
                    "acquire",
                    what,
                    last_frame=self._count - 1,
                    remedy="Check baud rate, pattern and line_end against what the probe prints.",
                )

    def _block(self, values: list[list[float]], first: int) -> SampleBlock:
        return SampleBlock(
            np.array(values, np.float64), np.full(len(values), -1, np.int64), first, self._clock.now_ns()
        )

    def disarm(self) -> None:
        """Stop listening."""
        self._armed = False

    def close(self) -> None:
        """Let go of the port."""
        self.disarm()
        self._finder.close()

    def _require_armed(self) -> SerialPort:
        if not self._armed:
            raise DeviceFault(self._name, "acquire", "it is not armed")
        return self._finder.port("acquire")


def _consecutive(parsed: Sequence[list[float] | None]) -> Iterator[tuple[int, list[list[float]]]]:
    """Runs of good lines, each with the place of its first."""
    run: list[list[float]] = []
    for place, values in enumerate([*parsed, None]):
        if values is not None:
            run.append(values)
        elif run:
            yield place - len(run), run
            run = []


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Serial adapters with a serial number; what hangs on them is known only to whoever plugged it in."""
    return [
        DeviceIdentity("serial_ascii", f"serial port of {node.product or 'an adapter'}", node.serial)
        for node in transports.serial_ports()
        if node.serial
    ]


DRIVER = Driver(
    name="serial_ascii",
    kind=DeviceKind.WAVE_PROBE,
    summary="any probe that prints numbers on a serial port: expression, scale, unit, rate",
    evidence=Evidence.EMULATED,
    make=SerialAsciiProbe,
    settings=lambda: SerialAsciiSettings,
    discover=discover,
)
