"""The serial side of a Boson: calls answered in order, and questions whose answers are fetched between frames."""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass

from thermacq.errors import DeviceFault, DeviceTimeout
from thermacq_drivers.boson.fslp import (
    COMMAND_CHANNEL,
    STATUS,
    FrameParser,
    Function,
    Reply,
    command,
    parse_reply,
)
from thermacq_drivers.transports.serial import SerialPort

_ANSWER_S = 1.0
_ATTEMPTS = 3
_WAIT_S = 0.05


class CommandRefused(DeviceFault):
    """The camera answered with a status that is not good; `status` holds it."""

    status = 0


@dataclass
class _Question:
    sequence: int
    function: Function
    asked_s: float


class BosonControl:
    """Functions of the camera over its serial port.

    A reply counts only when it has the sequence number and function of the call; late replies to calls that
    were given up are read and thrown away.

    Parameters
    ----------
    device
        Name of the device in the rig, for faults.
    port
        Its open serial port.
    """

    def __init__(self, device: str, port: SerialPort) -> None:
        self._device = device
        self._port = port
        self._parser = FrameParser()
        self._sequence = 0
        self._question: _Question | None = None
        # Counted for whoever wants to know how good the line is; late are second and foreign replies too.
        self.late_replies = 0
        self.unanswered = 0

    @property
    def damaged(self) -> int:
        """Frames that came damaged."""
        return self._parser.damaged

    def call(self, function: Function, layout: str = "", *values: int, stage: str) -> bytes:
        """Call a function and return the data of its answer; damaged or missing answers are asked for again.

        Parameters
        ----------
        function
            What to call.
        layout, values
            Its arguments, as for `struct.pack`, big-endian.
        stage
            Verb of the driver, for faults.

        Raises
        ------
        CommandRefused
            The camera answered that it will not.
        DeviceTimeout
            It did not answer.
        DeviceDisconnected
            The port is gone.
        """
        self._question = None
        arguments = struct.pack(">" + layout, *values)
        for _ in range(_ATTEMPTS):
            sequence = self._next_sequence()
            self._port.write(command(sequence, function, arguments), stage)
            reply = self._reply_to(sequence, function, stage)
            if reply is not None:
                return self._data(reply, function, stage)
            self.unanswered += 1
        what = f"no answer to {function.name.lower()} in {_ATTEMPTS} attempts"
        remedy = "Switch the camera off and on; look whether another program talks to its serial port."
        raise DeviceTimeout(self._device, stage, what, remedy=remedy)

    def set(self, function: Function, value: int, stage: str) -> None:
        """Call a function with one 32-bit argument."""
        self.call(function, "i", value, stage=stage)

    def tell(self, function: Function, value: int, stage: str) -> None:
        """Set something without waiting for the answer: for partings."""
        self._port.write(command(self._next_sequence(), function, struct.pack(">i", value)), stage)

    def begin(self, function: Function, stage: str) -> None:
        """Ask without waiting; `answer` fetches what comes."""
        sequence = self._next_sequence()
        self._question = _Question(sequence, function, time.monotonic())
        self._port.write(command(sequence, function), stage)

    @property
    def is_waiting(self) -> bool:
        """Whether a question of `begin` is still open."""
        return self._question is not None

    def answer(self, stage: str) -> tuple[Function, bytes] | None:
        """Answer to the open question if it is there; does not wait. An unanswered question is given up."""
        question = self._question
        if question is None:
            return None
        reply = self._arrived_for(question.sequence, question.function, 0.0, stage)
        if reply is not None:
            self._question = None
            return (question.function, reply.data) if reply.status == 0 else None
        if time.monotonic() - question.asked_s > _ANSWER_S:
            self._question = None
            self.unanswered += 1
        return None

    def _next_sequence(self) -> int:
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        return self._sequence

    def _reply_to(self, sequence: int, function: Function, stage: str) -> Reply | None:
        deadline_s = time.monotonic() + _ANSWER_S
        damaged_before = self.damaged
        # A damaged answer will not come any better: no need to wait for the deadline.
        while time.monotonic() < deadline_s and self.damaged == damaged_before:
            reply = self._arrived_for(sequence, function, _WAIT_S, stage)
            if reply is not None:
                return reply
        return None

    def _arrived_for(self, sequence: int, function: Function, wait_s: float, stage: str) -> Reply | None:
        """The reply to this call in what has arrived; other channels of the port are none of ours."""
        frames = self._parser.feed(self._port.read_some(wait_s, stage))
        replies = [parse_reply(payload) for channel, payload in frames if channel == COMMAND_CHANNEL]
        wanted = (sequence, function)
        fitting = [reply for reply in replies if reply and (reply.sequence, reply.function) == wanted]
        self.late_replies += len(replies) - bool(fitting)
        return fitting[0] if fitting else None

    def _data(self, reply: Reply, function: Function, stage: str) -> bytes:
        if reply.status == 0:
            return reply.data
        meaning = STATUS.get(reply.status, "unknown status")
        what = f"{function.name.lower()} was refused: {meaning} (0x{reply.status:04X})"
        refused = CommandRefused(self._device, stage, what)
        refused.status = reply.status
        raise refused
