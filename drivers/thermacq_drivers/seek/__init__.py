"""Driver ``seek``: Seek Thermal Compact, CompactXR and CompactPRO over USB."""

from __future__ import annotations

from collections.abc import Sequence

from thermacq.devices import Camera, DeviceContext, DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence
from thermacq.transports import Transports


def _make(context: DeviceContext) -> Camera:
    from thermacq_drivers.seek.camera import SeekCamera

    return SeekCamera(context)


def _settings() -> type:
    from thermacq_drivers.seek.camera import SeekSettings

    return SeekSettings


def _discover(transports: Transports) -> Sequence[DeviceIdentity]:
    from thermacq_drivers.seek.camera import discover

    return discover(transports)


DRIVER = Driver(
    name="seek",
    kind=DeviceKind.CAMERA,
    summary="Seek Thermal Compact, CompactXR, CompactPRO: raw counts, own shutter frames, about 9 frames/s",
    evidence=Evidence.EMULATED,
    make=_make,
    settings=_settings,
    discover=_discover,
    usb_ids=((0x289D, 0x0010), (0x289D, 0x0011)),
)
