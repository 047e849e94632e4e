"""What the processes of a recording say to each other through pipes: small frozen records."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from thermacq.devices import (
    CameraCapabilities,
    DeviceIdentity,
    DeviceKind,
    ProbeCapabilities,
    SampleBlock,
    Settings,
    TriggerCapabilities,
    TriggerMode,
)
from thermacq.errors import DeviceFault, StoreError
from thermacq.rig import ReconnectTable, StoreTable
from thermacq.store import CameraStream, ProbeStream, RunHeader
from thermacq.timing import ClockSettings

if TYPE_CHECKING:
    from thermacq_calibration import CameraCorrection

Capabilities: TypeAlias = CameraCapabilities | ProbeCapabilities | TriggerCapabilities


class EndReason(StrEnum):
    """Why a recording ended."""

    COMPLETED = "completed"
    STOPPED = "stopped"
    CAMERA_LOST = "camera_lost"
    TRIGGER_LOST = "trigger_lost"
    DISK_RESERVE = "disk_reserve"
    RECORDER_LOST = "recorder_lost"
    WRITER_LOST = "writer_lost"


ASKED_FOR = frozenset({EndReason.COMPLETED, EndReason.STOPPED})
"""Endings that somebody wanted."""


@dataclass(frozen=True)
class DeviceSpec:
    """Which device a device process shall run; `index` is its row on the board.

    `emulation` holds the settings of the emulator that plays it; None runs the real (or simulated) one.
    """

    index: int
    name: str
    kind: DeviceKind
    driver: str
    settings: Settings
    scene: Settings
    clock: ClockSettings
    runtime_dir: Path
    recorder_pid: int
    core: int | None = None
    serial: str = ""
    emulation: Settings | None = None
    reconnect: ReconnectTable = field(default_factory=ReconnectTable)


@dataclass(frozen=True)
class Opened:
    """Device to recorder: it is open and configured."""

    identity: DeviceIdentity
    applied: dict[str, Any]
    capabilities: Capabilities


@dataclass(frozen=True)
class ArmOrder:
    """Recorder to device: get ready.

    Parameters
    ----------
    mode, rate_hz
        Who triggers the cameras, and how often.
    count
        Frames (triggers, pulses) to make; None until told to stop.
    end_ns
        Virtual or free-running time, counted from the start, after which no more is wanted; None: no end.
    late_after_ns
        A software trigger later than this is skipped.
    slots
        Length of the camera's ring.
    """

    mode: TriggerMode
    rate_hz: float
    count: int | None
    end_ns: int | None
    late_after_ns: int
    slots: int


@dataclass(frozen=True)
class Armed:
    """Device to recorder: it is ready; `scheduling` says what priority its triggers get."""

    scheduling: str = ""


@dataclass(frozen=True)
class Away:
    """Device to recorder: it was lost and is being brought back, or this is why it cannot be yet."""

    host_ns: int
    why: str


@dataclass(frozen=True)
class Back:
    """Device to recorder: it delivers again.

    Parameters
    ----------
    host_ns
        Host time from which it is the restarted device that delivers.
    away_s
        From the loss to the first frame, sample or pulse.
    missed
        Frames, samples or pulses that are missing; for what has no index, reckoned from the time.
    applied
        Settings in force now.
    changed
        Those of them that differ from the ones before.
    """

    host_ns: int
    away_s: float
    missed: int
    applied: dict[str, Any]
    changed: tuple[str, ...]


@dataclass(frozen=True)
class Ended:
    """Device to recorder: its part is over, by a fault or as planned."""

    fault: DeviceFault | None = None


@dataclass(frozen=True)
class Samples:
    """Probe to writer: a checked block."""

    block: SampleBlock


@dataclass(frozen=True)
class Pulse:
    """Trigger source to writer: a pulse was emitted."""

    index: int
    host_ns: int


@dataclass(frozen=True)
class CreateOrder:
    """Recorder to writer: make the file."""

    path: Path
    header: RunHeader
    cameras: tuple[CameraStream, ...]
    probes: tuple[ProbeStream, ...]
    store: StoreTable
    slots: int
    mode: TriggerMode
    corrections: dict[str, CameraCorrection] = field(default_factory=dict)


@dataclass(frozen=True)
class Created:
    """Writer to recorder: the file is there."""


@dataclass(frozen=True)
class FinishOrder:
    """Recorder to writer: close the file once everything is written."""

    end_reason: EndReason
    message: str
    summary: dict[str, Any] = field(default_factory=dict)
    outages: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True)
class DiskReserve:
    """Writer to recorder: the disk is filled to its reserve."""


@dataclass(frozen=True)
class WriterEnded:
    """Writer to recorder: the file is closed, well or not."""

    summary: dict[str, Any]
    error: StoreError | None = None


def plain(value: Any) -> Any:
    """Turn records, enumerations and sets into values that JSON can hold."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {item.name: getattr(value, item.name) for item in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (set, frozenset)):
        return sorted(plain(item) for item in value)
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (Enum, np.generic)):
        return value.value if isinstance(value, Enum) else value.item()
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)
