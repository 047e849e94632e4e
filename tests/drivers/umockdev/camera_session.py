"""A whole session of a driver of a pyusb camera, run in a test and in its child process."""

from __future__ import annotations

import json
import zlib
from typing import Any

from thermacq.devices import DeviceContext, TriggerMode
from thermacq.errors import IncompleteFrame
from thermacq.plugins import plugins
from thermacq.testing.streams import FrameSink
from thermacq.timing.clock import RealClock
from thermacq.transports import Transports


def camera_session(
    driver_name: str, settings: dict[str, Any], rate_hz: float, frames: int, transports: Transports
) -> str:
    """Discover, open, configure, arm, so many frames, disarm, close; all that came, as JSON."""
    driver = plugins().driver(driver_name)
    found = [(one.model, one.serial) for one in driver.discover(transports)]
    context = DeviceContext("left", RealClock(), transports=transports, serial="EMU-left", settings=settings)
    camera: Any = driver.make(context)
    identity = camera.open()
    camera.configure(settings)
    camera.arm(TriggerMode.FREE_RUN, rate_hz)
    sink = FrameSink(camera.capabilities.rows, camera.capabilities.columns)
    stream, came, damaged = camera.frames(sink), [], 0
    while len(came) < frames:
        try:
            frame = next(stream)
        except IncompleteFrame:
            damaged += 1
            stream = camera.frames(sink)
            continue
        came.append((frame.counter, str(frame.fpa_temperature_k), zlib.crc32(frame.counts.tobytes())))
        sink.advance()
    camera.disarm()
    camera.close()
    return json.dumps([found, [identity.model, identity.serial, identity.firmware], came, damaged])
