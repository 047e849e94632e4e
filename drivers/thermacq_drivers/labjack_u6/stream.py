"""The stream of a LabJack U6: packets out of any bytes, scans out of packets, edges out of scans.

Pure state machines; nothing here touches a device.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.labjack_u6.codec import is_whole

RECOVERING, RECOVERED = 59, 60
_FRAME_BYTES = 14
_COUNTER_TURN = 256

Codes = NDArray[np.uint16]
Run: TypeAlias = tuple[int, Codes]
"""Number of the first scan, and codes (scans, channels) of consecutive ones."""


@dataclass(frozen=True)
class Packet:
    """One packet: its counter (8 bits), error code, scans that the device dropped, samples, backlog."""

    counter: int
    error: int
    dropped: int
    samples: Codes
    backlog: int


class PacketParser:
    """Bytes to packets, in whatever pieces they come.

    Parameters
    ----------
    samples_per_packet
        As configured, 1 to 25.
    """

    def __init__(self, samples_per_packet: int) -> None:
        self._length = _FRAME_BYTES + 2 * samples_per_packet
        self._mark = bytes((0xF9, 4 + samples_per_packet, 0xC0))
        self._rest = b""
        self._bad_bytes = 0
        self._bad_packets = 0

    @property
    def damaged(self) -> int:
        """Packets that bytes without a valid one amount to."""
        return self._bad_packets + -(-self._bad_bytes // self._length)

    def feed(self, data: bytes) -> list[Packet]:
        """Take bytes and return the packets whose checksums hold."""
        data = self._rest + data
        found: list[Packet] = []
        place = 0
        while len(data) - place >= self._length:
            candidate = data[place : place + self._length]
            if candidate[1:4] == self._mark and is_whole(candidate):
                found.append(_packet(candidate))
                self._bad_packets, self._bad_bytes = self.damaged, 0
                place += self._length
            else:
                mark = data.find(self._mark, place + 2)
                # A mark may be cut at the end of the bytes: the last ones are kept.
                following = mark - 1 if mark >= 0 else len(data) - len(self._mark)
                self._bad_bytes += following - place
                place = following
        self._rest = data[place:]
        return found


def _packet(data: bytes) -> Packet:
    return Packet(
        counter=data[10],
        error=data[11],
        dropped=int.from_bytes(data[6:10], "little") if data[11] == RECOVERED else 0,
        samples=np.frombuffer(data[12:-2], "<u2").astype(np.uint16),
        backlog=data[-2],
    )


class ScanAssembler:
    """Packets to numbered scans; a scan may begin in one packet and end in the next.

    Scans are counted from the start of the stream, those included that were lost with a packet or dropped by
    the device. Up to 127 packets lost in a row are counted exactly. That dropped scans lie before the first
    scan that begins in the reporting packet is an assumption.

    Parameters
    ----------
    channels
        Samples of a scan.
    samples_per_packet
        As configured.
    """

    def __init__(self, channels: int, samples_per_packet: int) -> None:
        self._channels = channels
        self._per_packet = samples_per_packet
        self._packets = 0
        self._rest: Codes = np.empty(0, np.uint16)
        self._recovering = False
        self.lost_packets = 0
        self.dropped_scans = 0

    def take(self, packet: Packet) -> list[Run]:
        """Scans that a packet completes.

        Raises
        ------
        ValueError
            Packets were lost and with them the report of how many scans the device dropped: what follows
            cannot be placed in time.
        """
        missing = (packet.counter - self._packets) % _COUNTER_TURN
        if missing >= _COUNTER_TURN // 2:
            return []  # one that came before, again
        if missing and self._recovering and packet.error not in (RECOVERING, RECOVERED):
            raise ValueError("the packet that tells how many scans were dropped was lost")
        self._recovering = packet.error == RECOVERING
        self.lost_packets += missing
        first_sample = (self._packets + missing) * self._per_packet
        self._packets += missing + 1
        begun = self._rest if not missing else np.empty(0, np.uint16)
        runs: list[Run] = []
        if packet.dropped and begun.size:
            # The scan that was under way is from before the drop.
            whole = np.append(begun, packet.samples)[: self._channels]
            runs += self._cut(first_sample - begun.size, whole)
            first_sample += whole.size - begun.size
            samples = packet.samples[whole.size - begun.size :]
        else:
            first_sample -= begun.size
            samples = np.append(begun, packet.samples)
        self.dropped_scans += packet.dropped
        return runs + self._cut(first_sample, samples)

    def _cut(self, first_sample: int, samples: Codes) -> list[Run]:
        """Whole scans of consecutive samples; the beginning of the next one is kept."""
        samples = samples[-first_sample % self._channels :]
        first_scan = -(-first_sample // self._channels) + self.dropped_scans
        whole = samples.size // self._channels
        self._rest = samples[whole * self._channels :]
        scans = samples[: whole * self._channels].reshape(whole, self._channels)
        return [(first_scan, scans)] if whole else []


class EdgeFinder:
    """Rising edges of one bit of the digital channel.

    Parameters
    ----------
    bit
        Bit of the line: 0-7 FIO, 8-15 EIO.
    """

    def __init__(self, bit: int) -> None:
        self._bit = bit
        self._next_scan = -1
        self._high = True

    def take(self, first_scan: int, codes: Codes) -> NDArray[np.int64]:
        """Scans (n,) at which the line was first seen high; an edge inside a gap is none."""
        if first_scan != self._next_scan:
            self._high = True  # whether it was high before is not known
        high = (codes >> self._bit & 1).astype(bool)
        before = np.append(self._high, high[:-1])
        self._high, self._next_scan = bool(high[-1]), first_scan + codes.size
        edges: NDArray[np.int64] = first_scan + np.flatnonzero(high & ~before)
        return edges
