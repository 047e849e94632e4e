"""Driver ``sim-probe``: a wave probe standing in the simulated flume.

Raw value in volts = ``zero_v + volts_per_m * (1 + coefficient_error) * (elevation + noise)``, where the kinds of
probe differ in the elevation that they see, see `gauges`. The probe samples by its own clock; a trigger line can be
wired to it, whose pulses it stamps with that clock.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from thermacq.devices import (
    DeviceContext,
    DeviceIdentity,
    ProbeCapabilities,
    SampleBlock,
    Settings,
    StreamHost,
)
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.settings import check_settings
from thermacq.timing import NS_PER_S
from thermacq.timing.trigger_line import LineReader
from thermacq_drivers.simflume import gauges
from thermacq_drivers.simflume.epoch import DeviceClockSettings, SceneTime
from thermacq_drivers.simflume.exposures import sleep_until
from thermacq_drivers.simflume.scene import build_surface
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.settings import SceneSettings, Table, device_scene
from thermacq_drivers.simflume.surfaces import Floats, Surface

MAX_SAMPLE_RATE_HZ = 10_000.0
_BLOCK_S = 0.1
_GARBAGE_V = 1e6
_LINE_POLL_S = 0.0005


class ProbeSettings(Table):
    """Settings of a simulated wave probe; seconds are counted from its first sample, -1 is never."""

    kind: Literal["resistance", "capacitance", "ultrasonic"] = "resistance"
    x_m: float = Field(0.25, description="where it stands along the flume")
    y_m: float = Field(-0.03, description="where it stands across the flume")
    sample_rate_hz: float = Field(200.0, gt=0, le=MAX_SAMPLE_RATE_HZ)
    channels: tuple[str, ...] = Field(("elevation",), min_length=1, description="each has noise of its own")
    volts_per_m: float = Field(20.0, gt=0)
    zero_v: float = Field(0.0, description="raw value of still water")
    coefficient_error: float = Field(
        0.0, gt=-0.5, lt=0.5, description="true coefficient over stated, minus 1"
    )
    noise_m: float = Field(0.0002, ge=0, description="standard deviation of a sample")
    temperature: gauges.TemperatureSettings = gauges.TemperatureSettings()
    meniscus_m: float = Field(0.0005, ge=0, le=0.005, description="hysteresis, for kind 'capacitance'")
    ultrasonic: gauges.UltrasonicSettings = gauges.UltrasonicSettings()
    immersion_steps_m: tuple[float, ...] = Field(
        (), description="for calibration: depths to which it is lowered in still water, instead of waves"
    )
    seconds_per_step: float = Field(5.0, gt=0)
    clock: DeviceClockSettings = DeviceClockSettings()
    line: str = Field("", pattern=r"^[\w-]*$", description="trigger line whose pulses it stamps")
    timeout_s: float = Field(5.0, gt=0, le=60)
    garbage_from_s: float = Field(-1.0, ge=-1, description="from here on it sends nonsense")
    silent_from_s: float = Field(-1.0, ge=-1, description="from here on it sends nothing")
    fail_at_s: float = Field(-1.0, ge=-1, description="it is unplugged here")

    @model_validator(mode="after")
    def _distinct(self) -> ProbeSettings:
        if len(set(self.channels)) != len(self.channels) or not all(self.channels):
            raise ValueError("channels must have distinct names")
        return self

    @property
    def reach_m(self) -> float:
        """How far from its place it still measures."""
        return self.ultrasonic.footprint_radius_m if self.kind == "ultrasonic" else 0.0


class SimulatedProbe:
    """The probe behind ``driver = "sim-probe"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._context = context
        self._clock = context.clock
        self._settings = ProbeSettings()
        self._scene = SceneSettings()
        self._scene_time = SceneTime(context.clock, context.runtime_dir)
        self._is_open = self._is_gone = False
        self._is_armed = False
        self._line: LineReader | None = None
        self._first_reading_s = -1.0
        self._next_sample = 0

    @property
    def capabilities(self) -> ProbeCapabilities:
        """What this probe delivers with the settings in force."""
        return ProbeCapabilities(
            channels=self._settings.channels,
            unit="V",
            max_sample_rate_hz=MAX_SAMPLE_RATE_HZ,
            tick_rate_hz=self._settings.clock.tick_rate_hz,
            has_trigger_line=bool(self._settings.line),
        )

    def open(self) -> DeviceIdentity:
        """Connect; what was unplugged does not come back."""
        if self._is_gone:
            raise self._fault(DeviceDisconnected, "open", "the probe is gone")
        self._is_open = True
        return DeviceIdentity("sim-probe", "simulated wave probe", f"SIM-{self._name}", "1")

    def configure(self, settings: Settings) -> Settings:
        """Check settings and scene."""
        self._require_open("configure")
        checked = check_settings(ProbeSettings, settings, self._name)
        scene = device_scene(self._context)
        try:
            gauges.check_place(scene, checked.x_m, checked.y_m, checked.reach_m)
        except ValueError as error:
            raise self._fault(DeviceFault, "configure", str(error)) from None
        self._settings, self._scene = checked, scene
        return self._settings.model_dump()

    def arm(self) -> None:
        """Get ready; sampling starts with the first call of `samples`."""
        self._require_open("arm")
        self.disarm()
        if self._settings.line:
            self._line = LineReader(self._context.runtime_dir, self._settings.line)
        self._first_reading_s = -1.0
        self._next_sample = 0
        self._is_armed = True

    def samples(self, host: StreamHost) -> Iterator[SampleBlock]:
        """Yield blocks of 0.1 s, less what was lost, and act out the faults that the settings order."""
        if not self._is_armed:
            raise self._fault(DeviceFault, "acquire", "it is not armed")
        settings = self._settings
        surface = build_surface(self._scene)
        if self._first_reading_s < 0:
            now_s = self._scene_time.seconds(self._clock.now_ns())
            self._first_reading_s = max(0.0, settings.clock.reading_s(now_s))
        size = max(1, round(_BLOCK_S * settings.sample_rate_hz))
        pulses: NDArray[np.int64] = np.empty(0, np.int64)
        while self._is_armed:
            elapsed_s = (self._next_sample + np.arange(size)) / settings.sample_rate_hz
            readings_s = self._first_reading_s + elapsed_s
            jitter_s = settings.clock.drawn_jitter_s(self._scene.seed, self._name, self._next_sample, size)
            times_s = settings.clock.scene_s(readings_s - jitter_s)
            sleep_until(self._clock, self._scene_time.host_ns(float(times_s[-1])), host)
            if host.stopping():
                return
            self._act_out_faults(float(elapsed_s[-1]), host)
            if host.stopping():
                return
            seen_m = self._seen_m(surface, times_s)
            values = self._volts(seen_m, times_s, elapsed_s)
            pulses = np.append(pulses, self._pulses_until(float(times_s[-1]), host))
            first, self._next_sample = self._next_sample, self._next_sample + size
            ticks = np.rint(readings_s * settings.clock.tick_rate_hz).astype(np.int64)
            for part in gauges.runs(np.isfinite(seen_m)):
                now_ns = self._clock.now_ns()
                yield SampleBlock(values[part], ticks[part], first + part.start, now_ns, pulses)
                pulses = np.empty(0, np.int64)

    def disarm(self) -> None:
        """Stop sampling."""
        self._is_armed = False
        if self._line is not None:
            self._line.close()
            self._line = None

    def close(self) -> None:
        """Let go of everything."""
        self.disarm()
        self._is_open = False

    def _seen_m(self, surface: Surface, times_s: Floats) -> Floats:
        """Elevation that the probe sees at times of the scene, without noise; NaN without an echo."""
        settings = self._settings
        if settings.kind == "ultrasonic":
            pings = np.floor(np.maximum(times_s, 0) * settings.ultrasonic.ping_rate_hz).astype(np.int64)
            numbers, which = np.unique(pings, return_inverse=True)
            return self._echoes_m(surface, numbers)[which]
        x, y, meniscus_m = settings.x_m, settings.y_m, 0.0
        if settings.kind == "capacitance":
            meniscus_m = settings.meniscus_m
        if settings.immersion_steps_m:
            seen, direction = gauges.steps(settings.immersion_steps_m, settings.seconds_per_step, times_s)
            return seen - meniscus_m * direction
        seen = surface.elevation(np.full(times_s.shape, x), np.full(times_s.shape, y), times_s)
        return seen - meniscus_m * gauges.rise(surface, x, y, times_s) if meniscus_m else seen

    def _echoes_m(self, surface: Surface, pings: NDArray[np.int64]) -> Floats:
        """What an ultrasonic probe finds at some pings; NaN where the echo is lost."""
        settings, sonic = self._settings, self._settings.ultrasonic
        times_s = pings / sonic.ping_rate_hz
        lost = gauges.lost_pings(sonic, self._scene.seed, self._name, pings)
        if settings.immersion_steps_m:
            seen, _ = gauges.steps(settings.immersion_steps_m, settings.seconds_per_step, times_s)
        else:
            x, y = settings.x_m, settings.y_m
            seen = gauges.disc_mean(surface, x, y, sonic.footprint_radius_m, times_s)
            slope = surface.slope(np.full(times_s.shape, x), np.full(times_s.shape, y), times_s)
            lost |= np.hypot(*slope) > sonic.slope_limit
        return np.where(lost, np.nan, seen)

    def _volts(self, elevation_m: Floats, times_s: Floats, elapsed_s: Floats) -> Floats:
        """Raw values (samples, channels) in volts."""
        settings, warmth = self._settings, self._settings.temperature
        random = generator(self._scene.seed, self._name, "probe noise", self._next_sample)
        noise_m = settings.noise_m * random.standard_normal((elevation_m.size, len(settings.channels)))
        slope = settings.volts_per_m * (1 + settings.coefficient_error)
        gain = gauges.gain(warmth, self._scene.water_temperature_k, times_s)[:, None]
        drift_m = (gain - 1) * warmth.immersed_m
        volts: Floats = settings.zero_v + slope * (gain * (elevation_m[:, None] + noise_m) + drift_m)
        if settings.garbage_from_s >= 0:
            garbage = elapsed_s >= settings.garbage_from_s
            volts[garbage] = random.choice([_GARBAGE_V, -_GARBAGE_V, np.nan], volts[garbage].shape)
        return volts

    def _pulses_until(self, scene_s: float, host: StreamHost) -> NDArray[np.int64]:
        """Clock readings, in ticks, at the pulses on the line up to a time of the scene."""
        line = self._line
        if line is None:
            return np.empty(0, np.int64)
        end_ns = self._scene_time.host_ns(scene_s)
        # In virtual time the source may be behind this probe: wait (in real time) until it has caught up.
        deadline = time.monotonic() + self._settings.timeout_s
        pulses = []
        while True:
            while line.waiting and line.peek_ns() <= end_ns:
                pulses.append(self._stamp(*line.take()))
            caught_up = line.waiting > 0 or line.finished or not self._clock.is_virtual
            if caught_up or host.stopping():
                return np.array(pulses, np.int64)
            if time.monotonic() > deadline:
                what = f"no pulse on trigger line '{self._settings.line}': is its source armed?"
                raise self._fault(DeviceTimeout, "acquire", what)
            time.sleep(_LINE_POLL_S)

    def _stamp(self, pulse: int, pulse_ns: int) -> int:
        clock = self._settings.clock
        (jitter_s,) = clock.drawn_jitter_s(self._scene.seed, f"{self._name} pulses", pulse)
        return clock.ticks(self._scene_time.seconds(pulse_ns), float(jitter_s))

    def _act_out_faults(self, elapsed_s: float, host: StreamHost) -> None:
        settings = self._settings
        if 0 <= settings.fail_at_s <= elapsed_s:
            self.close()
            self._is_gone = True
            raise self._fault(DeviceDisconnected, "acquire", "the probe is gone")
        if 0 <= settings.silent_from_s <= elapsed_s:
            sleep_until(self._clock, self._clock.now_ns() + round(settings.timeout_s * NS_PER_S), host)
            if not host.stopping():
                raise self._fault(DeviceTimeout, "acquire", f"no samples within {settings.timeout_s:g} s")

    def _require_open(self, stage: str) -> None:
        if not self._is_open:
            raise self._fault(DeviceFault, stage, "it is not open")

    def _fault(self, kind: type[DeviceFault], stage: str, what: str) -> DeviceFault:
        return kind(self._name, stage, what, last_frame=self._next_sample - 1)
