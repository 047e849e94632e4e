"""What the writer remembers of a run while it writes it: the times that the sync report is made from."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import FrameFlag, SampleBlock, TriggerMode
from thermacq.store import CameraStream, FrameRow, ProbeStream
from thermacq.timing import (
    CameraEvidence,
    DeviceTimes,
    ProbeEvidence,
    fit_device_clock,
    line_of_probes,
    sync_report,
    unwrap_counter,
)

_PULSES_REMEMBERED = 4096


class FrameLog:
    """Times and counters of all frames of a camera; 40 bytes each."""

    def __init__(self) -> None:
        self._words = array("q")
        self.restarts_ns: list[int] = []

    def note(self, row: FrameRow) -> None:
        """Remember a frame, and whether the camera's clock began anew with it."""
        if row.flags & FrameFlag.RESTARTED:
            self.restarts_ns.append(row.host_ns)
        self._words.extend((row.trigger_index, row.trigger_ns, row.ticks, row.host_ns, row.counter))

    def _column(self, column: int) -> NDArray[np.int64]:
        return np.array(self._words, np.int64).reshape(-1, 5)[:, column]

    @property
    def trigger_index(self) -> NDArray[np.int64]:
        """(frames,) int64."""
        return self._column(0)

    @property
    def trigger_ns(self) -> NDArray[np.int64]:
        """(frames,) int64."""
        return self._column(1)

    @property
    def ticks(self) -> NDArray[np.int64]:
        """(frames,) int64."""
        return self._column(2)

    @property
    def host_ns(self) -> NDArray[np.int64]:
        """(frames,) int64."""
        return self._column(3)

    @property
    def counter(self) -> NDArray[np.int64]:
        """(frames,) int64, as delivered."""
        return self._column(4)


class ProbeLog:
    """Last tick and receipt time of each block of a probe, and the trigger pulses that it stamped."""

    def __init__(self) -> None:
        self._ticks = array("q")
        self._host_ns = array("q")
        self._pulses = array("q")
        self._sample_ticks = 0
        self.restarts_ns: list[int] = []

    def note(self, block: SampleBlock) -> None:
        """Remember a block."""
        if block.ticks.size:
            self._ticks.append(int(block.ticks[-1]))
            self._host_ns.append(block.host_ns)
        if block.ticks.size > 1:
            self._sample_ticks = int(block.ticks[1] - block.ticks[0])
        self._pulses.extend(block.pulse_ticks.tolist())

    def clock(self, tick_rate_hz: float, trigger_ns: NDArray[np.int64]) -> DeviceTimes | None:
        """Model of the probe's clock: from its pulses if it stamped any, else from receipt times."""
        if not self._ticks or tick_rate_hz <= 0:
            return None
        return fit_device_clock(
            np.array(self._ticks),
            np.array(self._host_ns),
            tick_rate_hz,
            self.restarts_ns,
            np.array(self._pulses, np.int64),
            trigger_ns,
        )

    def evidence(self, name: str, tick_rate_hz: float) -> ProbeEvidence:
        """What it says of the trigger line."""
        return ProbeEvidence(
            name,
            np.array(self._ticks, np.int64),
            np.array(self._host_ns, np.int64),
            tick_rate_hz,
            self._sample_ticks,
            np.array(self._pulses, np.int64),
            self.restarts_ns,
        )


class PulseLog:
    """The pulses that a trigger source emitted."""

    def __init__(self) -> None:
        self._recent: dict[int, int] = {}
        self._host_ns = array("q")
        self.latest = -1

    def note(self, index: int, host_ns: int) -> None:
        """Remember a pulse."""
        self._recent[index] = host_ns
        self._recent.pop(index - _PULSES_REMEMBERED, None)
        self._host_ns.append(host_ns)
        self.latest = max(self.latest, index)

    def time_of(self, index: int) -> int:
        """Host time of a recent pulse; -1 when it is not known."""
        return self._recent.get(index, -1)

    @property
    def host_ns(self) -> NDArray[np.int64]:
        """(pulses,) int64."""
        return np.array(self._host_ns, np.int64)


def camera_clock(stream: CameraStream, log: FrameLog) -> DeviceTimes | None:
    """Model of a camera's clock from the receipt times of its frames."""
    rate_hz = float(stream.capabilities.get("tick_rate_hz", 0.0))
    known = log.ticks >= 0
    if rate_hz <= 0 or not known.any():
        return None
    return fit_device_clock(log.ticks[known], log.host_ns[known], rate_hz, log.restarts_ns)


def camera_evidence(stream: CameraStream, log: FrameLog, clock: DeviceTimes | None) -> CameraEvidence:
    """What a camera says of the trigger line."""
    bits = int(stream.capabilities.get("counter_bits", 0))
    return CameraEvidence(log, clock, unwrap_counter(log.counter, bits) if bits else None)


def fired_triggers(cameras: Mapping[str, FrameLog], pulses: PulseLog) -> NDArray[np.int64]:
    """Host times of the triggers of a run, each once: the pulses, or the first camera's software trigger."""
    if pulses.host_ns.size:
        return pulses.host_ns
    index = np.concatenate([log.trigger_index for log in cameras.values()])
    fired = np.concatenate([log.trigger_ns for log in cameras.values()])
    known = (index >= 0) & (fired >= 0)
    _, first = np.unique(index[known], return_index=True)
    times: NDArray[np.int64] = fired[known][first]
    return times


def summarise_sync(
    mode: TriggerMode,
    virtual: bool,
    cameras: Mapping[str, tuple[CameraStream, FrameLog]],
    probes: Mapping[str, tuple[ProbeStream, ProbeLog]],
    pulses: PulseLog,
    counts: Mapping[str, Mapping[str, Any]],
    reckoned_period_ns: float | None = None,
) -> dict[str, Any]:
    """Make the sync report of a run that was just written.

    With a period, the times of the trigger source's pulses were only reckoned, and a probe that stamped them
    is believed instead.
    """
    logs = {name: log for name, (_, log) in cameras.items()}
    clocks = {name: camera_clock(stream, log) for name, (stream, log) in cameras.items()}
    line = None
    if reckoned_period_ns is not None:
        seen = [log.evidence(name, stream.tick_rate_hz) for name, (stream, log) in probes.items()]
        evidence = {name: camera_evidence(*camera, clocks[name]) for name, camera in cameras.items()}
        line = line_of_probes(seen, reckoned_period_ns, evidence)
    fired = line.pulse_ns if line else fired_triggers(logs, pulses)
    clocks |= {name: log.clock(stream.tick_rate_hz, fired) for name, (stream, log) in probes.items()}
    report = sync_report(mode, virtual, logs, clocks, counts, line)
    if line:
        report["line"]["emitted"] = int(pulses.host_ns.size)
    return report
