"""The recorder's children: how they are spawned, watched, and ended."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from thermacq.acquisition.board import Board, Cell
from thermacq.acquisition.device_process import device_main
from thermacq.acquisition.messages import Armed, Away, Back, DeviceSpec, Ended, Opened
from thermacq.acquisition.shared import SharedBlock
from thermacq.acquisition.writer import writer_main
from thermacq.errors import DeviceDisconnected, DeviceFault
from thermacq.timing import NS_PER_S

_TERMINATION_S = 1.0
# Vendor libraries do not survive a fork; nothing of ours relies on one.
_SPAWN = multiprocessing.get_context("spawn")


class Child:
    """A spawned process and the pipe to it."""

    def __init__(self, name: str, process: BaseProcess, pipe: Connection) -> None:
        self.name = name
        self.process = process
        self.pipe = pipe
        self.gone = False

    def receive(self) -> list[Any]:
        """Messages that have come; notices when the child is gone and nothing more can come."""
        messages = []
        dead = not self.process.is_alive()
        try:
            while self.pipe.poll(0):
                messages.append(self.pipe.recv())
        except (EOFError, OSError):
            dead = True
        self.gone = self.gone or dead
        return messages

    def send(self, message: object) -> None:
        """Send a message; a dead child is noticed elsewhere."""
        with suppress(OSError):
            self.pipe.send(message)

    def obituary(self) -> str:
        """How the process ended, in words."""
        self.process.join(_TERMINATION_S)
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"its process was killed by {signal.Signals(-code).name}"
        return f"its process ended with status {code}"

    def end(self) -> None:
        """End the process, by force if it must be; legal at any time."""
        if self.process.is_alive():
            self.process.terminate()
            self.process.join(_TERMINATION_S)
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.pipe.close()


@dataclass
class Outage:
    """A time for which a device was away."""

    device: str
    lost_ns: int
    why: str
    back: Back | None = None
    latest: str = ""

    @property
    def tidings(self) -> list[str]:
        """What the user should know of it."""
        told = [self.why]
        if self.back is not None:
            told.append(
                f"device '{self.device}' was away for {self.back.away_s:.1f} s and missed {self.back.missed}"
            )
        elif self.latest != self.why:
            told.append(self.latest)
        return told

    def to_dict(self, start_ns: int) -> dict[str, Any]:
        """Plain values for the summary of the run; seconds are those of the recording."""
        told: dict[str, Any] = {
            "device": self.device,
            "lost_s": round((self.lost_ns - start_ns) / NS_PER_S, 3),
            "why": self.why,
            "came_back": self.back is not None,
        }
        if self.back is not None:
            told |= {
                "back_s": round((self.back.host_ns - start_ns) / NS_PER_S, 3),
                "away_s": round(self.back.away_s, 3),
                "missed": self.back.missed,
                "changed": {key: self.back.applied.get(key) for key in self.back.changed},
            }
        return told


@dataclass
class DeviceChild:
    """A device process and what it has said so far."""

    spec: DeviceSpec
    child: Child
    block: SharedBlock
    opened: Opened | None = None
    armed: Armed | None = None
    ended: bool = False
    fault: DeviceFault | None = None
    lost_s: float | None = None
    outages: list[Outage] = field(default_factory=list)
    _heartbeat: int = -1
    _heard_s: float = field(default_factory=time.monotonic)

    @property
    def name(self) -> str:
        """Name in the rig."""
        return self.spec.name

    @property
    def over(self) -> bool:
        """Whether nothing more can come from it."""
        return self.ended or self.fault is not None

    @property
    def state(self) -> str:
        """State for the status display."""
        if self.fault is not None:
            return "lost"
        if self.ended:
            return "ended"
        if self.away:
            return "reconnecting"
        return "armed" if self.armed else "open" if self.opened else "starting"

    @property
    def away(self) -> Outage | None:
        """The outage of now."""
        return self.outages[-1] if self.outages and self.outages[-1].back is None else None

    def listen(self) -> None:
        """Take in what the device said, or that its process is gone."""
        for message in self.child.receive():
            if isinstance(message, Opened):
                self.opened = message
            elif isinstance(message, Armed):
                self.armed = message
            elif isinstance(message, Away):
                self._take_outage(message)
            elif isinstance(message, Back) and self.away:
                self.away.back = message
            elif isinstance(message, Ended):
                self.ended = True
                self.fault = self.fault or message.fault
        if self.child.gone and not self.over:
            self.fault = DeviceDisconnected(self.name, "acquire", self.child.obituary())
        if self.fault is not None and self.lost_s is None:
            self.lost_s = time.monotonic()

    def _take_outage(self, message: Away) -> None:
        if self.away is None:
            self.outages.append(Outage(self.name, message.host_ns, message.why))
        self.outages[-1].latest = message.why

    def give_up(self, fault: DeviceFault) -> None:
        """Count the device as lost: it was ended by force."""
        self.fault = self.fault or fault
        self.lost_s = self.lost_s or time.monotonic()

    def silent_s(self, board: Board) -> float:
        """How long the device has given no sign of life."""
        heartbeat = board.get(self.spec.index, Cell.HEARTBEAT)
        if heartbeat != self._heartbeat:
            self._heartbeat, self._heard_s = heartbeat, time.monotonic()
        return time.monotonic() - self._heard_s


def faults_of(devices: Sequence[DeviceChild]) -> str:
    """What those of them that are lost said last."""
    return "; ".join(device.fault.what for device in devices if device.fault)


def spawn_device(spec: DeviceSpec, board: Board) -> tuple[DeviceChild, Connection]:
    """Spawn a device process; also returns the writer's end of its mail."""
    ours, theirs = _SPAWN.Pipe()
    mail_in, mail_out = _SPAWN.Pipe(duplex=False)
    block = SharedBlock()
    process = _SPAWN.Process(
        target=device_main, args=(spec, board, block, theirs, mail_out), name=spec.name, daemon=True
    )
    process.start()
    # Only the child may hold these ends: when it dies, everybody sees the pipes close.
    theirs.close()
    mail_out.close()
    return DeviceChild(spec, Child(spec.name, process, ours), block), mail_in


def spawn_writer(devices: list[DeviceChild], board: Board, mail: dict[str, Connection]) -> Child:
    """Spawn the writer process, which takes over the mail of the devices."""
    ours, theirs = _SPAWN.Pipe()
    blocks = {device.name: device.block for device in devices}
    names = [device.name for device in devices]
    process = _SPAWN.Process(
        target=writer_main, args=(names, board, blocks, mail, theirs), name="writer", daemon=True
    )
    process.start()
    theirs.close()
    for pipe in mail.values():
        pipe.close()
    return Child("writer", process, ours)
