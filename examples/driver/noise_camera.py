"""Driver ``noise-camera``: an imaginary camera that sees nothing but its own noise."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from thermacq.devices import (
    CameraCapabilities,
    DeviceContext,
    DeviceIdentity,
    DeviceKind,
    Frame,
    FrameHost,
    Settings,
    TriggerMode,
)
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Driver, Evidence, hookimpl
from thermacq.settings import check_settings

MAX_FRAME_RATE_HZ = 100.0
MODES = frozenset({TriggerMode.FREE_RUN, TriggerMode.SOFTWARE})


class NoiseSettings(BaseModel):
    """What the rig file may say under ``[cameras.NAME.settings]``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rows: int = Field(120, ge=1, le=2048)
    columns: int = Field(160, ge=1, le=2048)
    level_counts: float = Field(8000.0, ge=0, le=16_000)
    noise_counts: float = Field(5.0, ge=0, le=50)
    timeout_s: float = Field(2.0, gt=0, description="longest wait for a trigger")
    unplug_at_frame: int = Field(-1, ge=-1, description="act out a disconnection; -1: never")


class NoiseCamera:
    """The verbs of `thermacq.devices.Camera`, in the order in which the host calls them."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._settings = NoiseSettings()
        self._random = np.random.default_rng()
        self._triggers: deque[tuple[int, int]] = deque()
        self._mode: TriggerMode | None = None
        self._period_ns = 0
        self._armed_ns = 0
        self._number = 0

    @property
    def capabilities(self) -> CameraCapabilities:
        """What this camera can do; the conformance suite holds it to every word."""
        return CameraCapabilities(
            rows=self._settings.rows,
            columns=self._settings.columns,
            bit_depth=16,
            max_frame_rate_hz=MAX_FRAME_RATE_HZ,
            trigger_modes=MODES,
            tick_rate_hz=1e6,
            counter_bits=16,
        )

    def open(self) -> DeviceIdentity:
        """Connect; here a vendor's library would be imported and the device searched for."""
        return DeviceIdentity(driver="noise-camera", model="noise", serial="0")

    def configure(self, settings: Settings) -> Settings:
        """Apply the settings and return all that is in force."""
        self.disarm()
        self._settings = check_settings(NoiseSettings, settings, self._name)
        return self._settings.model_dump()

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Get ready; from now on a trigger may come at any moment."""
        if mode not in MODES:
            raise DeviceFault(self._name, "arm", f"it has no trigger mode '{mode}'")
        if not 0 < frame_rate_hz <= MAX_FRAME_RATE_HZ:
            raise DeviceFault(self._name, "arm", f"it cannot make {frame_rate_hz:g} frames/s")
        self._triggers.clear()
        self._mode = mode
        self._period_ns = round(1e9 / frame_rate_hz)
        self._armed_ns = self._clock.now_ns()
        self._number = 0

    def trigger(self, index: int) -> None:
        """Expose now, and return at once."""
        self._triggers.append((index, self._clock.now_ns()))

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Fill one buffer after another until the host stops."""
        while self._mode is not None and (exposure := self._wait(host)) is not None:
            trigger_index, exposed_ns = exposure
            number, self._number = self._number, self._number + 1
            if number == self._settings.unplug_at_frame:
                raise DeviceDisconnected(self._name, "acquire", "it is gone", last_frame=number - 1)
            counts = host.buffer()
            noise = self._random.normal(0, self._settings.noise_counts, counts.shape)
            counts[:] = np.maximum(self._settings.level_counts + noise, 0)
            yield Frame(
                counts=counts,
                counter=number % 2**16,
                ticks=(exposed_ns - self._armed_ns) // 1000,
                host_ns=self._clock.now_ns(),
                trigger_index=trigger_index,
            )

    def _wait(self, host: FrameHost) -> tuple[int, int] | None:
        """Trigger index and time of the next exposure; None when the host stops first."""
        if self._mode is TriggerMode.FREE_RUN:
            due_ns = self._armed_ns + self._number * self._period_ns
            self._clock.wait_until_ns(due_ns, host.stopping)
            return None if host.stopping() else (-1, due_ns)
        deadline_ns = self._clock.now_ns() + round(self._settings.timeout_s * 1e9)
        while not self._triggers:
            if host.stopping():
                return None
            if self._clock.now_ns() >= deadline_ns:
                raise DeviceTimeout(self._name, "acquire", "no trigger came", last_frame=self._number - 1)
            self._clock.wait_until_ns(self._clock.now_ns() + 20_000_000, host.stopping)
        return self._triggers.popleft()

    def disarm(self) -> None:
        """Stop; legal in every state."""
        self._mode = None

    def close(self) -> None:
        """Let go of the device; legal in every state."""
        self.disarm()


@hookimpl
def thermacq_drivers() -> Sequence[Driver]:
    """What this plugin brings."""
    noise = Driver(
        name="noise-camera",
        kind=DeviceKind.CAMERA,
        summary="example: a camera that sees only noise",
        evidence=Evidence.SIMULATED,
        make=NoiseCamera,
        settings=lambda: NoiseSettings,
        faults={DeviceDisconnected: {"unplug_at_frame": 3}},
    )
    return (noise,)
