"""From a rig and a job to the orders for each process: who runs where, how long, and what the header says."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thermacq.acquisition.job import Job
from thermacq.acquisition.messages import ArmOrder, DeviceSpec, Opened, plain
from thermacq.acquisition.priority import core_for
from thermacq.devices import (
    CameraCapabilities,
    DeviceKind,
    ProbeCapabilities,
    TriggerCapabilities,
    TriggerMode,
)
from thermacq.errors import AcquisitionError, RigError
from thermacq.hooks import Evidence
from thermacq.plugins import plugins
from thermacq.rig import Rig
from thermacq.rig.fit import find_misfits
from thermacq.rig.inspection import DeviceReport
from thermacq.rig.load import devices_of
from thermacq.rig.machine import this_machine
from thermacq.rig.rehearsal import emulated_devices
from thermacq.store import CameraStream, ProbeStream, RunHeader
from thermacq.timing import NS_PER_S, ClockSettings

if TYPE_CHECKING:
    from thermacq_calibration import CameraCorrection

_PACKAGES = ("thermacq", "numpy", "h5py", "numcodecs")


def device_specs(rig: Rig, runtime_dir: Path, emulate: bool = False) -> list[DeviceSpec]:
    """Devices that take part: all cameras and probes, and in hardware mode the trigger source."""
    emulated = emulated_devices(rig, plugins()) if emulate else {}
    specs: list[DeviceSpec] = []
    shared_cores = rig.trigger.mode is not TriggerMode.SOFTWARE or rig.clock.kind == "virtual"
    for (_, name), kind, table in devices_of(rig):
        if kind is DeviceKind.TRIGGER_SOURCE and not is_leader(rig, name):
            continue
        core = table.pin_to_core
        if core is None and kind is DeviceKind.CAMERA and not shared_cores:
            core = core_for(len(specs))
        specs.append(
            DeviceSpec(
                index=len(specs),
                name=name,
                kind=kind,
                driver=table.driver,
                settings=table.settings,
                scene=rig.scene,
                clock=ClockSettings(rig.clock.kind, rig.clock.speed),
                runtime_dir=runtime_dir,
                recorder_pid=os.getpid(),
                core=core,
                serial=table.serial,
                emulation=emulated.get(name),
                reconnect=table.reconnect or rig.reconnect,
            )
        )
    return specs


def is_leader(rig: Rig, name: str) -> bool:
    """Whether this is the trigger source that triggers the cameras."""
    return rig.trigger.mode is TriggerMode.HARDWARE and name == rig.trigger.source


def arm_order(job: Job, kind: DeviceKind) -> ArmOrder:
    """What a device of this kind shall do: count triggers, or watch the time."""
    rig, rate_hz = job.rig, job.rig.trigger.frame_rate_hz
    count = job.frames
    # Half a nanosecond of tolerance: 0.3 s at 10 Hz is 3 frames, not 4.
    if count is None and job.duration_s is not None:
        count = math.ceil(job.duration_s * rate_hz - rate_hz * 0.5e-9)
    free_run = kind is DeviceKind.CAMERA and rig.trigger.mode is TriggerMode.FREE_RUN
    end_ns = None
    if kind is DeviceKind.WAVE_PROBE or (free_run and job.frames is None):
        count, end_ns = None, _duration_ns(job)
    return ArmOrder(
        mode=rig.trigger.mode,
        rate_hz=rate_hz,
        count=count,
        end_ns=end_ns,
        late_after_ns=round(rig.trigger.late_after_us * 1000),
        slots=ring_slots(rig),
    )


def _duration_ns(job: Job) -> int | None:
    """Length of the recording; with a number of frames it is known in virtual time only."""
    if job.duration_s is not None:
        return round(job.duration_s * NS_PER_S)
    if job.frames is not None and job.rig.clock.kind == "virtual":
        return round(job.frames / job.rig.trigger.frame_rate_hz * NS_PER_S)
    return None


def ring_slots(rig: Rig) -> int:
    """Frames that a ring holds."""
    return max(2, math.ceil(rig.store.ring_s * rig.trigger.frame_rate_hz))


def check_fit(job: Job, opened: Mapping[str, Opened]) -> list[str]:
    """Refuse what does not fit, return what the user should know.

    Raises
    ------
    RigError
        The devices do not fit the rig or each other, or the calibration is for another size.
    """
    rig, reports = job.rig, []
    for (_, name), kind, table in devices_of(rig):
        if answer := opened.get(name):
            reports.append(
                DeviceReport(
                    name=name,
                    kind=kind,
                    driver=table.driver,
                    requested=table.settings,
                    evidence=plugins().driver(table.driver, kind).evidence,
                    emulated=job.emulate,
                    identity=answer.identity,
                    applied=answer.applied,
                    capabilities=answer.capabilities,
                )
            )
    findings = find_misfits(rig, reports, plugins(), this_machine(job.output.parent))
    wrong = [finding.message for finding in findings if finding.severity == "error"]
    wrong += _calibration_misfits(job, opened)
    if wrong:
        raise RigError(
            "\n".join(wrong), kept="Nothing was recorded.", remedy="`thermacq rig check` shows all."
        )
    return [finding.message for finding in findings]


def _calibration_misfits(job: Job, opened: Mapping[str, Opened]) -> list[str]:
    if job.calibration is None:
        return []
    size = tuple(job.calibration["image_size"])
    cameras = list(cameras_of(opened))
    pair = ["left", "right"] if {"left", "right"} <= set(cameras) else cameras[:2]
    found = [opened[name].identity.serial for name in pair]
    wanted = job.calibration.get("serials")
    others = wanted is not None and all(found) and found != list(wanted)
    misfits = [f"the calibration is for cameras {wanted}, the rig has {found}"] if others else []
    return misfits + [
        f"the calibration is for pictures of {size[0]} x {size[1]} pixels, camera '{name}' makes "
        f"{camera.columns} x {camera.rows}"
        for name, camera in cameras_of(opened).items()
        if size != (camera.columns, camera.rows)
    ]


def corrections(rig: Rig) -> dict[str, CameraCorrection]:
    """The cameras' corrections that the rig names, to be stored with the run.

    Raises
    ------
    RigError
        A file is missing or damaged.
    """
    from thermacq_calibration import CalibrationError, load_correction

    try:
        return {camera: load_correction(Path(file)) for camera, file in rig.correction.files.items()}
    except CalibrationError as error:
        raise RigError(error.what, kept="Nothing was recorded.", remedy=error.remedy) from None


def cameras_of(opened: Mapping[str, Opened]) -> dict[str, CameraCapabilities]:
    """Capabilities of the cameras among the devices."""
    return {
        name: answer.capabilities
        for name, answer in opened.items()
        if isinstance(answer.capabilities, CameraCapabilities)
    }


def expected_bytes(job: Job, opened: Mapping[str, Opened]) -> int:
    """Size of the pictures without compression: the most that the run can need; 0 without an end."""
    frames = job.frames or round((job.duration_s or 0.0) * job.rig.trigger.frame_rate_hz)
    return frames * sum(camera.rows * camera.columns * 2 for camera in cameras_of(opened).values())


def streams(opened: Mapping[str, Opened]) -> tuple[tuple[CameraStream, ...], tuple[ProbeStream, ...]]:
    """What the run file shall say of each camera and probe."""
    cameras, probes = [], []
    for name, answer in opened.items():
        can = answer.capabilities
        told = (plain(answer.identity), answer.applied, plain(can))
        if isinstance(can, CameraCapabilities):
            cameras.append(CameraStream(name, can.rows, can.columns, *told))
        elif isinstance(can, ProbeCapabilities):
            probes.append(ProbeStream(name, can.channels, can.unit, can.tick_rate_hz, *told))
    return tuple(cameras), tuple(probes)


def header(
    job: Job,
    specs: Sequence[DeviceSpec],
    opened: Mapping[str, Opened],
    start_ns: int,
    start_unix_ns: int,
) -> RunHeader:
    """Header of the run file; `start_ns` and `start_unix_ns` are the same instant."""
    evidences = [plugins().driver(spec.driver, spec.kind).evidence for spec in specs]
    emulated = tuple(spec.name for spec in specs if spec.emulation is not None)
    start = datetime.fromtimestamp(start_unix_ns / NS_PER_S, UTC)
    return RunHeader(
        run_id=job.run_id,
        title=job.rig.name,
        start_time=start.isoformat(timespec="microseconds"),
        wall_anchor_ns=start_unix_ns,
        host_anchor_ns=start_ns,
        clock=job.rig.clock.kind,
        simulated=Evidence.SIMULATED in evidences or bool(emulated),
        rig=job.rig.model_dump(mode="json"),
        calibration=job.calibration,
        versions=versions(),
        emulated=emulated,
        triggers_reckoned=any(
            answer.capabilities.reckons_pulses
            for answer in opened.values()
            if isinstance(answer.capabilities, TriggerCapabilities)
        ),
    )


def versions() -> dict[str, str]:
    """Versions of the software that makes the file."""
    found: dict[str, Any] = {name: version(name) for name in _PACKAGES}
    plugins_in_use = (status for status in plugins().statuses if not status.error and status.distribution)
    found |= {status.distribution: status.version for status in plugins_in_use}
    return {"python": platform.python_version(), **found}


def check_time(job: Job) -> None:
    """Refuse a length that cannot be recorded."""
    if job.duration_s is not None and job.frames is not None:
        raise AcquisitionError("give a duration or a number of frames, not both")
    if (job.duration_s is not None and not 0 < job.duration_s < math.inf) or (
        job.frames is not None and job.frames < 1
    ):
        raise AcquisitionError("a recording has a positive duration or number of frames")
