"""Messages of the emulated LabJack U6, and the account of what its stream has sent, kept and dropped."""

from __future__ import annotations

import math


def _sum16(data: bytes) -> bytes:
    return (sum(data) % 65536).to_bytes(2, "little")


def sum8(data: bytes) -> int:
    """Checksum of 8 bits: carries added back in."""
    total = sum(data)
    while total > 255:
        total = total // 256 + total % 256
    return total


def framed(kind: int, words: int, number: int, body: bytes) -> bytes:
    """A message with both checksums."""
    head = bytes([kind, words, number]) + _sum16(body)
    return bytes([sum8(head)]) + head + body


class Stream:
    """A configured stream: what is sampled, and what of it was sent since it was started."""

    def __init__(self, command: bytes) -> None:
        self.inputs = [(command[place], command[place + 1]) for place in range(14, len(command) - 1, 2)]
        self.per_packet = command[8]
        clock_hz = (48e6 if command[11] & 8 else 4e6) / (256 if command[11] & 2 else 1)
        self.rate_hz = clock_hz / max(1, int.from_bytes(command[12:14], "little"))
        self.restart()

    def restart(self) -> None:
        """Nothing was sent yet."""
        self.packets = 0
        self.sent = 0
        self.dropped = 0
        # Samples from before an overflow that are still to be sent, 0 when there was none.
        self.kept = 0
        self.report = 0

    def scans_needed(self, packets: int = 1) -> int:
        """Scans, those dropped included, that have been taken when so many more packets can be sent."""
        return -(-(self.sent + packets * self.per_packet) // len(self.inputs)) + self.dropped

    def overflow(self, capacity: int) -> None:
        """Keep whole packets of whole scans, as many as fit."""
        step = math.lcm(self.per_packet, len(self.inputs))
        self.kept = (self.sent + capacity) // step * step - self.sent

    def resume(self, taken: int) -> None:
        """All that was kept is sent; what was taken since is dropped, and reported with the next packet."""
        self.report = max(0, taken - self.sent // len(self.inputs) - self.dropped)
        self.dropped += self.report
