"""What does not fit: the rig against its devices, the devices against each other and the machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from pydantic import ValidationError

from thermacq.devices import (
    CameraCapabilities,
    DeviceKind,
    ProbeCapabilities,
    TriggerCapabilities,
    TriggerMode,
)
from thermacq.errors import PluginError
from thermacq.hooks import Evidence, RigFinding
from thermacq.plugins import Plugins
from thermacq.rig.inspection import DeviceReport, flat
from thermacq.rig.load import devices_of
from thermacq.rig.machine import LARGEST_RING_PART, Machine
from thermacq.rig.model import Rig
from thermacq.settings import explain

_SHORTEST_RECORDING_S = 60.0


@dataclass(frozen=True)
class Load:
    """What a recording asks of the computer."""

    bytes_per_s: float
    """Uncompressed pictures of all cameras."""
    ring_bytes: int
    """Shared memory of all camera rings."""


def load_of(rig: Rig, reports: Sequence[DeviceReport]) -> Load:
    """Data rate and ring memory of a recording with these cameras."""
    pixels = sum(camera.rows * camera.columns for _, camera in _cameras(reports))
    bytes_per_s = 2.0 * pixels * rig.trigger.frame_rate_hz
    return Load(bytes_per_s, round(bytes_per_s * rig.store.ring_s))


def find_misfits(
    rig: Rig, reports: Sequence[DeviceReport], known: Plugins, machine: Machine
) -> list[RigFinding]:
    """Everything that does not fit, the errors first.

    Parameters
    ----------
    rig
        The resolved rig.
    reports
        What its devices said (`thermacq.rig.inspection.inspect_devices`).
    known
        Plugins; their rig checks are asked too.
    machine
        The computer that shall record.
    """
    looks: tuple[Callable[[], Iterator[RigFinding]], ...] = (
        lambda: _device_findings(rig, reports),
        lambda: _camera_findings(rig, reports),
        lambda: _trigger_findings(rig, reports),
        lambda: _probe_findings(rig, reports),
        lambda: _machine_findings(rig, reports, machine),
        lambda: _matcher_findings(rig, known),
        lambda: _correction_findings(rig, reports),
        lambda: _stage_findings(rig, known),
    )
    findings = [finding for look in looks for finding in look()]
    findings.extend(known.rig_checks(rig))
    return sorted(findings, key=lambda finding: finding.severity != "error")


def _error(message: str) -> RigFinding:
    return RigFinding("error", message)


def _warning(message: str) -> RigFinding:
    return RigFinding("warning", message)


def _cameras(reports: Sequence[DeviceReport]) -> list[tuple[str, CameraCapabilities]]:
    return [
        (report.name, report.capabilities)
        for report in reports
        if isinstance(report.capabilities, CameraCapabilities)
    ]


def _device_findings(rig: Rig, reports: Sequence[DeviceReport]) -> Iterator[RigFinding]:
    expected = {place[1]: table.serial for place, _, table in devices_of(rig)}
    for report in reports:
        if report.error:
            remedy = f" {report.remedy}" if report.remedy else ""
            yield _error(f"{report.name}: {report.error}{remedy}")
        serial = report.identity.serial if report.identity else ""
        wanted = expected[report.name]
        if report.identity and wanted and serial != wanted:
            yield _error(f"{report.name}: the rig expects serial '{wanted}', the device is '{serial}'")
        applied = flat(report.applied)
        for key, value in flat(report.requested).items():
            if key in applied and applied[key] != value:
                yield _warning(f"{report.name}: {key}: asked {value!r}, applied {applied[key]!r}")
        real = report.evidence not in (None, Evidence.SIMULATED) and not report.emulated
        if rig.clock.kind == "virtual" and real:
            yield _error(f"{report.name}: a real device cannot follow the virtual clock")
    for one, other in combinations([report for report in reports if report.identity], 2):
        if one.identity == other.identity:
            yield _error(f"{one.name} and {other.name} are the same device; give each its serial")


def _camera_findings(rig: Rig, reports: Sequence[DeviceReport]) -> Iterator[RigFinding]:
    cameras = _cameras(reports)
    sizes = {(camera.rows, camera.columns) for _, camera in cameras}
    if len(sizes) > 1:
        listed = ", ".join(f"{name} {camera.columns} x {camera.rows}" for name, camera in cameras)
        yield _error(f"the cameras differ in size: {listed} pixels")
    rate_hz, mode = rig.trigger.frame_rate_hz, rig.trigger.mode
    for name, camera in cameras:
        if rate_hz > camera.max_frame_rate_hz:
            yield _error(
                f"{name}: {rate_hz:g} frames/s asked, at most {camera.max_frame_rate_hz:g} possible at this size"
            )
        if mode not in camera.trigger_modes:
            offered = ", ".join(sorted(camera.trigger_modes))
            yield _error(f"{name}: trigger mode '{mode}' is not offered; it has: {offered}")
        if mode is not TriggerMode.SOFTWARE and camera.counter_bits == 0 and camera.tick_rate_hz == 0:
            yield _warning(
                f"{name}: as it is set up it has neither frame counter nor clock: frames that it loses are not "
                "noticed, and there is nothing to pair its frames by"
            )


def _trigger_findings(rig: Rig, reports: Sequence[DeviceReport]) -> Iterator[RigFinding]:
    rate_hz, source = rig.trigger.frame_rate_hz, rig.trigger.source
    if source and rig.trigger.mode is not TriggerMode.HARDWARE:
        yield _warning(f"trigger.source '{source}' is not used in mode '{rig.trigger.mode}'")
        return
    for report in reports:
        emitter = report.capabilities
        if report.name != source or not isinstance(emitter, TriggerCapabilities):
            continue
        if rate_hz > emitter.max_rate_hz:
            yield _error(f"{source}: {rate_hz:g} pulses/s asked, at most {emitter.max_rate_hz:g} possible")
        steps = 1 / rate_hz / emitter.period_step_s if emitter.period_step_s > 0 else 1.0
        if abs(steps - round(steps)) > 1e-6 * steps:
            nearest_hz = 1 / (max(1, round(steps)) * emitter.period_step_s)
            yield _warning(
                f"{source}: its period has steps of {emitter.period_step_s * 1e6:g} µs, so {rate_hz:g} Hz "
                f"becomes {nearest_hz:.6g} Hz"
            )


def _probe_findings(rig: Rig, reports: Sequence[DeviceReport]) -> Iterator[RigFinding]:
    for report in reports:
        if report.kind is DeviceKind.WAVE_PROBE and isinstance(report.capabilities, ProbeCapabilities):
            channel, channels = rig.probes[report.name].channel, report.capabilities.channels
            if channel and channel not in channels:
                yield _error(f"{report.name}: there is no channel '{channel}'; it has: {', '.join(channels)}")


def _machine_findings(rig: Rig, reports: Sequence[DeviceReport], machine: Machine) -> Iterator[RigFinding]:
    load = load_of(rig, reports)
    if load.ring_bytes > LARGEST_RING_PART * machine.memory_bytes:
        yield _error(
            f"the rings need {load.ring_bytes / 1e6:.0f} MB of memory, of {machine.memory_bytes / 1e6:.0f} MB "
            f"that are free they may take {LARGEST_RING_PART:.0%}; make store.ring_s shorter"
        )
    usable_bytes = machine.disk_bytes - rig.store.reserve_mb * 1e6
    if load.bytes_per_s > 0 and usable_bytes < _SHORTEST_RECORDING_S * load.bytes_per_s:
        yield _warning(
            f"the disk here holds {max(0.0, usable_bytes) / load.bytes_per_s:.0f} s of uncompressed pictures "
            f"above the reserve of {rig.store.reserve_mb:g} MB"
        )
    pinned = {place[1]: table.pin_to_core for place, _, table in devices_of(rig)}
    for name, core in pinned.items():
        if core is not None and core >= machine.cores:
            yield _error(f"{name}: pin_to_core = {core}, but the cores are 0 to {machine.cores - 1}")
    for (one, core), (other, same) in combinations(pinned.items(), 2):
        if core is not None and core == same:
            yield _warning(f"{one} and {other} are pinned to the same core {core}")


def _matcher_findings(rig: Rig, known: Plugins) -> Iterator[RigFinding]:
    table = rig.reconstruction
    try:
        model = known.matcher(table.matcher).settings()
        model.model_validate(table.matcher_settings)
    except PluginError as error:
        yield _warning(f"reconstruction.matcher: {error.what}. {error.remedy}")
    except ValidationError as error:
        yield _error(explain(error, model, "reconstruction.matcher_settings"))


def _correction_findings(rig: Rig, reports: Sequence[DeviceReport]) -> Iterator[RigFinding]:
    """Correction files that are damaged, of another camera, or of another size."""
    if not rig.correction.files:
        return
    from thermacq_calibration import CalibrationError, load_correction

    cameras = {report.name: report for report in reports}
    for name, file in rig.correction.files.items():
        try:
            correction = load_correction(Path(file))
        except CalibrationError as error:
            yield _error(f"correction.files.{name}: {error.what}")
            continue
        report = cameras.get(name)
        if report is None:
            continue
        serial = report.identity.serial if report.identity else ""
        if serial and correction.serial and serial != correction.serial:
            yield _error(
                f"correction.files.{name}: '{file}' belongs to camera {correction.serial}, this one is {serial}"
            )
        can, (rows, columns) = report.capabilities, correction.gain.shape
        if isinstance(can, CameraCapabilities) and (can.rows, can.columns) != (rows, columns):
            yield _error(
                f"correction.files.{name}: '{file}' is for pictures of {columns} x {rows} pixels, the camera "
                f"makes {can.columns} x {can.rows}"
            )


def _stage_findings(rig: Rig, known: Plugins) -> Iterator[RigFinding]:
    for number, stage in enumerate(rig.correction.stages):
        try:
            model = known.correction_stage(stage.name).settings()
            model.model_validate(stage.settings)
        except PluginError as error:
            yield _error(f"correction.stages.{number}: {error.what}. {error.remedy}")
        except ValidationError as error:
            yield _error(explain(error, model, f"correction.stages.{number}.settings"))
