"""Driver ``p2pro``: InfiRay P2 Pro and Topdon TC001, over USB video and vendor requests."""

from __future__ import annotations

from collections.abc import Sequence

from thermacq.devices import Camera, DeviceContext, DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence
from thermacq.transports import Transports

IDS = ((0x0BDA, 0x5830),)
"""(vid, pid) on USB."""


def _make(context: DeviceContext) -> Camera:
    from thermacq_drivers.p2pro.camera import P2ProCamera

    return P2ProCamera(context)


def _settings() -> type:
    from thermacq_drivers.p2pro.camera import P2ProSettings

    return P2ProSettings


def _discover(transports: Transports) -> Sequence[DeviceIdentity]:
    from thermacq_drivers.p2pro.camera import discover

    return discover(transports)


DRIVER = Driver(
    name="p2pro",
    kind=DeviceKind.CAMERA,
    summary="InfiRay P2 Pro, Topdon TC001 (256x192): radiometric, 25 frames/s, no frame counter",
    evidence=Evidence.EMULATED,
    make=_make,
    settings=_settings,
    discover=_discover,
    usb_ids=IDS,
)
