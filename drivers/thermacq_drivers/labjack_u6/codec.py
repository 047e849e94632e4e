"""Bytes of the LabJack U6: commands with their checksums, calibration, and the clock of its stream.

Pure functions. Layouts are those of the vendor's public Python and C examples.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

VID, PID = 0x0CD5, 0x0006
OUT_ENDPOINT, REPLY_ENDPOINT, STREAM_ENDPOINT = 0x01, 0x82, 0x83
PACKET_BYTES = 64

CONFIG, STREAM_CONFIG, READ_MEMORY = 0x08, 0x11, 0x2D
STREAM_START, STREAM_STOP = b"\xa8\xa8", b"\xb0\xb0"
STREAM_IS_ACTIVE = 48
DIGITAL_CHANNEL = 193
"""Streams FIO0-7 in bits 0-7 and EIO0-7 in bits 8-15."""

GAINS = (1, 10, 100, 1000)
CALIBRATION_BLOCKS = (0, 1, 2, 3)
LARGEST_INTERVAL = 0xFFFF
# Clock bits of a StreamConfig and the rate behind them, fastest first.
_CLOCKS = ((0b1000, 48e6), (0b0000, 4e6), (0b1010, 48e6 / 256), (0b0010, 4e6 / 256))
_NOMINAL_SLOPE, _NOMINAL_NEGATIVE_SLOPE, _NOMINAL_CENTRE = 3.1580578e-4, -3.158058e-4, 33523.0
# Further from nominal than this, constants are those of no U6.
_SLOPE_TOLERANCE, _CENTRE_TOLERANCE = 0.1, 2000.0


def checksum8(data: bytes) -> int:
    """Sum of bytes, the carry added back in twice."""
    total = sum(data)
    total = (total & 0xFF) + (total >> 8)
    return (total & 0xFF) + (total >> 8)


def extended(number: int, data: bytes) -> bytes:
    """An extended command: its number and an even number of bytes, with both checksums."""
    head = bytes((0xF8, len(data) // 2, number)) + struct.pack("<H", sum(data) & 0xFFFF)
    return bytes((checksum8(head),)) + head + data


def is_whole(data: bytes) -> bool:
    """Whether both checksums of an extended message hold."""
    return (
        len(data) >= 6
        and checksum8(data[1:6]) == data[0]
        and sum(data[6:]) & 0xFFFF == data[4] | data[5] << 8
    )


def parse_extended(reply: bytes, number: int, length: int) -> bytes:
    """The whole reply to an extended command; `ValueError` when it is damaged or none to this command."""
    reply = reply[:length]
    if len(reply) < length or not is_whole(reply) or reply[1] != 0xF8 or reply[3] != number:
        raise ValueError(f"the reply to command {number:#04x} is damaged: {reply.hex(' ') or 'empty'}")
    return reply


def parse_short(reply: bytes, command: bytes) -> int:
    """Error code in the reply to `STREAM_START` or `STREAM_STOP`; `ValueError` when it is damaged."""
    if len(reply) < 4 or reply[1] != command[1] + 1 or checksum8(reply[1:4]) != reply[0]:
        raise ValueError(f"the reply to command {command[1]:#04x} is damaged: {reply.hex(' ') or 'empty'}")
    return reply[2]


def config_read() -> bytes:
    """ConfigU6 that changes nothing; the reply has 38 bytes."""
    return extended(CONFIG, bytes(20))


@dataclass(frozen=True)
class Individual:
    """What ConfigU6 tells."""

    serial: str
    model: str
    firmware: str


def parse_config(reply: bytes) -> Individual:
    """Serial number, model and firmware; `ValueError` when damaged."""
    reply = parse_extended(reply, CONFIG, 38)
    model = "U6-Pro" if reply[37] & 8 else "U6"
    return Individual(str(int.from_bytes(reply[15:19], "little")), model, f"{reply[10]}.{reply[9]:02d}")


def memory_read(block: int) -> bytes:
    """Reads one block of the calibration memory; the reply has 40 bytes."""
    return extended(READ_MEMORY, bytes((0, block)))


def parse_memory(reply: bytes) -> tuple[float, ...]:
    """The four numbers of a block, fixed point 32.32; `ValueError` when damaged."""
    reply = parse_extended(reply, READ_MEMORY, 40)
    if reply[6]:
        raise ValueError(f"the device refused to read its calibration: error {reply[6]}")
    return tuple(value / 2**32 for value in struct.unpack("<4q", reply[8:40]))


@dataclass(frozen=True)
class Calibration:
    """Constants by gain (x1, x10, x100, x1000); volts for 16-bit codes of a stream."""

    slope: tuple[float, ...]
    negative_slope: tuple[float, ...]
    centre: tuple[float, ...]

    def volts(self, codes: NDArray[np.uint16], gain: int) -> NDArray[np.float64]:
        """Volts at the terminal of codes taken at gain 1, 10, 100 or 1000."""
        place = GAINS.index(gain)
        over = codes.astype(np.float64) - self.centre[place]
        volts: NDArray[np.float64] = np.where(
            over < 0, -over * self.negative_slope[place], over * self.slope[place]
        )
        return volts


NOMINAL = Calibration(
    tuple(_NOMINAL_SLOPE / gain for gain in GAINS),
    tuple(_NOMINAL_NEGATIVE_SLOPE / gain for gain in GAINS),
    (_NOMINAL_CENTRE,) * len(GAINS),
)


def calibration_from(blocks: Sequence[Sequence[float]]) -> Calibration:
    """Constants from the blocks 0 to 3 (slopes and offsets, then negative slopes and centres).

    Raises
    ------
    ValueError
        The memory was never written, or holds constants of no U6.
    """
    found = Calibration(
        slope=(blocks[0][0], blocks[0][2], blocks[1][0], blocks[1][2]),
        negative_slope=(blocks[2][0], blocks[2][2], blocks[3][0], blocks[3][2]),
        centre=(blocks[2][1], blocks[2][3], blocks[3][1], blocks[3][3]),
    )
    for place, gain in enumerate(GAINS):
        for value, nominal in (
            (found.slope[place], NOMINAL.slope[place]),
            (found.negative_slope[place], NOMINAL.negative_slope[place]),
        ):
            if not abs(value / nominal - 1) < _SLOPE_TOLERANCE:
                raise ValueError(f"slope {value:g} V at gain x{gain} is far from the nominal {nominal:g} V")
        if not abs(found.centre[place] - _NOMINAL_CENTRE) < _CENTRE_TOLERANCE:
            raise ValueError(
                f"centre {found.centre[place]:g} at gain x{gain} is far from {_NOMINAL_CENTRE:g}"
            )
    return found


@dataclass(frozen=True)
class ScanClock:
    """Clock of a stream: `interval` ticks at `tick_rate_hz` from scan to scan."""

    bits: int
    tick_rate_hz: float
    interval: int

    @property
    def rate_hz(self) -> float:
        """Scans per second."""
        return self.tick_rate_hz / self.interval


def scan_clock(rate_hz: float) -> ScanClock:
    """The fastest clock that reaches down to this rate, and its interval nearest to it.

    Raises
    ------
    ValueError
        The rate is below the slowest possible.
    """
    for bits, tick_rate_hz in _CLOCKS:
        interval = max(1, round(tick_rate_hz / rate_hz))
        if interval <= LARGEST_INTERVAL:
            return ScanClock(bits, tick_rate_hz, interval)
    slowest = _CLOCKS[-1][1] / LARGEST_INTERVAL
    raise ValueError(f"{rate_hz:g} scans/s asked, at least {slowest:.3g} possible")


@dataclass(frozen=True)
class Input:
    """One channel of a scan."""

    number: int
    gain: int = 1
    differential: bool = False

    def options(self) -> int:
        """Its option byte."""
        return self.differential << 7 | GAINS.index(self.gain) << 4


def stream_config(
    inputs: Sequence[Input], clock: ScanClock, samples_per_packet: int, resolution: int, settling: int
) -> bytes:
    """StreamConfig; the reply has 8 bytes with an error code in byte 6."""
    head = bytes((len(inputs), resolution, samples_per_packet, 0, settling, clock.bits))
    channels = b"".join(bytes((item.number, item.options())) for item in inputs)
    return extended(STREAM_CONFIG, head + struct.pack("<H", clock.interval) + channels)
