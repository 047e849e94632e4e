"""Requests to a LabJack U6 and its answers, over USB; which of several devices is meant."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from thermacq.devices import DeviceIdentity
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.transports import Transports
from thermacq_drivers.labjack_u6 import codec
from thermacq_drivers.labjack_u6.codec import Individual
from thermacq_drivers.transports.usb import UsbPort, find_devices

IDS = ((codec.VID, codec.PID),)
_ANSWER_S = 1.0
_STALE_S = 0.01
_MOST_STALE_READS = 200


class Link:
    """One device, opened.

    Parameters
    ----------
    name
        Name in the rig, for faults.
    transports
        How to reach it.
    device
        One of `find_devices`.
    """

    def __init__(self, name: str, transports: Transports, device: Any) -> None:
        self._name = name
        self._port = UsbPort(name, transports, IDS, among=[device])

    def ask(self, command: bytes, stage: str) -> bytes:
        """Send a command and return the reply, unchecked."""
        self._port.bulk_write(codec.OUT_ENDPOINT, command, _ANSWER_S, stage)
        return self._port.bulk_read(codec.REPLY_ENDPOINT, codec.PACKET_BYTES, _ANSWER_S, stage)

    def individual(self) -> Individual:
        """Which device it is."""
        self._discard(codec.REPLY_ENDPOINT)
        return codec.parse_config(self.ask(codec.config_read(), "open"))

    def calibration_blocks(self) -> list[tuple[float, ...]]:
        """The blocks that `codec.calibration_from` takes; `ValueError` when a reply is damaged."""
        return [
            codec.parse_memory(self.ask(codec.memory_read(block), "configure"))
            for block in codec.CALIBRATION_BLOCKS
        ]

    def configure_stream(self, command: bytes) -> int:
        """Send a StreamConfig and return the error code, after ending a stream that was left running."""
        for _ in range(2):
            error = codec.parse_extended(self.ask(command, "configure"), codec.STREAM_CONFIG, 8)[6]
            if error != codec.STREAM_IS_ACTIVE:
                break
            self.stop_stream("configure")
        return error

    def start_stream(self) -> int:
        """Start the stream and return the error code, after ending one that was left running."""
        self._discard(codec.STREAM_ENDPOINT)
        for _ in range(2):
            answer = self.ask(codec.STREAM_START, "acquire")
            error = codec.parse_short(answer, codec.STREAM_START)
            if error != codec.STREAM_IS_ACTIVE:
                break
            self.stop_stream("acquire")
        return error

    def stop_stream(self, stage: str) -> None:
        """End the stream, if one runs, and forget what it left."""
        with suppress(ValueError):
            codec.parse_short(self.ask(codec.STREAM_STOP, stage), codec.STREAM_STOP)
        self._discard(codec.STREAM_ENDPOINT)

    def read_stream(self, length: int, timeout_s: float) -> bytes:
        """Bytes of the stream; faults as those of `UsbPort`."""
        return self._port.bulk_read(codec.STREAM_ENDPOINT, length, timeout_s, "acquire")

    def clear_stream(self) -> None:
        """Let a stalled stream go on."""
        self._port.clear_halt(codec.STREAM_ENDPOINT, "acquire")

    def close(self) -> None:
        """Let go of the device; never raises."""
        self._port.close()

    def _discard(self, endpoint: int) -> None:
        with suppress(DeviceTimeout):
            for _ in range(_MOST_STALE_READS):
                self._port.bulk_read(endpoint, 64 * codec.PACKET_BYTES, _STALE_S, "open")


def find(name: str, transports: Transports, serial: str) -> tuple[Link, Individual]:
    """Open the device with this serial number (empty: the only one), asking each for its own.

    Raises
    ------
    DeviceDisconnected
        There is none, or not that one.
    DeviceFault
        Several are attached and nothing says which, or the one may not be opened.
    """
    fitting: list[tuple[Link, Individual]] = []
    seen: list[str] = []
    refusals: list[DeviceFault] = []
    for device in find_devices(transports, IDS):
        try:
            link = Link(name, transports, device)
        except DeviceFault as fault:
            refusals.append(fault)
            continue
        individual = _ask_who(link, name)
        seen.append(individual.serial)
        if serial in ("", individual.serial):
            fitting.append((link, individual))
        else:
            link.close()
    if len(fitting) == 1:
        return fitting[0]
    for link, _ in fitting:
        link.close()
    if fitting:
        what = f"several devices are attached: {', '.join(seen)}"
        raise DeviceFault(name, "open", what, remedy="Say in the rig which one is meant: its serial.")
    if refusals:
        raise refusals[0]
    what = f"no LabJack U6 with serial number '{serial}'" if serial else "no LabJack U6 was found on USB"
    raise DeviceDisconnected(
        name,
        "open",
        f"{what}; attached: {', '.join(seen) or 'none'}",
        remedy="Check power and cable; `thermacq devices` lists what is attached.",
    )


def _ask_who(link: Link, name: str) -> Individual:
    try:
        return link.individual()
    except (ValueError, DeviceFault) as error:
        link.close()
        if isinstance(error, DeviceFault):
            raise
        raise DeviceFault(name, "open", str(error), remedy="Unplug it and plug it in again.") from None


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Devices on USB, each asked for its serial number; one that another program uses is listed without."""
    found = []
    for device in find_devices(transports, IDS):
        individual = Individual("", "U6", "")
        with suppress(DeviceFault):
            link = Link("labjack_u6", transports, device)
            individual = _ask_who(link, "labjack_u6")
            link.close()
        found.append(DeviceIdentity("labjack_u6", individual.model, individual.serial, individual.firmware))
    return found
