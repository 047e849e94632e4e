"""Driver ``uvc``: any camera that Video4Linux can read, with 16-bit or 8-bit luminance, running free.

Such a camera has no clock and no frame counter: its frames carry host times only, and frames that it loses are
not noticed. The exception is a FLIR Lepton on a PureThermal board, whose telemetry rows (160 x 122 pixels) are
read when there are any. The order of the words in them is uncertain; it is told from the time that they hold,
and the setting ``word_order`` overrides. Not checked on hardware.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from thermacq.devices import Device, DeviceContext, DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence
from thermacq.transports import Transports

if TYPE_CHECKING:
    from pydantic import BaseModel

LEPTON_IDS = (0x1E4E, 0x0100)
"""(vid, pid) of a Lepton on a PureThermal board."""


def _make(context: DeviceContext) -> Device:
    from thermacq_drivers.uvc.camera import UvcCamera

    return UvcCamera(context)


def _settings() -> type[BaseModel]:
    from thermacq_drivers.uvc.camera import UvcSettings

    return UvcSettings


def _discover(transports: Transports) -> list[DeviceIdentity]:
    from thermacq_drivers.uvc.camera import discover

    return discover(transports)


DRIVER = Driver(
    name="uvc",
    kind=DeviceKind.CAMERA,
    summary="any Video4Linux camera, 16 or 8 bits, host times only; telemetry of a Lepton on PureThermal",
    evidence=Evidence.EMULATED,
    make=_make,
    settings=_settings,
    discover=_discover,
    # Other cameras have any ids; they are reached through their video node.
    usb_ids=(LEPTON_IDS,),
)
