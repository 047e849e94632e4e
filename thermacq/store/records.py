"""What a run file holds, as plain values: header, streams, rows, events, and what a reader hands back."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import FrameFlag


class EventKind(StrEnum):
    """What can happen during a recording; every loss has its cause here."""

    LATE_TRIGGER = "late_trigger"
    RING_FULL = "ring_full"
    DEVICE_GAP = "device_gap"
    INCOMPLETE = "incomplete"
    OVERRUN = "overrun"
    DISCONNECTED = "disconnected"
    TIMEOUT = "timeout"
    RECONNECTED = "reconnected"
    SHUTTER = "shutter"
    PROBE_GAP = "probe_gap"
    WRITER_LATE = "writer_late"
    STOPPED = "stopped"
    DISK_RESERVE = "disk_reserve"
    NOTE = "note"


LOSS_KINDS = frozenset(
    {
        EventKind.LATE_TRIGGER,
        EventKind.RING_FULL,
        EventKind.DEVICE_GAP,
        EventKind.INCOMPLETE,
        EventKind.OVERRUN,
        EventKind.PROBE_GAP,
        EventKind.WRITER_LATE,
        EventKind.RECONNECTED,
    }
)
"""Events that explain why frames or samples are missing."""


@dataclass(frozen=True)
class CameraStream:
    """A camera as it took part in a run; the three dictionaries hold JSON values only."""

    name: str
    rows: int
    columns: int
    identity: dict[str, Any] = field(default_factory=dict)
    applied: dict[str, Any] = field(default_factory=dict)
    capabilities: dict[str, Any] = field(default_factory=dict)

    @property
    def serial(self) -> str:
        """Serial number; empty where the device has none."""
        return str(self.identity.get("serial", ""))


@dataclass(frozen=True)
class ProbeStream:
    """A wave probe as it took part in a run; `tick_rate_hz` is 0 when its samples are only counted."""

    name: str
    channels: tuple[str, ...]
    unit: str
    tick_rate_hz: float
    identity: dict[str, Any] = field(default_factory=dict)
    applied: dict[str, Any] = field(default_factory=dict)
    capabilities: dict[str, Any] = field(default_factory=dict)

    @property
    def serial(self) -> str:
        """Serial number; empty where the device has none."""
        return str(self.identity.get("serial", ""))


@dataclass(frozen=True)
class RunHeader:
    """What is known about a run when it begins.

    Parameters
    ----------
    run_id
        UUID of the run.
    title
        Free text.
    start_time
        Wall clock at the start, ISO 8601, UTC.
    wall_anchor_ns, host_anchor_ns
        Unix time and host time of the same instant, the zero of the recording's seconds.
    clock
        Whether host time is the machine's monotonic clock or a virtual one.
    simulated
        Whether any device was simulated or emulated.
    rig
        The resolved rig, ``Rig.model_dump(mode="json")``.
    calibration
        The stereo calibration that belongs to the run, or None.
    versions
        Versions of the software and drivers.
    emulated
        Names of the devices that emulators played in place of hardware.
    triggers_reckoned
        Whether the trigger source reckoned the times of its pulses instead of observing them; see
        `thermacq.store.trigger_line`.
    """

    run_id: str
    title: str
    start_time: str
    wall_anchor_ns: int
    host_anchor_ns: int
    clock: Literal["real", "virtual"]
    simulated: bool
    rig: dict[str, Any]
    calibration: dict[str, Any] | None = None
    versions: dict[str, str] = field(default_factory=dict)
    emulated: tuple[str, ...] = ()
    triggers_reckoned: bool = False


@dataclass(slots=True)
class FrameRow:
    """What is stored beside each picture.

    Parameters
    ----------
    counter
        Frame counter of the device as delivered (it wraps); -1 when there is none.
    ticks
        Device clock at the start of exposure; -1 when there is none.
    host_ns
        Host time of receipt.
    trigger_index
        Index of the trigger that made the frame; -1 when unknown.
    trigger_ns
        Host time of that trigger (deadline or pulse); -1 when unknown.
    flags
        Bits of `thermacq.devices.FrameFlag`.
    fpa_temperature_k
        Temperature of the focal-plane array; NaN when unknown.
    """

    counter: int
    ticks: int
    host_ns: int
    trigger_index: int = -1
    trigger_ns: int = -1
    flags: int = 0
    fpa_temperature_k: float = float("nan")


@dataclass(frozen=True)
class Event:
    """Something that happened to a device during the run.

    `index` is the trigger or frame concerned, -1 when none; `detail` is cut to 200 bytes.
    """

    host_ns: int
    device: str
    kind: EventKind
    index: int = -1
    detail: str = ""


@dataclass(frozen=True)
class FrameTable:
    """One row per committed frame of a camera; every array is (frames,).

    `sequence_number` is the counter without its wraps, or the row where the device has no counter;
    a step greater than 1 means lost frames. After the camera was away (flag 4) it goes on by 1; the event
    ``reconnected`` tells how many frames are missing there. `crc32` is that of the raw counts. Seconds of the
    recording are ``(ns - header.host_anchor_ns) / 1e9``.
    """

    counter: NDArray[np.int64]
    sequence_number: NDArray[np.int64]
    ticks: NDArray[np.int64]
    host_ns: NDArray[np.int64]
    trigger_index: NDArray[np.int64]
    trigger_ns: NDArray[np.int64]
    flags: NDArray[np.uint32]
    fpa_temperature_k: NDArray[np.float64]
    crc32: NDArray[np.uint32]

    @property
    def restarts_ns(self) -> NDArray[np.int64]:
        """(restarts,) host times from which counter and ticks count anew, because the camera had been away."""
        restarted: NDArray[np.int64] = self.host_ns[(self.flags & FrameFlag.RESTARTED) != 0]
        return restarted

    def __len__(self) -> int:
        return len(self.counter)


@dataclass(frozen=True)
class ProbeSamples:
    """All committed samples of a probe.

    Parameters
    ----------
    values
        (samples, channels) float64, raw unit of the probe.
    ticks
        (samples,) int64, device clock.
    index
        (samples,) int64, the device's own count; a step greater than 1 means lost samples. After the probe
        was away it goes on by 1.
    host_ns
        (samples,) int64, host time at which the block of the sample was received.
    pulse_ticks
        (pulses,) int64, device clock at the cameras' trigger pulses.
    channels, unit, tick_rate_hz
        As in `ProbeStream`.
    restarts_ns
        Host times from which the device clock counts anew, because the probe had been away.
    """

    values: NDArray[np.float64]
    ticks: NDArray[np.int64]
    index: NDArray[np.int64]
    host_ns: NDArray[np.int64]
    pulse_ticks: NDArray[np.int64]
    channels: tuple[str, ...]
    unit: str
    tick_rate_hz: float
    restarts_ns: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.ticks)
