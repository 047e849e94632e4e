"""Driver ``hsva_logger``: the Arduino wave-gauge logger of the HSVA wave tank (any gauge of 0 to 5 V).

Facts from the public firmware and host program (jerabaul29/logging_ultrasonic_gauges). Until its trigger
input is high the logger says ``W``; then it sends at 200 Hz ``S``, a packed little-endian record and ``E``::

    u32 time_us[channels] | i16 adc[channels] | u32 number | u8 logger

There is no checksum, and the marks may occur inside a record: one is accepted where it begins with S, ends
with E, its 10-bit values and times are possible, and its number follows the one before; after lost bytes,
where the record after it is its successor. Numbers that jump are lost samples.

The logger begins within about 50 ms of its trigger (ten readings, 5 ms apart), so that the beginning is no time
stamp of the trigger. It looks for a stop only after 800 s: disarming leaves it logging, unheard. Channels are
read one after another; ticks are those of the first, and ``docs/reference/devices/hsva_logger.md`` says how
much later the others are.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
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
from thermacq.timing import unwrap_counter
from thermacq.transports import Transports
from thermacq_drivers.transports.serial import PortFinder, SerialPort

BAUD = 2_000_000
TICK_RATE_HZ = 1e6
_START, _END, _WAITING = b"S", b"E", b"W"
_LARGEST_COUNT = 1023
_WAIT_S = 0.05
# Arduino Mega 2560, its official and its older USB chip, and the CH340 of copies.
_IDS = ((0x2341, 0x0042), (0x2341, 0x0010), (0x1A86, 0x7523))


def record_layout(channels: int) -> np.dtype[np.void]:
    """Layout of a record between its marks."""
    return np.dtype(
        [("time_us", "<u4", (channels,)), ("adc", "<i2", (channels,)), ("n", "<u4"), ("id", "u1")]
    )


class RecordParser:
    """Bytes to records, in whatever pieces they come.

    Parameters
    ----------
    channels
        Channels of the logger (``NBR_PINS`` of its firmware).
    """

    def __init__(self, channels: int) -> None:
        self._layout = record_layout(channels)
        self._length = self._layout.itemsize + 2
        self._rest = b""
        self._last = -1
        self.damaged = 0
        """Stretches of bytes that belong to no record."""
        self.waiting = 0
        """How often the logger said since the last record that it waits for its trigger."""

    def feed(self, data: bytes) -> NDArray[np.void]:
        """Take bytes and return the complete records, (records,) of `record_layout`."""
        data = self._rest + data
        found: list[bytes] = []
        place, lost = 0, False
        while len(data) - place >= self._length:
            number = self._number_at(data, place)
            follows = number == self._last + 1
            if number >= 0 and not follows:
                # After lost bytes two records in a row are believed, one is not.
                if len(data) - place < 2 * self._length:
                    break
                follows = number > self._last and self._number_at(data, place + self._length) == number + 1
            if follows:
                found.append(data[place + 1 : place + self._length - 1])
                place += self._length
                self.damaged += lost
                self._last, self.waiting, lost = number, 0, False
            else:
                is_waiting = data[place : place + 1] == _WAITING
                self.waiting += is_waiting
                lost = lost or not is_waiting
                place += 1
        self.damaged += lost
        self._rest = data[place:]
        return np.frombuffer(b"".join(found), self._layout)

    def _number_at(self, data: bytes, place: int) -> int:
        """Number of the record that begins here; -1 when none can."""
        end = place + self._length
        if data[place : place + 1] != _START or data[end - 1 : end] != _END:
            return -1
        record = np.frombuffer(data, self._layout, 1, place + 1)[0]
        times, counts = record["time_us"].astype(np.int64), record["adc"]
        if counts.min() < 0 or counts.max() > _LARGEST_COUNT or (np.diff(times) % 2**32 > 2**31).any():
            return -1
        return int(record["n"])


def continue_ticks(time_us: NDArray[np.int64], before: int) -> NDArray[np.int64]:
    """Microseconds of a 32-bit counter (it wraps every 71.6 minutes), continuing from `before` (-1: from none)."""
    if before < 0:
        return unwrap_counter(time_us, 32)
    turns = before - before % 2**32
    return turns + unwrap_counter(np.concatenate(([before % 2**32], time_us)), 32)[1:]


class HsvaSettings(BaseModel):
    """Settings of the logger."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field("", description="path of the port, when the board has no serial number")
    baud: int = Field(BAUD, ge=9600, le=4_000_000)
    channels: tuple[str, ...] = Field(
        ("gauge1", "gauge2", "gauge3", "gauge4"),
        min_length=1,
        max_length=15,
        description="as the firmware has them",
    )
    rate_hz: float = Field(200.0, gt=0, le=1000, description="rate of the firmware")
    volts_per_count: float = Field(
        10.0 / _LARGEST_COUNT, gt=0, description="at the gauge; 0 to 10 V behind a divider of 0.5"
    )
    timeout_s: float = Field(2.0, gt=0, le=60, description="longest silence")

    @field_validator("channels")
    @classmethod
    def _distinct(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(names)) != len(names):
            raise ValueError("each name once")
        return names


class HsvaLogger:
    """The wave probe behind ``driver = "hsva_logger"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._finder = PortFinder(context, _IDS)
        self._settings = HsvaSettings()
        self._armed = False
        self._restart()

    def _restart(self) -> None:
        self._parser = RecordParser(len(self._settings.channels))
        self._first: int | None = None
        self._ticks = -1
        self._count = 0

    @property
    def capabilities(self) -> ProbeCapabilities:
        """Its channels, in volts at the gauge."""
        settings = self._settings
        return ProbeCapabilities(settings.channels, "V", settings.rate_hz, tick_rate_hz=TICK_RATE_HZ)

    def open(self) -> DeviceIdentity:
        """Find the board by its serial number or port; it is opened by `configure`."""
        self.close()
        node = self._finder.find()
        return DeviceIdentity("hsva_logger", "Arduino wave-gauge logger", node.serial or node.path)

    def configure(self, settings: Settings) -> Settings:
        """Apply settings and listen whether the logger says anything."""
        self.disarm()
        checked = check_settings(HsvaSettings, settings, self._name)
        port = self._finder.connect(checked.port, checked.baud)
        self._settings = checked
        port.read(1, checked.timeout_s, "configure")
        return checked.model_dump(mode="json")

    def arm(self) -> None:
        """Forget what came before; samples are counted from the first record that follows."""
        self._finder.port("arm").discard("arm")
        self._restart()
        self._armed = True

    def samples(self, host: StreamHost) -> Iterator[SampleBlock]:
        """Yield records; while the logger waits for its trigger nothing is yielded, and nothing is wrong."""
        port = self._require_armed()
        heard_s = time.monotonic()
        while self._armed and not host.stopping():
            before = self._parser.waiting
            records = self._parser.feed(port.read_some(_WAIT_S, "acquire"))
            for run in np.split(records, np.flatnonzero(np.diff(records["n"].astype(np.int64)) != 1) + 1):
                if run.size:
                    yield self._block(run)
            if records.size or self._parser.waiting > before:
                heard_s = time.monotonic()
            if self._first is not None and self._parser.waiting > self._length_of_a_stop():
                self._give_up("it has stopped logging and waits for its trigger again")
            if time.monotonic() - heard_s > self._settings.timeout_s:
                self._give_up(f"no record and no sign of waiting within {self._settings.timeout_s:g} s")

    def _length_of_a_stop(self) -> int:
        """Signs of waiting in a row that lost or damaged bytes cannot imitate."""
        return 3 * record_layout(len(self._settings.channels)).itemsize

    def _give_up(self, what: str) -> None:
        raise DeviceTimeout(
            self._name,
            "acquire",
            what,
            last_frame=self._count - 1,
            remedy="Check its trigger, its baud rate, and that `channels` are as many as its firmware has.",
        )

    def _block(self, records: NDArray[np.void]) -> SampleBlock:
        """Consecutive records as samples."""
        numbers = records["n"].astype(np.int64)
        if self._first is None:
            self._first = int(numbers[0])
        ticks = continue_ticks(records["time_us"][:, 0].astype(np.int64), self._ticks)
        self._ticks = int(ticks[-1])
        self._count = int(numbers[-1]) - self._first + 1
        values = records["adc"] * self._settings.volts_per_count
        return SampleBlock(values, ticks, int(numbers[0]) - self._first, self._clock.now_ns())

    def disarm(self) -> None:
        """Stop listening; the logger itself goes on."""
        self._armed = False

    def close(self) -> None:
        """Let go of the port."""
        self.disarm()
        self._finder.close()

    def _require_armed(self) -> SerialPort:
        if not self._armed:
            raise DeviceFault(self._name, "acquire", "it is not armed")
        return self._finder.port("acquire")


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Boards of the kind that the logger runs on; whether one is a logger shows when it is opened."""
    return [
        DeviceIdentity("hsva_logger", "Arduino Mega (or a copy)", node.serial)
        for node in transports.serial_ports()
        if (node.vid, node.pid) in _IDS
    ]


DRIVER = Driver(
    name="hsva_logger",
    kind=DeviceKind.WAVE_PROBE,
    summary="Arduino logger of gauges of 0 to 5 V, as used at the HSVA wave tank",
    evidence=Evidence.EMULATED,
    make=HsvaLogger,
    settings=lambda: HsvaSettings,
    discover=discover,
    usb_ids=_IDS,
)
