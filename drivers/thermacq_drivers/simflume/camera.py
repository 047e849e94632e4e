"""Driver ``sim-camera``: one of the two thermal cameras over the simulated flume.

Each frame is a pure function of the scene, its seed, the camera's name and settings, and the time and
number of the exposure. In virtual time a recording is therefore the same, bit by bit, each time.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from thermacq.devices import (
    CameraCapabilities,
    Counts,
    DeviceContext,
    DeviceIdentity,
    Frame,
    FrameFlag,
    FrameHost,
    Settings,
    TriggerMode,
)
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.settings import check_settings
from thermacq.timing import NS_PER_S
from thermacq.timing.trigger_line import LineReader
from thermacq_drivers.simflume.bolometer import lagged_temperature
from thermacq_drivers.simflume.epoch import DeviceClockSettings, SceneTime
from thermacq_drivers.simflume.exposures import (
    Exposure,
    ExposureSource,
    FreeRun,
    LineTriggers,
    SoftwareTriggers,
    sleep_until,
)
from thermacq_drivers.simflume.lens import build_lens
from thermacq_drivers.simflume.mounting import Mounting
from thermacq_drivers.simflume.scene import View, build_view, check_scene
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import (
    BolometerSettings,
    CameraCondition,
    LensSettings,
    SensorSettings,
    ShutterSettings,
    WarmUpSettings,
)
from thermacq_drivers.simflume.settings import SceneSettings, device_scene
from thermacq_drivers.simflume.shutter import Shutter
from thermacq_drivers.simflume.warm_up import fpa_reading

MAX_FRAME_RATE_HZ = 200.0


class CameraSettings(Mounting):
    """Settings of a simulated camera; frames are counted from 0 at `arm`, frame -1 is never."""

    lens: LensSettings | None = Field(None, description="None: the plain blur of `sensor`")
    sensor: SensorSettings = SensorSettings()
    bolometer: BolometerSettings = BolometerSettings()
    warm_up: WarmUpSettings = WarmUpSettings()
    shutter: ShutterSettings = ShutterSettings()
    clock: DeviceClockSettings = DeviceClockSettings()
    counter_bits: int = Field(16, ge=8, le=64)
    counter_start: int = Field(0, ge=0, description="frame counter after arming")
    line: str = Field("trigger", pattern=r"^[\w-]+$", description="trigger line, for mode 'hardware'")
    trigger_latency_s: float = Field(0.0, ge=0, lt=0.1, description="from a trigger to the exposure")
    trigger_jitter_s: float = Field(0.0, ge=0, lt=0.01, description="standard deviation of the latency")
    missed_pulse_probability: float = Field(
        0.0, ge=0, lt=1, description="of a pulse on the line that the camera does not notice nor count"
    )
    loss_probability: float = Field(0.0, ge=0, lt=1, description="of a frame on its way to the host")
    cached_loop_frames: int = Field(
        0, ge=0, le=500, description="draw so many frames when armed and play them in a loop; 0: draw each"
    )
    timeout_s: float = Field(5.0, gt=0, le=60, description="longest wait for a trigger")
    incomplete_at_frame: int = Field(-1, ge=-1, description="this frame arrives short")
    overrun_at_frame: int = Field(-1, ge=-1, description="this frame is lost as if the host were late")
    stall_at_frame: int = Field(-1, ge=-1, description="the camera falls silent here")
    fail_at_frame: int = Field(-1, ge=-1, description="the camera is unplugged here")


def in_condition(settings: CameraSettings, condition: CameraCondition) -> CameraSettings:
    """Settings of a camera in the condition that the scene asks for."""
    given = {name: table for name, table in condition if table is not None}
    return settings.model_copy(update=given)


def make_sensor(settings: CameraSettings, scene: SceneSettings, name: str) -> Sensor:
    """Sensor and lens of the camera of this name."""
    lens = None
    if settings.lens is not None:
        lens = build_lens(settings.lens, settings, integrated=scene.view == "chessboard")
    return Sensor(
        settings.sensor,
        settings.rows,
        settings.columns,
        scene.seed,
        name,
        lens=lens,
        warm_up=settings.warm_up,
        shutter=settings.shutter,
    )


class SimulatedCamera:
    """The camera behind ``driver = "sim-camera"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._context = context
        self._clock = context.clock
        self._settings = CameraSettings()
        self._is_open = self._is_gone = False
        self._scene = SceneSettings()
        self._scene_time = SceneTime(context.clock, context.runtime_dir)
        self._view: View | None = None
        self._sensor: Sensor | None = None
        self._shutter: Shutter | None = None
        self._frame_rate_hz = 1.0
        self._held_since_s: float | None = None
        self._held: Counts = np.empty((0, 0), np.uint16)
        self._loop: list[tuple[Counts, FrameFlag]] = []
        self._exposures: ExposureSource | None = None
        self._last_good = -1

    @property
    def capabilities(self) -> CameraCapabilities:
        """What this camera can do with the settings in force."""
        settings = self._settings
        return CameraCapabilities(
            rows=settings.rows,
            columns=settings.columns,
            bit_depth=settings.sensor.bit_depth,
            max_frame_rate_hz=MAX_FRAME_RATE_HZ,
            trigger_modes=frozenset(TriggerMode),
            tick_rate_hz=settings.clock.tick_rate_hz,
            counter_bits=settings.counter_bits,
            has_shutter=settings.shutter.is_used,
            has_temperature=True,
            line_time_s=settings.bolometer.line_time_s,
        )

    def open(self) -> DeviceIdentity:
        """Connect; what was unplugged does not come back."""
        if self._is_gone:
            raise self._fault(DeviceDisconnected, "open", "the camera is gone")
        self._is_open = True
        return DeviceIdentity("sim-camera", "simulated LWIR camera", f"SIM-{self._name}", "1")

    def configure(self, settings: Settings) -> Settings:
        """Check settings and scene, and that the camera can see it from where it stands."""
        self._require_open("configure")
        checked = check_settings(CameraSettings, settings, self._name)
        scene = device_scene(self._context)
        try:
            check_scene(scene, checked)
        except ValueError as error:
            raise self._fault(DeviceFault, "configure", str(error)) from None
        self._settings, self._scene = in_condition(checked, scene.camera), scene
        return self._settings.model_dump()

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Build the scene, and be ready for the first exposure."""
        self._require_open("arm")
        self.disarm()
        if not 0 < frame_rate_hz <= MAX_FRAME_RATE_HZ:
            what = f"{frame_rate_hz:g} frames/s asked, at most {MAX_FRAME_RATE_HZ:g} possible"
            raise self._fault(DeviceFault, "arm", what)
        settings = self._settings
        self._view = build_view(self._scene, settings, settings.bolometer.line_time_s)
        self._sensor = make_sensor(settings, self._scene, self._name)
        self._shutter = Shutter(settings.shutter, self._scene.seed, self._name)
        self._frame_rate_hz = frame_rate_hz
        self._held_since_s = None
        self._loop = []
        for number in range(settings.cached_loop_frames):
            counts: NDArray[np.uint16] = np.empty((settings.rows, settings.columns), np.uint16)
            self._loop.append((counts, self._expose(number / frame_rate_hz, number, counts)))
        self._last_good = -1
        self._exposures = self._make_exposures(mode, frame_rate_hz)

    def _make_exposures(self, mode: TriggerMode, frame_rate_hz: float) -> ExposureSource:
        settings = self._settings
        if mode is TriggerMode.SOFTWARE:
            return SoftwareTriggers(self._clock, settings.timeout_s)
        if mode is TriggerMode.HARDWARE:
            line = LineReader(self._context.runtime_dir, settings.line)
            return LineTriggers(self._clock, line, settings.timeout_s, is_missed=self._is_missed)
        return FreeRun(self._clock, settings.clock.host_period_s(1 / frame_rate_hz) * NS_PER_S)

    def trigger(self, index: int) -> None:
        """Expose now."""
        if not isinstance(self._exposures, SoftwareTriggers):
            raise self._fault(DeviceFault, "trigger", "it is not armed for software triggers")
        self._exposures.call(index)

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Yield frames, and act out the faults that the settings order."""
        if self._exposures is None:
            raise self._fault(DeviceFault, "acquire", "it is not armed")
        while (source := self._exposures) is not None:
            try:
                exposure = source.next(host)
            except TimeoutError as error:
                raise self._fault(DeviceTimeout, "acquire", str(error)) from None
            if exposure is None:
                return
            self._act_out_faults(exposure, host)
            if not self._is_lost(exposure):
                yield self._take(exposure, host.buffer())
            elif isinstance(source, SoftwareTriggers):
                # Whoever waits for a triggered frame must be told that it will not come.
                raise self._fault(IncompleteFrame, "acquire", f"frame {exposure.number} did not arrive")

    def disarm(self) -> None:
        """Stop exposing."""
        if self._exposures is not None:
            self._exposures.close()
            self._exposures = None

    def close(self) -> None:
        """Let go of everything."""
        self.disarm()
        self._view = self._sensor = self._shutter = None
        self._loop = []
        self._is_open = False

    def _take(self, exposure: Exposure, counts: Counts) -> Frame:
        settings = self._settings
        number = exposure.number
        start_s = self._scene_time.seconds(exposure.start_ns) + self._latency_s(number)
        if self._loop:
            picture, flags = self._loop[number % len(self._loop)]
            np.copyto(counts, picture)
        else:
            index = exposure.trigger_index if exposure.trigger_index >= 0 else number
            flags = self._expose(start_s, index, counts)
        self._last_good = number
        return Frame(
            counts=counts,
            counter=(settings.counter_start + number) % 2**settings.counter_bits,
            ticks=settings.clock.ticks(start_s, self._clock_jitter_s(number)),
            host_ns=self._clock.now_ns(),
            trigger_index=exposure.trigger_index,
            flags=flags,
            fpa_temperature_k=fpa_reading(settings.warm_up, start_s, self._scene.seed, self._name, number),
        )

    def _expose(self, time_s: float, index: int, counts: Counts) -> FrameFlag:
        """Fill `counts` with the picture of this time, or the frozen one while the shutter is closed."""
        if self._shutter is None:
            raise self._fault(DeviceFault, "acquire", "it is not armed")
        since_s = self._shutter.closed_since(time_s)
        if since_s is None:
            self._draw(time_s, index, counts)
            return FrameFlag.NONE
        if since_s != self._held_since_s:
            ago = self._shutter.frames_frozen(time_s, self._frame_rate_hz)
            self._held = np.empty_like(counts)
            self._draw(time_s - ago / self._frame_rate_hz, max(0, index - ago), self._held)
            self._held_since_s = since_s
        np.copyto(counts, self._held)
        return FrameFlag.SHUTTER

    def _draw(self, time_s: float, index: int, counts: Counts) -> None:
        if self._view is None or self._sensor is None:
            raise self._fault(DeviceFault, "acquire", "it is not armed")
        seen = lagged_temperature(self._view, self._settings.bolometer, time_s, index)
        self._sensor.expose(seen, index, counts, time_s)

    def _latency_s(self, number: int) -> float:
        settings = self._settings
        if settings.trigger_jitter_s == 0:
            return settings.trigger_latency_s
        jitter = generator(self._scene.seed, self._name, "jitter", number).normal(
            0, settings.trigger_jitter_s
        )
        return settings.trigger_latency_s + abs(float(jitter))

    def _clock_jitter_s(self, number: int) -> float:
        return float(self._settings.clock.drawn_jitter_s(self._scene.seed, self._name, number)[0])

    def _is_lost(self, exposure: Exposure) -> bool:
        return self._happens("loss", exposure.number, self._settings.loss_probability)

    def _is_missed(self, pulse: int) -> bool:
        return self._happens("missed pulse", pulse, self._settings.missed_pulse_probability)

    def _happens(self, what: str, number: int, probability: float) -> bool:
        if probability == 0:
            return False
        return bool(generator(self._scene.seed, self._name, what, number).uniform() < probability)

    def _act_out_faults(self, exposure: Exposure, host: FrameHost) -> None:
        """Raise the fault that the settings order for this exposure."""
        settings, number = self._settings, exposure.number
        if number == settings.fail_at_frame:
            self.close()
            self._is_gone = True
            raise self._fault(DeviceDisconnected, "acquire", "the camera is gone")
        if number == settings.stall_at_frame:
            sleep_until(self._clock, self._clock.now_ns() + round(settings.timeout_s * NS_PER_S), host)
            if not host.stopping():
                raise self._fault(DeviceTimeout, "acquire", f"no frame within {settings.timeout_s:g} s")
        if number == settings.incomplete_at_frame:
            raise self._fault(IncompleteFrame, "acquire", f"frame {number} arrived short")
        if number == settings.overrun_at_frame:
            raise self._fault(DeviceOverrun, "acquire", f"frame {number} was overwritten")

    def _require_open(self, stage: str) -> None:
        if not self._is_open:
            raise self._fault(DeviceFault, stage, "it is not open")

    def _fault(self, kind: type[DeviceFault], stage: str, what: str) -> DeviceFault:
        return kind(self._name, stage, what, last_frame=self._last_good)
