"""Driver ``boson``: FLIR Boson and Boson+ (320 or 640), pictures over UVC and control over FSLP.

Video node and serial port of one camera are paired by their USB serial number. The picture comes as ``Y16``
with two more rows than the sensor has; one of them is the telemetry, with frame counter and milliseconds of the
camera's clock. What is uncertain, and how it is met:

- How the telemetry row is packed: sources conflict. It is looked for in both packings by the serial number in it;
  the setting ``telemetry`` overrides. Without it frames have host times only, and the driver warns.
- Whether a camera follows pulses at 50 Hz, and how late its exposure is: not known.
- The external sync is set explicitly each time: a slave in mode ``hardware``, else as ``sync_in_free_run`` says.

Facts from public SDK copies, flirpy, and a dump of descriptors. Not checked on hardware.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from thermacq.devices import Device, DeviceContext, DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence
from thermacq.transports import Transports

if TYPE_CHECKING:
    from pydantic import BaseModel

IDS = ((0x09CB, 0x4007),)
"""(vid, pid) on USB."""


def _make(context: DeviceContext) -> Device:
    from thermacq_drivers.boson.camera import BosonCamera

    return BosonCamera(context)


def _settings() -> type[BaseModel]:
    from thermacq_drivers.boson.settings import BosonSettings

    return BosonSettings


def _discover(transports: Transports) -> list[DeviceIdentity]:
    from thermacq_drivers.boson.camera import discover

    return discover(transports)


DRIVER = Driver(
    name="boson",
    kind=DeviceKind.CAMERA,
    summary="FLIR Boson 320/640: Y16 over UVC, telemetry, external sync, flat-field correction over FSLP",
    evidence=Evidence.EMULATED,
    make=_make,
    settings=_settings,
    discover=_discover,
    usb_ids=IDS,
)
