"""Driver ``test-pattern``: a fast simulated camera whose every picture can be checked, bit by bit.

It looks at no scene. Each picture carries its own number and two checksums in its first pixels, so that a
load test can prove that nothing was lost, mixed up or damaged between the camera and the file. Faults can
be ordered by frame number. The pictures compress like those of a thermal camera: by about 2.0 with
bit-shuffled LZ4 (a smooth scene with a noise of 6 counts).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from thermacq.devices import (
    CameraCapabilities,
    Counts,
    DeviceContext,
    DeviceIdentity,
    DeviceKind,
    Frame,
    FrameHost,
    Settings,
    TriggerMode,
)
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Driver, Evidence
from thermacq.settings import check_settings
from thermacq.timing.trigger_line import LineReader
from thermacq_drivers.simflume.exposures import (
    ExposureSource,
    FreeRun,
    LineTriggers,
    SoftwareTriggers,
    sleep_until,
)

MAX_FRAME_RATE_HZ = 1000.0

_MAGIC = 0x7EAC
_POOL = 16
# Frames that the camera keeps for a late host; older ones are overwritten, and missing from the counter.
_QUEUED_FRAMES = 64
# The header lies in the first pixels: what it says, then its own checksum. The body is all the rest.
_HEADER = np.dtype([("magic", "<u2"), ("pattern", "<u2"), ("number", "<u8"), ("body_crc", "<u4")])
_HEADER_BYTES = _HEADER.itemsize
_HEADER_PIXELS = (_HEADER_BYTES + 4) // 2


class PatternSettings(BaseModel):
    """Settings of the test-pattern camera; frame numbers count from 0 at `arm`, -1 is never."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rows: int = Field(512, ge=1, le=4096)
    columns: int = Field(640, ge=_HEADER_PIXELS, le=4096)
    counter_bits: int = Field(16, ge=8, le=64, description="width of the frame counter")
    counter_start: int = Field(65_400, ge=0, description="first count after arming; close to the wrap")
    tick_rate_hz: float = Field(1e6, gt=0, le=1e9, description="rate of the device clock")
    lose_every: int = Field(0, ge=0, description="one frame in this many is lost; 0: none")
    incomplete_at_frame: int = Field(-1, ge=-1, description="this frame arrives short")
    overrun_at_frame: int = Field(-1, ge=-1, description="this frame is lost as if the host were late")
    stall_at_frame: int = Field(-1, ge=-1, description="the camera falls silent here")
    fail_at_frame: int = Field(-1, ge=-1, description="the camera is unplugged here, once")
    replug_after_s: float = Field(
        0.0, ge=0, description="after so many seconds of host time it is plugged in again; 0: never"
    )
    replug_serial: str = Field("", description="another camera is plugged in then, with this serial number")
    timeout_s: float = Field(2.0, gt=0, le=60, description="longest wait for a trigger or a frame")
    line: str = Field("trigger", pattern=r"^[\w-]+$", description="trigger line, for mode 'hardware'")


class PatternCamera:
    """The simulated camera behind ``driver = "test-pattern"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._runtime_dir = context.runtime_dir
        self._settings = PatternSettings()
        self._pool: list[tuple[Counts, int]] = []
        self._exposures: ExposureSource | None = None
        self._opened_ns = 0
        self._last_good = -1
        self._unplugged_ns: int | None = None

    @property
    def capabilities(self) -> CameraCapabilities:
        """What this camera can do with the settings in force."""
        settings = self._settings
        return CameraCapabilities(
            rows=settings.rows,
            columns=settings.columns,
            bit_depth=16,
            max_frame_rate_hz=MAX_FRAME_RATE_HZ,
            trigger_modes=frozenset(TriggerMode),
            tick_rate_hz=settings.tick_rate_hz,
            counter_bits=settings.counter_bits,
        )

    def open(self) -> DeviceIdentity:
        """Start the device clock; a camera that was unplugged is there again when its time has come."""
        self._opened_ns = now_ns = self._clock.now_ns()
        serial = f"TP-{self._name}"
        if self._unplugged_ns is not None:
            after_ns = self._settings.replug_after_s * 1e9
            if after_ns == 0 or now_ns < self._unplugged_ns + after_ns:
                raise self._fault(DeviceDisconnected, "open", "no camera is there")
            serial = self._settings.replug_serial or serial
        return DeviceIdentity("test-pattern", "test pattern", serial)

    def configure(self, settings: Settings) -> Settings:
        """Apply settings; a camera that was armed must be armed again."""
        self.disarm()
        self._settings = check_settings(PatternSettings, settings, self._name)
        return self._settings.model_dump()

    def adopt(self) -> Settings:
        """Settings in force; they outlast an unplugging."""
        return self._settings.model_dump()

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Draw the pictures and start counting from 0."""
        self.disarm()
        if not 0 < frame_rate_hz <= MAX_FRAME_RATE_HZ:
            what = f"{frame_rate_hz:g} frames/s asked, at most {MAX_FRAME_RATE_HZ:g} possible"
            raise self._fault(DeviceFault, "arm", what)
        self._pool = [_draw(self._settings.rows, self._settings.columns, seed) for seed in range(_POOL)]
        self._last_good = -1
        self._exposures = self._make_exposures(mode, frame_rate_hz)

    def _make_exposures(self, mode: TriggerMode, frame_rate_hz: float) -> ExposureSource:
        settings = self._settings
        if mode is TriggerMode.SOFTWARE:
            return SoftwareTriggers(self._clock, settings.timeout_s)
        if mode is TriggerMode.HARDWARE:
            line = LineReader(self._runtime_dir, settings.line)
            return LineTriggers(self._clock, line, settings.timeout_s, _QUEUED_FRAMES)
        return FreeRun(self._clock, 1e9 / frame_rate_hz, _QUEUED_FRAMES)

    def trigger(self, index: int) -> None:
        """Expose now."""
        if not isinstance(self._exposures, SoftwareTriggers):
            raise self._fault(DeviceFault, "trigger", "it is not armed for software triggers")
        self._exposures.call(index)

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Yield pictures, and act out the faults that the settings order."""
        settings = self._settings
        while (source := self._exposures) is not None:
            try:
                exposure = source.next(host)
            except TimeoutError as error:
                raise self._fault(DeviceTimeout, "acquire", str(error)) from None
            if exposure is None:
                return
            number = exposure.number
            self._act_out_fault(number, host)
            if settings.lose_every > 0 and (number + 1) % settings.lose_every == 0:
                if isinstance(source, SoftwareTriggers):
                    # Whoever waits for a triggered frame must be told that it will not come.
                    raise self._fault(IncompleteFrame, "acquire", f"frame {number} did not come")
                continue
            counts = host.buffer()
            self._fill(counts, number)
            self._last_good = number
            yield Frame(
                counts=counts,
                counter=(settings.counter_start + number) % 2**settings.counter_bits,
                ticks=round((exposure.start_ns - self._opened_ns) * settings.tick_rate_hz / 1e9),
                host_ns=self._clock.now_ns(),
                trigger_index=exposure.trigger_index,
            )

    def disarm(self) -> None:
        """Stop."""
        if self._exposures is not None:
            self._exposures.close()
            self._exposures = None

    def close(self) -> None:
        """Let go of the pictures."""
        self.disarm()
        self._pool = []

    def _act_out_fault(self, number: int, host: FrameHost) -> None:
        """Raise the fault that the settings order for this frame."""
        settings = self._settings
        if number == settings.fail_at_frame and self._unplugged_ns is None:
            self._unplugged_ns = self._clock.now_ns()
            self.disarm()
            raise self._fault(DeviceDisconnected, "acquire", "the camera is gone")
        if number == settings.stall_at_frame:
            sleep_until(self._clock, self._clock.now_ns() + round(settings.timeout_s * 1e9), host)
            if not host.stopping():
                raise self._fault(DeviceTimeout, "acquire", f"no frame within {settings.timeout_s:g} s")
        if number == settings.incomplete_at_frame:
            raise self._fault(IncompleteFrame, "acquire", f"frame {number} arrived short")
        if number == settings.overrun_at_frame:
            raise self._fault(
                DeviceOverrun, "acquire", f"frame {number} was overwritten before it was fetched"
            )

    def _fill(self, counts: Counts, number: int) -> None:
        pattern = number % _POOL
        body, crc = self._pool[pattern]
        np.copyto(counts, body)
        header = np.array((_MAGIC, pattern, number, crc), _HEADER).tobytes()
        words = np.frombuffer(header + zlib.crc32(header).to_bytes(4, "little"), "<u2")
        counts[0, :_HEADER_PIXELS] = words

    def _fault(self, kind: type[DeviceFault], stage: str, what: str) -> DeviceFault:
        return kind(self._name, stage, what, last_frame=self._last_good)


def check_pattern(counts: Counts) -> int:
    """Number of a test picture, after everything in it was verified.

    Parameters
    ----------
    counts
        (rows, columns) uint16, a picture of this camera.

    Returns
    -------
    int
        Frame number since `arm`.

    Raises
    ------
    ValueError
        The picture is not one of this camera, or was damaged on the way.
    """
    data = np.ascontiguousarray(counts, "<u2").tobytes()
    header, check = data[:_HEADER_BYTES], data[_HEADER_BYTES : _HEADER_PIXELS * 2]
    if len(check) < 4 or zlib.crc32(header) != int.from_bytes(check, "little"):
        raise ValueError("the header of the test picture is damaged")
    fields: Any = np.frombuffer(header, _HEADER)[0]
    if int(fields["magic"]) != _MAGIC:
        raise ValueError("this is not a test picture")
    if zlib.crc32(data[_HEADER_PIXELS * 2 :]) != int(fields["body_crc"]):
        raise ValueError(f"test picture {fields['number']} is damaged")
    return int(fields["number"])


def _draw(rows: int, columns: int, seed: int) -> tuple[Counts, int]:
    """One picture of the pool, (rows, columns) uint16, and the checksum of its body."""
    y, x = np.mgrid[0:rows, 0:columns]
    noise = np.random.default_rng(seed).normal(0.0, 6.0, (rows, columns))
    picture = (7000 + 400 * np.sin(x / 90 + seed) * np.cos(y / 70) + noise).astype("<u2")
    return picture, zlib.crc32(picture.tobytes()[_HEADER_PIXELS * 2 :])


DRIVER = Driver(
    name="test-pattern",
    kind=DeviceKind.CAMERA,
    summary="fast simulated camera for load tests: frame number and checksums in the pixels",
    evidence=Evidence.SIMULATED,
    make=PatternCamera,
    settings=lambda: PatternSettings,
    faults={
        DeviceDisconnected: {"fail_at_frame": 5},
        DeviceTimeout: {"stall_at_frame": 5, "timeout_s": 0.3},
        IncompleteFrame: {"incomplete_at_frame": 5},
        DeviceOverrun: {"overrun_at_frame": 5},
    },
)
