"""The serial side of the emulated Boson: FSLP frames in, replies out."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from thermacq.testing.emulators.boson import BosonCore

_START, _ESCAPE, _END = 0x8E, 0x9E, 0xAE
# Escaped bytes lose 0x0D: 8E -> 81, 9E -> 91, AE -> A1.
_SHIFT = 0x0D
_OK, _BAD_COMMAND, _TOO_FEW, _RANGE, _NOT_ENABLED = 0, 0x0161, 0x017D, 0x0203, 0x01B0


def checksum(data: bytes) -> int:
    """CRC-16 with polynomial 0x1021 from 0x1D0F, bit by bit."""
    register = 0x1D0F
    for byte in data:
        register ^= byte << 8
        for _ in range(8):
            register = (register << 1 ^ 0x1021 if register & 0x8000 else register << 1) & 0xFFFF
    return register


def wrap(content: bytes) -> bytes:
    """Channel and payload as they go over the wire."""
    out = bytearray()
    for byte in content + struct.pack(">H", checksum(content)):
        out += bytes((_ESCAPE, byte - _SHIFT)) if byte in (_START, _ESCAPE, _END) else bytes((byte,))
    return bytes((_START, *out, _END))


def unwrap(wire: bytes) -> bytes | None:
    """Channel and payload between the marks; None when the checksum does not fit."""
    out = bytearray()
    escaped = False
    for byte in wire:
        if byte == _ESCAPE:
            escaped = True
        else:
            out.append((byte + _SHIFT) & 0xFF if escaped else byte)
            escaped = False
    content = bytes(out[:-2])
    good = len(out) > 2 and int.from_bytes(out[-2:], "big") == checksum(content)
    return content if good else None


def _ignore(value: int) -> None:
    """Taken, without effect on what is emulated."""


class FslpPort:
    """`thermacq.testing.emulation.pty.SerialDevice` over the camera's core."""

    def __init__(self, core: BosonCore) -> None:
        self._core = core
        self._buffer = b""
        self._gets: dict[int, Callable[[], bytes]] = {
            0x00050002: lambda: struct.pack(">I", core.serial),
            0x00050004: core.part_number,
            0x00050006: lambda: struct.pack(">I", core.serial + 1000),
            0x00050013: lambda: struct.pack(">i", core.ffc_mode),
            0x00050015: lambda: struct.pack(">i", core.gain),
            0x00050022: lambda: struct.pack(">3I", 3, 0, 26853),
            0x00050030: lambda: struct.pack(">h", round(10 * core.settings.fpa_celsius)),
            0x00050031: lambda: struct.pack(">H", round(10 * (core.settings.fpa_celsius + 273.15))),
            0x00050054: lambda: struct.pack(">i", core.ffc_status()),
            0x00050099: lambda: struct.pack(">i", core.sync),
            0x000500AC: lambda: struct.pack(">I", core.counter % 2**32),
            0x000E0007: lambda: struct.pack(">I", 60),
        }
        # Function, highest value, what it sets.
        self._sets: dict[int, tuple[int, Callable[[int], None]]] = {
            0x00050012: (3, self._setter("ffc_mode")),
            0x00050014: (4, self._setter("gain")),
            0x00050098: (2, core.set_sync),
            0x00040001: (1, self._setter("telemetry_on")),
            0x00040003: (1, self._setter("telemetry_location")),
            0x00040005: (2, self._setter("telemetry_packing")),
            0x00040007: (1, _ignore),
            0x000E000D: (2, _ignore),
        }

    def _setter(self, name: str) -> Callable[[int], None]:
        return lambda value: setattr(self._core, name, value)

    def power_up(self) -> None:
        """The core starts afresh."""
        self._buffer = b""
        self._core.power_up()

    def receive(self, data: bytes) -> Sequence[bytes]:
        """Answer each complete request; anything between frames is ignored."""
        self._buffer += data
        answers = []
        while _END in self._buffer:
            wire, _, self._buffer = self._buffer.partition(bytes((_END,)))
            begun = wire.rfind(_START)
            content = unwrap(wire[begun + 1 :]) if begun >= 0 else None
            if content is not None and len(content) >= 13 and content[0] == 0:
                answers.append(self._answer(content[1:]))
        self._buffer = self._buffer[-4096:]
        return answers

    def _answer(self, payload: bytes) -> bytes:
        sequence, function = struct.unpack(">II", payload[:8])
        with self._core.lock:
            status, data = self._obey(function, payload[12:])
        return wrap(b"\0" + struct.pack(">III", sequence, function, status) + data)

    def _obey(self, function: int, arguments: bytes) -> tuple[int, bytes]:
        """Status and data of the reply."""
        if function == 0x00050007:
            self._core.close_shutter(self._core.settings.ffc_s)
            return _OK, b""
        if function in self._gets:
            return _OK, self._gets[function]()
        if function not in self._sets:
            return _BAD_COMMAND, b""
        if function >> 16 == 0x0004 and self._core.settings.telemetry == "none":
            return _NOT_ENABLED, b""
        return self._set(function, arguments), b""

    def _set(self, function: int, arguments: bytes) -> int:
        """Status after setting something."""
        if len(arguments) < 4:
            return _TOO_FEW
        highest, setter = self._sets[function]
        value: int = struct.unpack(">i", arguments[:4])[0]
        if not 0 <= value <= highest:
            return _RANGE
        setter(value)
        return _OK

    def due_ns(self) -> int | None:
        """It only answers."""
        return None

    def act(self) -> Sequence[bytes]:
        """Nothing unasked."""
        return ()
