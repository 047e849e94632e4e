"""Driver ``gige``: any GenICam camera over GigE Vision or USB3 Vision, through Aravis.

Proven on Aravis' own fake GigE Vision cameras, two at once, over the loopback interface; on no camera of a
laboratory yet. Importing this package loads neither Aravis nor GObject: both come in when cameras are
looked for or opened, in the process of the device.

What was learnt on the way, and is built in:

* The frame id has 16 bits and skips 0 when it wraps (GigE Vision keeps 0 for test packets). The counter
  that the host sees is continuous (`thermacq_drivers.gige.frame_ids`).
* Aravis enlarges the receive buffer of its socket only after the first packets have come, which damages
  the first frame now and then; the driver enlarges it before the camera is started.
* Packet sockets are never used: as root they often deliver nothing on the loopback interface.
* The packet size stays in the camera from one client to the next; it is set every time.
* A camera that is gone is noticed by Aravis after 5 to 6 s (``control-lost``), so the longest silence that
  the driver bears by default is a little longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from thermacq.devices import Device, DeviceContext, DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence
from thermacq.transports import Transports

if TYPE_CHECKING:
    from pydantic import BaseModel


def _make(context: DeviceContext) -> Device:
    from thermacq_drivers.gige.camera import GigeCamera

    return GigeCamera(context)


def _settings() -> type[BaseModel]:
    from thermacq_drivers.gige.settings import GigeSettings

    return GigeSettings


def _discover(_transports: Transports) -> Sequence[DeviceIdentity]:
    from thermacq_drivers.gige.aravis import AravisMissing, LinkError, list_cameras
    from thermacq_drivers.gige.camera import identity_of

    try:
        return [identity_of(found) for found in list_cameras()]
    except (AravisMissing, LinkError):
        return ()


DRIVER = Driver(
    name="gige",
    kind=DeviceKind.CAMERA,
    summary="any GenICam camera over GigE Vision or USB3 Vision, through Aravis",
    evidence=Evidence.REAL_PEER,
    make=_make,
    settings=_settings,
    discover=_discover,
)
