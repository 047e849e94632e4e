"""Driver ``sim-trigger``: a box that pulses a simulated trigger line, with jitter, and pulses lost, late or doubled."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

from pydantic import Field

from thermacq.devices import (
    DeviceContext,
    DeviceIdentity,
    Settings,
    StreamHost,
    TriggerCapabilities,
    TriggerPulse,
)
from thermacq.errors import DeviceDisconnected, DeviceFault
from thermacq.settings import check_settings
from thermacq.timing import NS_PER_S
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.simflume.exposures import sleep_until
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.settings import SceneSettings, Table, device_scene

MAX_RATE_HZ = 1000.0
PERIOD_STEP_S = 1e-6
_LARGEST_LEAD = 64
# In virtual time the source waits when its slowest follower is this many pulses behind.
_POLL_S = 0.0005


class TriggerSettings(Table):
    """Settings of a simulated trigger source; pulses are counted from 0 at `arm`, -1 is never."""

    line: str = Field("trigger", pattern=r"^[\w-]+$", description="the line that it pulses")
    drift_ppm: float = Field(0.0, gt=-1e5, lt=1e5, description="of its clock: positive is fast")
    jitter_s: float = Field(0.0, ge=0, lt=0.01, description="standard deviation of a pulse's time")
    skip_probability: float = Field(0.0, ge=0, lt=1, description="of a pulse that the box leaves out")
    late_probability: float = Field(0.0, ge=0, lt=1, description="of a pulse that comes late")
    late_s: float = Field(0.002, gt=0, lt=0.1, description="how late it is")
    double_probability: float = Field(0.0, ge=0, lt=1, description="of a pulse that comes twice")
    double_s: float = Field(0.002, gt=0, lt=0.1, description="from such a pulse to its double")
    fail_at_pulse: int = Field(-1, ge=-1, description="it is unplugged here")


class SimulatedTrigger:
    """The source behind ``driver = "sim-trigger"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._context = context
        self._clock = context.clock
        self._settings = TriggerSettings()
        self._scene = SceneSettings()
        self._is_open = self._is_gone = False
        self._line: LineWriter | None = None
        self._period_ns = 0.0
        self._count: int | None = None

    @property
    def capabilities(self) -> TriggerCapabilities:
        """What this source can emit."""
        return TriggerCapabilities(MAX_RATE_HZ, PERIOD_STEP_S)

    def open(self) -> DeviceIdentity:
        """Connect; what was unplugged does not come back."""
        if self._is_gone:
            raise DeviceDisconnected(self._name, "open", "the source is gone")
        self._is_open = True
        return DeviceIdentity("sim-trigger", "simulated trigger source", f"SIM-{self._name}", "1")

    def configure(self, settings: Settings) -> Settings:
        """Check settings and scene."""
        self._require_open("configure")
        self._settings = check_settings(TriggerSettings, settings, self._name)
        self._scene = device_scene(self._context)
        return self._settings.model_dump()

    def arm(self, rate_hz: float, count: int | None) -> None:
        """Get ready to emit `count` pulses (None: until disarmed); the period is a multiple of 1 µs."""
        self._require_open("arm")
        self.disarm()
        if not 0 < rate_hz <= MAX_RATE_HZ:
            raise self._fault("arm", f"{rate_hz:g} pulses/s asked, at most {MAX_RATE_HZ:g} possible")
        period_s = round(1 / rate_hz / PERIOD_STEP_S) * PERIOD_STEP_S
        self._period_ns = period_s * NS_PER_S / (1 + self._settings.drift_ppm * 1e-6)
        self._count = count
        self._line = LineWriter(self._context.runtime_dir, self._settings.line)
        self._line.start_session()

    def pulses(self, host: StreamHost) -> Iterator[TriggerPulse]:
        """Emit pulses and yield each; a skipped one is a longer interval, and a double has an index of its own."""
        line = self._line
        if line is None:
            raise self._fault("acquire", "it is not armed")
        for index, due_ns in enumerate(self._due_times_ns(self._clock.now_ns())):
            if self._line is None or index == self._count:
                break
            if index == self._settings.fail_at_pulse:
                self.close()
                self._is_gone = True
                raise DeviceDisconnected(self._name, "acquire", "the source is gone", last_frame=index - 1)
            sleep_until(self._clock, due_ns, host)
            while self._clock.is_virtual and line.lead() >= _LARGEST_LEAD and not host.stopping():
                time.sleep(_POLL_S)
            if host.stopping():
                break
            pulse_ns = due_ns if self._clock.is_virtual else self._clock.now_ns()
            line.emit(pulse_ns)
            yield TriggerPulse(index, pulse_ns)
        line.finish_session()

    def disarm(self) -> None:
        """Stop emitting."""
        if self._line is not None:
            self._line.finish_session()
            self._line = None

    def close(self) -> None:
        """Let go of the line."""
        self.disarm()
        self._is_open = False

    def _jitter_ns(self, cycle: int) -> int:
        if self._settings.jitter_s == 0:
            return 0
        jitter_s = generator(self._scene.seed, self._name, "jitter", cycle).normal(0, self._settings.jitter_s)
        # The first pulse cannot come before the start.
        return max(round(float(jitter_s) * NS_PER_S), -round(cycle * self._period_ns))

    def _due_times_ns(self, start_ns: int) -> Iterator[int]:
        """Host times of all pulses, without end, in order."""
        settings, last_ns = self._settings, start_ns - 1
        for cycle in itertools.count():
            if self._happens("skip", cycle, settings.skip_probability):
                continue
            due_ns = start_ns + round(cycle * self._period_ns) + self._jitter_ns(cycle)
            if self._happens("late", cycle, settings.late_probability):
                due_ns += round(settings.late_s * NS_PER_S)
            pulses = [due_ns]
            if self._happens("double", cycle, settings.double_probability):
                pulses.append(due_ns + round(settings.double_s * NS_PER_S))
            for pulse_ns in pulses:
                last_ns = max(pulse_ns, last_ns + 1)
                yield last_ns

    def _happens(self, what: str, cycle: int, probability: float) -> bool:
        if probability == 0:
            return False
        return bool(generator(self._scene.seed, self._name, what, cycle).uniform() < probability)

    def _require_open(self, stage: str) -> None:
        if not self._is_open:
            raise self._fault(stage, "it is not open")

    def _fault(self, stage: str, what: str) -> DeviceFault:
        return DeviceFault(self._name, stage, what)
