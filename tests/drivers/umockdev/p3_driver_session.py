"""A whole session of the driver ``p3``, run in a test and in its child process."""

from __future__ import annotations

import json
import zlib

from thermacq.devices import DeviceContext, TriggerMode
from thermacq.errors import IncompleteFrame
from thermacq.testing.streams import FrameSink
from thermacq.timing.clock import RealClock
from thermacq.transports import Transports
from thermacq_drivers.p3.camera import P3Camera, discover

SETTINGS = {"settle_s": 0.0, "stream_settle_s": 0.0, "gain": "high", "shutter_at_arm": True}


def driver_session(transports: Transports, frames: int) -> str:
    """Discover, open, configure, arm, so many frames, disarm, close; all that came, as JSON."""
    found = [(one.model, one.serial) for one in discover(transports)]
    camera = P3Camera(DeviceContext("left", RealClock(), transports=transports, serial="EMU-left"))
    identity = camera.open()
    camera.configure(SETTINGS)
    camera.arm(TriggerMode.FREE_RUN, 25.0)
    sink = FrameSink(camera.capabilities.rows, camera.capabilities.columns)
    stream, came, damaged = camera.frames(sink), [], 0
    while len(came) < frames:
        try:
            frame = next(stream)
        except IncompleteFrame:
            damaged += 1
            stream = camera.frames(sink)
            continue
        came.append((frame.counter, int(frame.flags), zlib.crc32(frame.counts.tobytes())))
        sink.advance()
    camera.disarm()
    camera.close()
    return json.dumps([found, [identity.model, identity.serial, identity.firmware], came, damaged])
