"""Driver ``tau2``: FLIR Tau 2 on a ThermalCapture GrabberUSB of TeAx."""

from __future__ import annotations

from collections.abc import Sequence

from thermacq.devices import Camera, DeviceContext, DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence
from thermacq.transports import Transports

IDS = ((0x0403, 0x6010),)
"""(vid, pid) on USB."""


def _make(context: DeviceContext) -> Camera:
    from thermacq_drivers.tau2.camera import Tau2Camera

    return Tau2Camera(context)


def _settings() -> type:
    from thermacq_drivers.tau2.camera import Tau2Settings

    return Tau2Settings


def _discover(transports: Transports) -> Sequence[DeviceIdentity]:
    from thermacq_drivers.tau2.camera import discover

    return discover(transports)


DRIVER = Driver(
    name="tau2",
    kind=DeviceKind.CAMERA,
    summary="FLIR Tau 2 on a TeAx grabber (FT2232H): raw counts, FFC, FPA temperature, external sync",
    evidence=Evidence.EMULATED,
    make=_make,
    settings=_settings,
    discover=_discover,
    usb_ids=IDS,
)
