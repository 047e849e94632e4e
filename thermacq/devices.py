"""What a device is: three small protocols, their frozen capabilities, and what they hand over.

A driver author writes one class with the verbs of `Camera`, `WaveProbe` or `TriggerSource`. The host owns
processes, threads, clocks and buffers; a driver owns none of them. The life of every device is::

    open -> configure -> arm -> (frames | samples | pulses) -> disarm -> close

`configure`/`arm` may be repeated; `disarm` and `close` are legal in every state and never raise for a
device that is already there. Every wait inside a driver is bounded and looks at ``host.stopping()`` at
least every 0.1 s, so that a generator ends soon after the host asked. Faults are raised as the typed
errors of `thermacq.errors`: after `IncompleteFrame` and `DeviceOverrun` the host counts the loss and asks
for a new generator without disarming. After `DeviceDisconnected` and `DeviceTimeout` it closes the device and
tries, as ``[reconnect]`` says, to open the same individual; any other fault ends the device's part of the run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntFlag, StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, runtime_checkable

from thermacq.transports import RealTransports, Transports

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from thermacq.timing.clock import Clock

# Quoted: listing plugins and commands needs this module, and must not wait for numpy.
Counts: TypeAlias = "NDArray[np.uint16]"
"""Raw picture, (rows, columns) uint16, counts."""

Settings: TypeAlias = Mapping[str, Any]
"""Device settings: plain values that TOML and JSON can hold."""


class DeviceKind(StrEnum):
    """What a driver drives."""

    CAMERA = "camera"
    WAVE_PROBE = "wave_probe"
    TRIGGER_SOURCE = "trigger_source"


class TriggerMode(StrEnum):
    """Who decides when a camera exposes."""

    FREE_RUN = "free_run"
    SOFTWARE = "software"
    HARDWARE = "hardware"


class FrameFlag(IntFlag):
    """What was unusual about a frame."""

    NONE = 0
    SHUTTER = 1
    """The shutter (FFC) was closed or the picture frozen by it."""
    INCOMPLETE = 2
    """Part of the picture was lost on the way; the counts are not to be trusted."""
    RESTARTED = 4
    """First frame after the camera was away: counter and clock began anew. Set by the host."""


@dataclass(frozen=True)
class DeviceIdentity:
    """Which individual device this is, independent of the port that it hangs on."""

    driver: str
    model: str
    serial: str
    firmware: str = ""


@dataclass(frozen=True)
class DeviceContext:
    """What the host tells a driver when it makes a device.

    Parameters
    ----------
    name
        Name of the device in the rig; used in every message about it.
    clock
        Host clock of this recording. A driver of real hardware stamps frames with it and nothing more.
    scene
        The rig's ``[scene]`` table: what simulated devices look at. Real devices ignore it.
    runtime_dir
        Private directory shared by the devices of one recording (simulated trigger lines live there).
    transports
        How the driver reaches USB, serial ports and video nodes: really, or those of an emulator.
    serial
        Serial number that the rig expects; `open` chooses the device that has it. Empty: any.
    settings
        What `configure` will be given, for drivers whose `open` needs to know where the device is (a port,
        an address) or which of several is meant.
    """

    name: str
    clock: Clock
    scene: Settings = field(default_factory=dict)
    runtime_dir: Path = Path()
    transports: Transports = field(default_factory=RealTransports)
    serial: str = ""
    settings: Settings = field(default_factory=dict)


@dataclass(frozen=True)
class CameraCapabilities:
    """What a camera can do; declared once it is open, checked by the conformance suite.

    Parameters
    ----------
    rows, columns
        Size of its pictures in pixels.
    bit_depth
        Significant bits of a count.
    max_frame_rate_hz
        Highest frame rate at this size.
    trigger_modes
        Modes that `arm` accepts.
    tick_rate_hz
        Rate of the device clock behind ``Frame.ticks``; 0 when the device has no clock.
    counter_bits
        Width of the frame counter behind ``Frame.counter``; 0 when the device has none.
    has_shutter
        Whether frames can carry `FrameFlag.SHUTTER`.
    has_temperature
        Whether frames carry the temperature of the focal-plane array.
    line_time_s
        Read-out time of one row of a rolling read-out; 0 for a global one.
    """

    rows: int
    columns: int
    bit_depth: int
    max_frame_rate_hz: float
    trigger_modes: frozenset[TriggerMode]
    tick_rate_hz: float = 0.0
    counter_bits: int = 0
    has_shutter: bool = False
    has_temperature: bool = False
    line_time_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture and every time that belongs to it; times are kept apart, never merged.

    Parameters
    ----------
    counts
        The buffer that the host handed out, filled: (rows, columns) uint16.
    counter
        Frame counter of the device as delivered (it wraps); -1 when there is none.
    ticks
        Device clock at the start of exposure; -1 when there is none.
    host_ns
        Host time when the complete frame was in the buffer.
    trigger_index
        Index of the trigger that made this frame, as far as the driver knows; -1 when it does not.
    flags
        What was unusual.
    fpa_temperature_k
        Temperature of the focal-plane array, NaN when unknown.
    """

    counts: Counts
    counter: int
    ticks: int
    host_ns: int
    trigger_index: int = -1
    flags: FrameFlag = FrameFlag.NONE
    fpa_temperature_k: float = float("nan")


@dataclass(frozen=True)
class ProbeCapabilities:
    """What a wave probe delivers.

    Parameters
    ----------
    channels
        Names of its channels.
    unit
        Unit of the raw values before the probe's coefficient is applied, e.g. ``V`` or ``counts``.
    max_sample_rate_hz
        Highest sampling rate.
    tick_rate_hz
        Rate of the device clock behind ``SampleBlock.ticks``; 0 when samples are only counted.
    has_trigger_line
        Whether the probe's clock also stamps the cameras' trigger pulses (``SampleBlock.pulse_ticks``).
    """

    channels: tuple[str, ...]
    unit: str
    max_sample_rate_hz: float
    tick_rate_hz: float = 0.0
    has_trigger_line: bool = False


def _no_ticks() -> NDArray[np.int64]:
    import numpy as np

    return np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples of a probe.

    Parameters
    ----------
    values
        (samples, channels) float64, raw unit of the probe.
    ticks
        (samples,) int64, device clock at each sample.
    first_index
        The device's own count of the first sample since `arm`; a jump means lost samples.
    host_ns
        Host time when the block was received.
    pulse_ticks
        (pulses,) int64, device clock at the trigger pulses seen since the last block.
    """

    values: NDArray[np.float64]
    ticks: NDArray[np.int64]
    first_index: int
    host_ns: int
    pulse_ticks: NDArray[np.int64] = field(default_factory=_no_ticks)


@dataclass(frozen=True)
class TriggerCapabilities:
    """What a trigger source can emit.

    Parameters
    ----------
    max_rate_hz
        Highest rate.
    period_step_s
        Grid of the settable period; 0 when continuous.
    reckons_pulses
        Whether times and numbers of its pulses are reckoned from the start of the train instead of observed;
        a probe that stamps the pulses then knows them better.
    """

    max_rate_hz: float
    period_step_s: float
    reckons_pulses: bool = False


@dataclass(frozen=True, slots=True)
class TriggerPulse:
    """One emitted pulse: its index, and host time as well as the source knows it."""

    index: int
    host_ns: int


class StreamHost(Protocol):
    """The host's side of one acquisition, handed to a device's generator."""

    def stopping(self) -> bool:
        """Whether the generator shall end now."""
        ...


class FrameHost(StreamHost, Protocol):
    """The host's side of a camera's acquisition."""

    def buffer(self) -> Counts:
        """Hand out the buffer for the next frame, (rows, columns) uint16.

        Never blocks in real time: when the ring is full, the buffer is one that the host will count as
        lost. Asking again without yielding hands out the same buffer.
        """
        ...


@runtime_checkable
class Camera(Protocol):
    """A camera. See the module's docstring for the order of the verbs."""

    @property
    def capabilities(self) -> CameraCapabilities:
        """What this camera can do; valid after `open`."""
        ...

    def open(self) -> DeviceIdentity:
        """Connect to the device and say which individual it is."""
        ...

    def configure(self, settings: Settings) -> Settings:
        """Apply settings and return everything that is really in force, defaults included."""
        ...

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Get ready to deliver frames; followers are armed before whoever triggers them."""
        ...

    def trigger(self, index: int) -> None:
        """Start one exposure now (mode ``software`` only); returns at once."""
        ...

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Yield frames in buffers from ``host.buffer()`` until ``host.stopping()``.

        In mode ``software`` the host calls `trigger` before each step of the generator.
        """
        ...

    def disarm(self) -> None:
        """Stop exposing; legal in every state."""
        ...

    def close(self) -> None:
        """Let go of the device; legal in every state."""
        ...


@runtime_checkable
class WaveProbe(Protocol):
    """A wave probe (gauge): one or several channels sampled by a clock of its own."""

    @property
    def capabilities(self) -> ProbeCapabilities:
        """What this probe delivers; valid after `open`."""
        ...

    def open(self) -> DeviceIdentity:
        """Connect to the device and say which individual it is."""
        ...

    def configure(self, settings: Settings) -> Settings:
        """Apply settings and return everything that is really in force, defaults included."""
        ...

    def arm(self) -> None:
        """Get ready to sample."""
        ...

    def samples(self, host: StreamHost) -> Iterator[SampleBlock]:
        """Yield blocks of at most 0.25 s of samples until ``host.stopping()``."""
        ...

    def disarm(self) -> None:
        """Stop sampling; legal in every state."""
        ...

    def close(self) -> None:
        """Let go of the device; legal in every state."""
        ...


@runtime_checkable
class TriggerSource(Protocol):
    """A box that emits trigger pulses on a line."""

    @property
    def capabilities(self) -> TriggerCapabilities:
        """What this source can emit; valid after `open`."""
        ...

    def open(self) -> DeviceIdentity:
        """Connect to the device and say which individual it is."""
        ...

    def configure(self, settings: Settings) -> Settings:
        """Apply settings and return everything that is really in force, defaults included."""
        ...

    def arm(self, rate_hz: float, count: int | None) -> None:
        """Get ready to emit `count` pulses (None: until disarmed) at `rate_hz`."""
        ...

    def pulses(self, host: StreamHost) -> Iterator[TriggerPulse]:
        """Start emitting and yield each pulse after it was emitted, until the last or `stopping`."""
        ...

    def disarm(self) -> None:
        """Stop emitting at once; legal in every state."""
        ...

    def close(self) -> None:
        """Let go of the device; legal in every state."""
        ...


Device: TypeAlias = Camera | WaveProbe | TriggerSource


@runtime_checkable
class Adopting(Protocol):
    """What drivers may have besides the verbs of their kind, for the reconnect policy ``device_wins``."""

    def adopt(self) -> Settings:
        """Read what is in force on the open device, change nothing there, and return it as `configure` does."""
