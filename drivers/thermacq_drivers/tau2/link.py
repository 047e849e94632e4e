"""One camera behind its grabber: the stream over FTDI's chip, and questions over the serial port inside it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from thermacq.devices import Counts
from thermacq.errors import DeviceFault, DeviceTimeout
from thermacq.timing.clock import Clock
from thermacq_drivers.tau2 import packets, teax
from thermacq_drivers.tau2.packets import Answer, AnswerFinder, Function, Sensor
from thermacq_drivers.tau2.teax import StreamFinder
from thermacq_drivers.transports.usb import UsbPort, UsbStalled

# Large reads leave few gaps in which the grabber has to keep what comes; each lasts some milliseconds.
_READ_BYTES = 256 * teax.PACKET_BYTES
_SLICE_S = 0.05
_WRITE_S = 1.0
_ANSWER_S = 1.5
_TRIES = 3
_MOST_KEPT = 4

_T = TypeVar("_T")


class CommandRefused(DeviceFault):
    """The camera answered that it cannot do this."""


@dataclass(frozen=True)
class Shot:
    """One picture, (rows, columns) uint16, and the host time when it was there."""

    counts: Counts
    host_ns: int


class TauLink:
    """The open grabber of one camera.

    Parameters
    ----------
    device
        Name of the device in the rig, for faults.
    port
        The grabber, opened.
    clock
        Host clock.
    """

    def __init__(self, device: str, port: UsbPort, clock: Clock) -> None:
        self._name = device
        self._clock = clock
        self.port = port
        self.shots: deque[Shot] = deque(maxlen=_MOST_KEPT)
        self.answers: deque[Answer] = deque(maxlen=_MOST_KEPT)
        self._restart()

    def _restart(self) -> None:
        self._stream, self._answer_finder = StreamFinder(), AnswerFinder()
        self._told_damaged = 0
        self.shots.clear()
        self.answers.clear()

    def begin(self, stage: str) -> None:
        """Set the chip up: the stream runs from now on."""
        self._request(teax.RESET, teax.RESET_ALL, stage)
        self._request(teax.SET_BITMODE, teax.BITMODE_RESET, stage)
        self._request(teax.SET_BITMODE, teax.BITMODE_SYNC_FIFO, stage)
        self._request(teax.SET_LATENCY, teax.LATENCY_MS, stage)
        self.forget(stage)

    def forget(self, stage: str) -> None:
        """Forget what has come so far."""
        self._request(teax.RESET, teax.PURGE_RECEIVED, stage)
        self._restart()

    def close(self) -> None:
        """Stop the stream and let go of the grabber."""
        with suppress(DeviceFault):
            self._request(teax.SET_BITMODE, teax.BITMODE_RESET, "close")
        self.port.close()

    def _request(self, request: int, value: int, stage: str) -> None:
        self.port.control_out(teax.OUT, request, value, teax.INTERFACE_A, b"", stage)

    def read(self, stage: str) -> int:
        """Read once; pictures go to `shots`, answers to `answers`. Returns how many frames came damaged."""
        try:
            data = self.port.bulk_read(teax.STREAM_IN, _READ_BYTES, _SLICE_S, stage)
        except DeviceTimeout:
            return 0
        except UsbStalled:
            self.port.clear_halt(teax.STREAM_IN, stage)
            return 1
        pictures = self._stream.feed(teax.without_status(data))
        now_ns = self._clock.now_ns()
        self.shots.extend(Shot(counts, now_ns) for counts in pictures)
        self.answers.extend(self._answer_finder.feed(bytes(self._stream.serial)))
        self._stream.serial.clear()
        damaged, self._told_damaged = self._stream.damaged - self._told_damaged, self._stream.damaged
        return damaged

    def tell(self, packet: bytes, stage: str) -> None:
        """Send a packet and wait for nothing."""
        self.port.bulk_write(teax.STREAM_OUT, teax.to_serial_port(packet), _WRITE_S, stage)

    def call(self, function: Function, data: bytes, stage: str) -> bytes:
        """Send a packet and wait for its answer; a packet or answer that was damaged is tried again.

        Raises
        ------
        CommandRefused
            The camera answered with an error.
        DeviceTimeout
            It did not answer.
        """
        for _ in range(_TRIES):
            self.answers.clear()
            self.tell(packets.packet(function, data), stage)
            answer = self._await(function, stage)
            if answer is not None:
                return self._content(answer, stage)
        what = f"the camera did not answer to function {function:02x} through the grabber"
        remedy = "Is the camera's power on, and this USB device really a TeAx grabber with a Tau 2?"
        raise DeviceTimeout(self._name, stage, what, remedy=remedy)

    def _await(self, function: int, stage: str) -> Answer | None:
        deadline_s = time.monotonic() + _ANSWER_S
        while time.monotonic() < deadline_s:
            while self.answers:
                answer = self.answers.popleft()
                if answer.function == function:
                    return answer
            self.read(stage)
        return None

    def _content(self, answer: Answer, stage: str) -> bytes:
        if answer.status:
            why = packets.STATUS_WORDS.get(answer.status, "unknown status")
            what = f"the camera refused function {answer.function:02x}: {why} (status {answer.status:02x})"
            raise CommandRefused(self._name, stage, what)
        return answer.data

    def set_word(self, function: Function, value: int, stage: str) -> None:
        """Set a value and check what the camera says is in force."""
        there = self.number(self.call(function, packets.word(value), stage), stage)
        if there != value:
            what = f"function {function:02x} was set to {value}, but {there} is in force"
            raise DeviceFault(self._name, stage, what)

    def number(self, data: bytes, stage: str) -> int:
        """A number in an answer."""
        return self._parsed(packets.parse_word, data, stage)

    def temperature_k(self, sensor: Sensor, stage: str) -> float:
        """Ask for a temperature, kelvin."""
        data = self.call(Function.READ_SENSOR, packets.word(sensor), stage)
        return self._parsed(lambda content: packets.parse_temperature(content, sensor), data, stage)

    def serial_number(self, stage: str) -> int:
        """Serial number of the camera."""
        return self._parsed(packets.parse_serial, self.call(Function.SERIAL_NUMBER, b"", stage), stage)[0]

    def _parsed(self, parse: Callable[[bytes], _T], data: bytes, stage: str) -> _T:
        try:
            return parse(data)
        except ValueError as error:
            raise DeviceFault(self._name, stage, f"an answer has the wrong length: {error}") from None
