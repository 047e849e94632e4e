"""When a camera's shutter is closed, and when its offsets were corrected last: pure functions of time."""

from __future__ import annotations

import math

from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.sensor_settings import ShutterSettings


class Shutter:
    """The shutter of one camera. Automatic events of two cameras do not coincide.

    Parameters
    ----------
    settings
        Period of automatic events, events on command, duration.
    seed, name
        Seed of the scene and name of the camera, which fix the phase of the automatic events.
    """

    def __init__(self, settings: ShutterSettings, seed: int, name: str) -> None:
        self._settings = settings
        self._phase_s = settings.period_s * float(generator(seed, name, "shutter").uniform())

    def closed_since(self, time_s: float) -> float | None:
        """Start of the event during which the shutter is closed now; None when it is open."""
        start_s = self._last_start(time_s)
        return start_s if start_s is not None and time_s < start_s + self._settings.closed_s else None

    def corrected_at(self, time_s: float) -> float | None:
        """Time at which the last correction came into force; None when there was none yet."""
        start_s = self._last_start(time_s - self._settings.closed_s)
        return None if start_s is None else start_s + self._settings.closed_s

    def frames_frozen(self, time_s: float, frame_rate_hz: float) -> int:
        """How many frames ago the picture was taken that is delivered now; 0 while the shutter is open."""
        frames = 0
        while (start_s := self.closed_since(time_s - frames / frame_rate_hz)) is not None:
            frames += math.floor((time_s - frames / frame_rate_hz - start_s) * frame_rate_hz) + 1
        return frames

    def _last_start(self, time_s: float) -> float | None:
        """Start of the last event that began not later than now."""
        starts = [start_s for start_s in self._settings.at_s if start_s <= time_s]
        if self._settings.period_s > 0:
            period_s = self._settings.period_s
            starts.append(self._phase_s + math.floor((time_s - self._phase_s) / period_s) * period_s)
        return max(starts, default=None)
