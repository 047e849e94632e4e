"""Run a device for a moment, as the host does, and keep what it delivered."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from thermacq.devices import (
    CameraCapabilities,
    Counts,
    DeviceKind,
    Frame,
    SampleBlock,
    TriggerCapabilities,
    TriggerMode,
    TriggerPulse,
)
from thermacq.errors import DeviceFault, DeviceOverrun, IncompleteFrame
from thermacq.testing.bench import Bench, Nonconformity, NotApplicable, StopSwitch, demand_end

GENTLE_RATE_HZ = 30.0
_LONGEST_S = 10.0
_BUFFERS = 8
SENTINEL = 0xA5C3
"""Every buffer is full of this before it is handed out."""


class FrameSink(StopSwitch):
    """The host's side of a camera's acquisition: a small ring of buffers, and what came in them."""

    def __init__(self, rows: int, columns: int) -> None:
        super().__init__()
        self._ring = np.full((_BUFFERS, rows, columns), SENTINEL, np.uint16)
        self._taken = 0
        self.handed: Counts | None = None

    def buffer(self) -> Counts:
        """Hand out the next buffer, the same one until `advance`."""
        self.handed = self._ring[self._taken % _BUFFERS]
        return self.handed

    def advance(self) -> None:
        """Take the next buffer from now on."""
        self._taken += 1
        self.handed = None
        self._ring[self._taken % _BUFFERS] = SENTINEL


def ignore(frame: Frame, handed: Counts | None) -> None:
    """Look at no frame in particular."""


def sensible_mode(capabilities: CameraCapabilities) -> TriggerMode:
    """A mode in which frames come without a trigger line."""
    for mode in (TriggerMode.FREE_RUN, TriggerMode.SOFTWARE):
        if mode in capabilities.trigger_modes:
            return mode
    raise NotApplicable("frames need pulses on a hardware line, which this suite does not have")


def begin(kind: DeviceKind, bench: Bench) -> None:
    """Arm the device at a gentle rate."""
    if kind is DeviceKind.CAMERA:
        capabilities = bench.capabilities
        rate_hz = min(GENTLE_RATE_HZ, capabilities.max_frame_rate_hz)
        bench.verb("arm", sensible_mode(capabilities), rate_hz)
    elif kind is DeviceKind.WAVE_PROBE:
        bench.verb("arm")
    else:
        bench.verb("arm", gentle_pulse_rate_hz(bench.capabilities), None)


def gentle_pulse_rate_hz(declared: TriggerCapabilities) -> float:
    """A gentle rate whose period lies on the grid of the source."""
    step_s = declared.period_step_s
    period_s = 1 / min(GENTLE_RATE_HZ, declared.max_rate_hz)
    return 1 / (max(1, round(period_s / step_s)) * step_s if step_s > 0 else period_s)


def run_briefly(kind: DeviceKind, bench: Bench, leave_running: bool = False) -> None:
    """Arm, take two items, end and disarm; `leave_running` stops after the two items."""
    begin(kind, bench)
    if kind is DeviceKind.CAMERA:
        take_frames(bench, sensible_mode(bench.capabilities), 2, leave_running=leave_running)
    else:
        take_items(bench, "samples" if kind is DeviceKind.WAVE_PROBE else "pulses", 2, 5.0, leave_running)
    if not leave_running:
        bench.verb("disarm")


def take_frames(
    bench: Bench,
    mode: TriggerMode,
    number: int,
    *,
    for_s: float = _LONGEST_S,
    look: Callable[[Frame, Counts | None], None] = ignore,
    triggers: Iterator[int] | None = None,
    leave_running: bool = False,
) -> list[Frame]:
    """Take frames from an armed camera, going on after a lost one as the host does.

    Parameters
    ----------
    bench
        Holds the armed camera.
    mode
        The mode it was armed in.
    number, for_s
        Ends after so many frames or seconds, whichever comes first.
    look
        Called with each frame and the buffer that was handed out for it, before the buffer is used again.
    triggers
        Trigger indices for mode ``software``; 0, 1, 2 ... by default.
    leave_running
        Leaves the generator suspended instead of ending it.

    Returns
    -------
    list of Frame
        Their counts belong to buffers that were used again: only `look` sees the true ones.
    """
    capabilities = bench.capabilities
    host = FrameSink(capabilities.rows, capabilities.columns)
    indices = iter(range(10**9)) if triggers is None else triggers
    frames: list[Frame] = []
    generator: list[Any] = []

    def stream() -> None:
        generator[:] = [bench.device.frames(host)]
        deadline_s = time.monotonic() + for_s
        while len(frames) < number and time.monotonic() < deadline_s:
            if mode is TriggerMode.SOFTWARE:
                bench.device.trigger(next(indices))
            try:
                frame = next(generator[0])
            except (IncompleteFrame, DeviceOverrun):
                generator[:] = [bench.device.frames(host)]
                continue
            look(frame, host.handed)
            frames.append(frame)
            host.advance()

    _run_stream(bench, "frames", stream, for_s)
    if not leave_running:
        demand_end(bench, "frames", host, generator[0])
    return frames


def take_items(
    bench: Bench, stream: str, number: int, for_s: float = _LONGEST_S, leave_running: bool = False
) -> list[Any]:
    """Take sample blocks (`stream` is ``samples``) or pulses (``pulses``) from an armed device."""
    host = StopSwitch()
    items: list[SampleBlock | TriggerPulse] = []
    generator: list[Any] = []

    def run() -> None:
        generator[:] = [getattr(bench.device, stream)(host)]
        deadline_s = time.monotonic() + for_s
        while len(items) < number and time.monotonic() < deadline_s:
            items.append(next(generator[0]))

    _run_stream(bench, stream, run, for_s)
    if not leave_running:
        demand_end(bench, stream, host, generator[0])
    return items


def demand_same_pace(tick_rate_hz: float, pace: Callable[[], tuple[float, float]]) -> None:
    """Demand that device and host agree on how much time passed.

    Parameters
    ----------
    tick_rate_hz
        The declared rate of the device's clock.
    pace
        Runs the device for a moment and returns seconds by its ticks and by the host's clock. One run of
        three must agree: a busy computer delays the receipt, a wrong rate is always wrong.
    """
    for _ in range(3):
        device_s, host_s = pace()
        if abs(device_s - host_s) <= 0.25 * host_s + 0.1:
            return
    raise Nonconformity(
        f"the ticks say that {device_s:.3g} s passed, the host says {host_s:.3g} s: declare the tick_rate_hz "
        f"at which the device counts, not {tick_rate_hz:g}"
    )


def _run_stream(bench: Bench, stream: str, run: Callable[[], None], for_s: float) -> None:
    """Run the host's loop; an early end or an untyped error is a fault of the driver."""
    try:
        bench.do(f"{stream}()", run, for_s + _LONGEST_S)
    except (Nonconformity, NotApplicable, DeviceFault):
        raise
    except StopIteration:
        raise Nonconformity(f"{stream}() ended although the host did not ask it to") from None
    except Exception as error:
        raise Nonconformity(
            f"{stream}() raised {type(error).__name__}: {error}: report faults as the typed errors of "
            "thermacq.errors"
        ) from error
