"""What a recording tells its clients while it runs: plain values, made anew a few times per second."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

from thermacq.acquisition.board import Board, Cell
from thermacq.acquisition.children import DeviceChild
from thermacq.acquisition.job import Job
from thermacq.acquisition.plan import ring_slots
from thermacq.devices import DeviceKind
from thermacq.timing import NS_PER_S, skew_figures

_RATE_WINDOW_S = 1.0


class Phase(StrEnum):
    """Where a recording is."""

    STARTING = "starting"
    RECORDING = "recording"
    FINISHING = "finishing"
    ENDED = "ended"


class Rates:
    """Frames or samples per second of real time, over about the last second."""

    def __init__(self) -> None:
        self._marks: dict[str, tuple[float, int]] = {}
        self._rates: dict[str, float] = {}

    def of(self, name: str, received: int) -> float:
        """Rate of a device whose count is `received` now."""
        now = time.monotonic()
        began, count = self._marks.setdefault(name, (now, received))
        if now - began >= _RATE_WINDOW_S:
            self._rates[name] = (received - count) / (now - began)
            self._marks[name] = (now, received)
        return self._rates.get(name, 0.0)


def make_status(
    phase: Phase,
    job: Job,
    board: Board,
    devices: Sequence[DeviceChild],
    writer_pid: int | None,
    start_ns: int,
    rates: Rates,
    warnings: Sequence[str],
) -> dict[str, Any]:
    """Everything that a client may want to show."""
    virtual = job.rig.clock.kind == "virtual"
    return {
        "state": phase.value,
        "run_id": job.run_id,
        "path": str(job.output),
        "pid": os.getpid(),
        "writer_pid": writer_pid,
        "clock": job.rig.clock.kind,
        "trigger_mode": job.rig.trigger.mode.value,
        "duration_s": job.duration_s,
        "frames": job.frames,
        "elapsed_s": _elapsed_s(phase, virtual, board, devices, start_ns),
        "devices": {device.name: _device(device, job, board, rates) for device in devices},
        "skew_ns": _recent_skew(board, devices),
        "disk_free_bytes": shutil.disk_usage(job.output.parent).free,
        "warnings": list(warnings),
    }


def _elapsed_s(
    phase: Phase, virtual: bool, board: Board, devices: Sequence[DeviceChild], start_ns: int
) -> float:
    if phase is Phase.STARTING:
        return 0.0
    if virtual:
        latest = (board.get(device.spec.index, Cell.LAST_HOST_NS) for device in devices)
        return max(latest, default=0) / NS_PER_S
    return max(0.0, (time.perf_counter_ns() - start_ns) / NS_PER_S)


def _device(device: DeviceChild, job: Job, board: Board, rates: Rates) -> dict[str, Any]:
    index, kind = device.spec.index, device.spec.kind
    received = board.get(index, Cell.RECEIVED)
    status = {
        "kind": kind.value,
        "state": device.state,
        "pid": device.child.process.pid,
        "received": received,
        "lost": board.losses(index),
        "rate_hz": round(rates.of(device.name, received), 1),
        "fault": device.fault.what if device.fault else "",
        "away": device.away.latest if device.away else "",
    }
    if kind is DeviceKind.CAMERA:
        status["written"] = board.get(index, Cell.WRITTEN)
        status["ring_fill"] = round(board.get(index, Cell.RING_FILLED) / ring_slots(job.rig), 3)
        status["scheduling"] = device.armed.scheduling if device.armed else ""
    return status


def _recent_skew(board: Board, devices: Sequence[DeviceChild]) -> dict[str, float] | None:
    cameras = [device.spec.index for device in devices if device.spec.kind is DeviceKind.CAMERA]
    return skew_figures(board.recent_skew_ns(*cameras[:2])) if len(cameras) >= 2 else None
