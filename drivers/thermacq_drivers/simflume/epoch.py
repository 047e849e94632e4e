"""Time of the scene, and the clocks of simulated devices.

Scene time is 0 at the start of a recording. In virtual time that is host time 0. In real time the devices
of a recording agree on it through the file ``scene-start`` in their common directory: the first device
that needs it writes the host time there, once; it may also be written beforehand.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from thermacq.timing import NS_PER_S, Clock
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.settings import Table

START_FILE = "scene-start"
_LARGEST_JITTER = 4.0
# In standard deviations.

_Number = TypeVar("_Number", float, NDArray[np.float64])


class DeviceClockSettings(Table):
    """A device's own clock: it reads ``offset_s + (1 + drift) * scene time + jitter``, in ticks."""

    offset_s: float = Field(0.0, ge=0, lt=1e6)
    drift_ppm: float = Field(0.0, gt=-1e5, lt=1e5)
    tick_rate_hz: float = Field(1e6, gt=0, le=1e9)
    jitter_s: float = Field(0.0, ge=0, lt=0.01, description="standard deviation of a single reading")

    @model_validator(mode="after")
    def _never_below_zero(self) -> DeviceClockSettings:
        if self.offset_s < _LARGEST_JITTER * self.jitter_s:
            raise ValueError(
                f"offset_s must be at least {_LARGEST_JITTER:g} jitter_s: no clock reads below 0"
            )
        return self

    def reading_s(self, scene_s: _Number) -> _Number:
        """What the device's clock shows, in its own seconds, at a time of the scene."""
        return self.offset_s + (1 + self.drift_ppm * 1e-6) * scene_s

    def scene_s(self, reading_s: _Number) -> _Number:
        """Time of the scene at which the device's clock shows so many seconds."""
        return (reading_s - self.offset_s) / (1 + self.drift_ppm * 1e-6)

    def host_period_s(self, period_s: float) -> float:
        """How long a period of the device's clock really lasts."""
        return period_s / (1 + self.drift_ppm * 1e-6)

    def ticks(self, scene_s: float, jitter_s: float = 0.0) -> int:
        """Reading of the device's clock in whole ticks, off by a jitter drawn before."""
        return max(0, round((self.reading_s(scene_s) + jitter_s) * self.tick_rate_hz))

    def drawn_jitter_s(self, seed: int, device: str, number: int, count: int = 1) -> NDArray[np.float64]:
        """Jitter of a device's readings number `number` to `number + count - 1`, drawn together: (count,)."""
        if self.jitter_s == 0:
            return np.zeros(count)
        drawn = generator(seed, device, "clock jitter", number).standard_normal(count)
        return self.jitter_s * np.clip(drawn, -_LARGEST_JITTER, _LARGEST_JITTER)


class SceneTime:
    """Host time to time of the scene, for one device.

    Parameters
    ----------
    clock
        Host clock of the recording.
    runtime_dir
        Directory shared by the devices of the recording.
    """

    def __init__(self, clock: Clock, runtime_dir: Path) -> None:
        self._file = runtime_dir / START_FILE
        self._start_ns: int | None = 0 if clock.is_virtual else None

    def seconds(self, host_ns: int) -> float:
        """Time of the scene; the first device to ask makes this host time the start of the scene."""
        if self._start_ns is None:
            self._start_ns = _agree(self._file, host_ns)
        return (host_ns - self._start_ns) / NS_PER_S

    def host_ns(self, scene_s: float) -> int:
        """Host time of a time of the scene; only after `seconds` was asked."""
        return (self._start_ns or 0) + round(scene_s * NS_PER_S)


def _agree(file: Path, host_ns: int) -> int:
    """Write the start unless somebody has, and return what the file says."""
    own = file.with_name(f"{file.name}.{os.getpid()}")
    own.write_text(str(host_ns))
    try:
        os.link(own, file)
    except FileExistsError:
        pass
    finally:
        own.unlink()
    return int(file.read_text())
