"""What does not fit in a rig with simulated devices; answers the hook `thermacq_rig_checks`."""

from __future__ import annotations

from collections.abc import Iterator

from thermacq.devices import TriggerMode
from thermacq.errors import RigError
from thermacq.hooks import RigFinding
from thermacq.rig import Rig
from thermacq_drivers.simflume.camera import CameraSettings
from thermacq_drivers.simflume.gauges import check_place
from thermacq_drivers.simflume.probe import ProbeSettings
from thermacq_drivers.simflume.settings import SceneSettings, parse_scene
from thermacq_drivers.simflume.trigger import TriggerSettings


def check(rig: Rig) -> list[RigFinding]:
    """All findings about the simulated devices of a rig."""
    return [*_check_cameras(rig), *_check_probes(rig)]


def _check_cameras(rig: Rig) -> Iterator[RigFinding]:
    cameras = {
        name: CameraSettings.model_validate(table.settings)
        for name, table in rig.cameras.items()
        if table.driver == "sim-camera"
    }
    for pair in sorted({camera.pair for camera in cameras.values()}):
        sides = [camera.side for camera in cameras.values() if camera.pair == pair]
        named = f" of pair '{pair}'" if pair else ""
        if len(sides) == 2 and sides[0] == sides[1]:
            message = (
                f"both simulated cameras{named} are on the {sides[0]} side: "
                "give one `side = ...` in its settings"
            )
            yield RigFinding("error", message)
        if len(sides) > 2:
            message = (
                f"there are {len(sides)} simulated cameras{named}: "
                "name pairs of two by `pair = ...` in their settings"
            )
            yield RigFinding("error", message)
    line = _pulsed_line(rig)
    for name, camera in cameras.items():
        if line and camera.line != line:
            message = f"camera '{name}' listens to line '{camera.line}', the source pulses '{line}'"
            yield RigFinding("error", message)


def _pulsed_line(rig: Rig) -> str:
    """Line that the rig's simulated trigger source pulses; empty when there is none."""
    source = rig.trigger_sources.get(rig.trigger.source)
    if rig.trigger.mode is not TriggerMode.HARDWARE or source is None or source.driver != "sim-trigger":
        return ""
    return TriggerSettings.model_validate(source.settings).line


def _scene(rig: Rig) -> SceneSettings:
    """The rig's scene; the devices themselves complain of an impossible one."""
    try:
        return parse_scene(rig.scene)
    except RigError:
        return SceneSettings()


def _check_probes(rig: Rig) -> Iterator[RigFinding]:
    for name, table in rig.probes.items():
        if table.driver != "sim-probe":
            continue
        settings = ProbeSettings.model_validate(table.settings)
        try:
            check_place(_scene(rig), settings.x_m, settings.y_m, settings.reach_m)
        except ValueError as error:
            yield RigFinding("error", f"simulated probe '{name}': {error}")
        if settings.line and settings.line != _pulsed_line(rig):
            message = f"simulated probe '{name}' listens to line '{settings.line}', which nobody pulses"
            yield RigFinding("error", message)
        if (settings.x_m, settings.y_m) != (table.x_m, table.y_m):
            message = (
                f"simulated probe '{name}' stands at ({settings.x_m:g}, {settings.y_m:g}) m, "
                f"the rig says ({table.x_m:g}, {table.y_m:g}) m"
            )
            yield RigFinding("warning", message)
        if abs(table.coefficient_m_per_unit * settings.volts_per_m - 1) > 1e-6:
            message = (
                f"simulated probe '{name}' gives {settings.volts_per_m:g} V/m, "
                f"the rig's coefficient is {table.coefficient_m_per_unit:g} m/V"
            )
            yield RigFinding("warning", message)
