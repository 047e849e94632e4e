"""The simulated flume's devices as drivers; their modules are imported when one is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thermacq.devices import Camera, DeviceContext, DeviceKind, TriggerSource, WaveProbe
from thermacq.errors import DeviceDisconnected, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Driver, Evidence

if TYPE_CHECKING:
    from pydantic import BaseModel


def _camera(context: DeviceContext) -> Camera:
    from thermacq_drivers.simflume.camera import SimulatedCamera

    return SimulatedCamera(context)


def _camera_settings() -> type[BaseModel]:
    from thermacq_drivers.simflume.camera import CameraSettings

    return CameraSettings


def _probe(context: DeviceContext) -> WaveProbe:
    from thermacq_drivers.simflume.probe import SimulatedProbe

    return SimulatedProbe(context)


def _probe_settings() -> type[BaseModel]:
    from thermacq_drivers.simflume.probe import ProbeSettings

    return ProbeSettings


def _trigger(context: DeviceContext) -> TriggerSource:
    from thermacq_drivers.simflume.trigger import SimulatedTrigger

    return SimulatedTrigger(context)


def _trigger_settings() -> type[BaseModel]:
    from thermacq_drivers.simflume.trigger import TriggerSettings

    return TriggerSettings


DRIVERS = (
    Driver(
        name="sim-camera",
        kind=DeviceKind.CAMERA,
        summary="thermal camera over the simulated flume",
        evidence=Evidence.SIMULATED,
        make=_camera,
        settings=_camera_settings,
        faults={
            DeviceDisconnected: {"fail_at_frame": 3},
            DeviceTimeout: {"stall_at_frame": 3, "timeout_s": 0.3},
            IncompleteFrame: {"incomplete_at_frame": 3},
            DeviceOverrun: {"overrun_at_frame": 3},
        },
    ),
    Driver(
        name="sim-probe",
        kind=DeviceKind.WAVE_PROBE,
        summary="wave probe standing in the simulated flume",
        evidence=Evidence.SIMULATED,
        make=_probe,
        settings=_probe_settings,
        faults={
            DeviceDisconnected: {"fail_at_s": 0.5},
            DeviceTimeout: {"silent_from_s": 0.5, "timeout_s": 0.3},
        },
    ),
    Driver(
        name="sim-trigger",
        kind=DeviceKind.TRIGGER_SOURCE,
        summary="trigger source that pulses a simulated line",
        evidence=Evidence.SIMULATED,
        make=_trigger,
        settings=_trigger_settings,
        faults={DeviceDisconnected: {"fail_at_pulse": 3}},
    ),
)
