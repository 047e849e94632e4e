"""Driver ``labjack_u6``: any analogue wave gauge on a LabJack U6 or U6-Pro, streamed by the device's own clock.

A digital input streamed beside the analogue ones stamps the cameras' trigger pulses with the same clock. A
pulse lies between two scans; its tick is the middle between them, so that a pulse must be longer than a scan
interval and its stamp is uncertain by half of one. UNCERTAIN: in which place of a reporting packet the scans
lie that the device dropped (see `stream.ScanAssembler`); and that the USB descriptor holds no serial number,
for which reason the device is asked for its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from thermacq.devices import Device, DeviceContext, DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence
from thermacq.transports import Transports
from thermacq_drivers.labjack_u6.codec import PID, VID

if TYPE_CHECKING:
    from pydantic import BaseModel


def _make(context: DeviceContext) -> Device:
    from thermacq_drivers.labjack_u6.probe import LabJackU6

    return LabJackU6(context)


def _settings() -> type[BaseModel]:
    from thermacq_drivers.labjack_u6.settings import U6Settings

    return U6Settings


def _discover(transports: Transports) -> list[DeviceIdentity]:
    from thermacq_drivers.labjack_u6.link import discover

    return discover(transports)


DRIVER = Driver(
    name="labjack_u6",
    kind=DeviceKind.WAVE_PROBE,
    summary="LabJack U6 or U6-Pro: analogue wave gauges, and a line that stamps the cameras' triggers",
    evidence=Evidence.EMULATED,
    make=_make,
    settings=_settings,
    discover=_discover,
    usb_ids=((VID, PID),),
)
