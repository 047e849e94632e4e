"""Driver ``p3``: Thermal Master (InfiRay) P3 and P1 over USB."""

from __future__ import annotations

from collections.abc import Sequence

from thermacq.devices import Camera, DeviceContext, DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence
from thermacq.transports import Transports

IDS = ((0x3474, 0x45A2), (0x3474, 0x45C2))
"""(vid, pid) on USB."""


def _make(context: DeviceContext) -> Camera:
    from thermacq_drivers.p3.camera import P3Camera

    return P3Camera(context)


def _settings() -> type:
    from thermacq_drivers.p3.camera import P3Settings

    return P3Settings


def _discover(transports: Transports) -> Sequence[DeviceIdentity]:
    from thermacq_drivers.p3.camera import discover

    return discover(transports)


DRIVER = Driver(
    name="p3",
    kind=DeviceKind.CAMERA,
    summary="Thermal Master P3 (256x192) and P1 (160x120): radiometric, 25 frames/s, frame counter",
    evidence=Evidence.EMULATED,
    make=_make,
    settings=_settings,
    discover=_discover,
    usb_ids=IDS,
)
