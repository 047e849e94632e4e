"""What holds for cameras: buffers, counters, clocks, triggers, and declared against real abilities."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np

from thermacq.devices import CameraCapabilities, Counts, Frame, FrameFlag, TriggerMode
from thermacq.errors import ThermacqError
from thermacq.testing.bench import Bench, NotApplicable, Subject, demand, demand_abort, demand_end
from thermacq.testing.streams import (
    GENTLE_RATE_HZ,
    SENTINEL,
    FrameSink,
    demand_same_pace,
    sensible_mode,
    take_frames,
)

_TRIGGER_RETURNS_S = 1.0


def frames_fill_the_buffer(subject: Subject) -> None:
    """A frame's counts are the very buffer that the host handed out, completely filled."""
    with subject.bench() as bench:
        declared = _start(bench)

        def look(frame: Frame, handed: Counts | None) -> None:
            demand(
                isinstance(frame, Frame),
                f"frames() yielded a {type(frame).__name__}: yield thermacq.devices.Frame",
            )
            demand(handed is not None, "a frame came without host.buffer() having been asked for its buffer")
            if handed is None:
                return
            counts = frame.counts
            demand(
                counts.shape == (declared.rows, declared.columns) and counts.dtype == np.uint16,
                f"frame.counts is {counts.shape} {counts.dtype}: yield the buffer, "
                f"({declared.rows}, {declared.columns}) uint16",
            )
            demand(
                np.shares_memory(counts, handed) and counts.ctypes.data == handed.ctypes.data,
                "frame.counts is not the buffer that host.buffer() handed out: copy the picture into it",
            )
            empty_rows = int(np.sum(np.all(counts == SENTINEL, axis=1)))
            demand(empty_rows == 0, f"{empty_rows} rows of the buffer were left as they were: fill all of it")
            high = int(counts.max())
            demand(
                high < 2**declared.bit_depth,
                f"a count of {high} needs more than the declared bit_depth of {declared.bit_depth}",
            )

        take_frames(bench, _arm(bench), 10, look=look)


def counter_is_consistent(subject: Subject) -> None:
    """The frame counter has the declared width, rises, and wraps only at that width."""
    with subject.bench() as bench:
        declared = _start(bench)
        mode = sensible_mode(declared)
        bench.verb("arm", mode, declared.max_frame_rate_hz)
        counters = [frame.counter for frame in take_frames(bench, mode, 200, for_s=1.0)]
        _demand_some(counters)
        if declared.counter_bits == 0:
            demand(set(counters) == {-1}, "counter_bits is 0: yield counter=-1, or declare the width")
            return
        modulus = 2**declared.counter_bits
        demand(
            all(0 <= counter < modulus for counter in counters),
            f"counters from {min(counters)} to {max(counters)} do not fit in the declared "
            f"{declared.counter_bits} bits",
        )
        for one, following in pairwise(counters):
            step = (following - one) % modulus
            demand(
                0 < step < modulus // 2,
                f"the counter goes from {one} to {following}: with {declared.counter_bits} bits that is no step "
                "forward; declare the width at which the device really wraps",
            )


def ticks_follow_the_declared_rate(subject: Subject) -> None:
    """Device ticks rise, and a second of host time is a second of ticks (within 25 %)."""
    with subject.bench() as bench:
        declared = _start(bench)
        mode = sensible_mode(declared)

        def pace() -> tuple[float, float]:
            bench.verb("arm", mode, _gentle(declared))
            frames = take_frames(bench, mode, 10**6, for_s=1.0)
            bench.verb("disarm")
            _demand_some(frames)
            ticks = [frame.ticks for frame in frames]
            if declared.tick_rate_hz == 0:
                demand(set(ticks) == {-1}, "tick_rate_hz is 0: yield ticks=-1, or declare the rate")
                return 0.0, 0.0
            _demand_rising("ticks", ticks)
            device_s = (ticks[-1] - ticks[0]) / declared.tick_rate_hz
            return device_s, (frames[-1].host_ns - frames[0].host_ns) / 1e9

        demand_same_pace(declared.tick_rate_hz, pace)


def host_times_are_of_the_hosts_clock(subject: Subject) -> None:
    """`host_ns` comes from the clock in the context, and never goes back."""
    with subject.bench() as bench:
        _start(bench)
        before_ns = bench.clock.now_ns()
        times = [frame.host_ns for frame in take_frames(bench, _arm(bench), 10)]
        _demand_some(times)
        demand(
            before_ns <= times[0] and times[-1] <= bench.clock.now_ns(),
            "host_ns is not of the host's clock: use context.clock.now_ns() when the frame is in the buffer",
        )
        demand(all(one <= two for one, two in pairwise(times)), "host_ns goes back between two frames")


def flags_and_temperatures_are_as_declared(subject: Subject) -> None:
    """Temperatures and shutter flags come exactly when they are declared."""
    with subject.bench() as bench:
        declared = _start(bench)
        for frame in take_frames(bench, _arm(bench), 5):
            known = not np.isnan(frame.fpa_temperature_k)
            demand(
                known == declared.has_temperature,
                f"fpa_temperature_k is {frame.fpa_temperature_k} but has_temperature is {declared.has_temperature}",
            )
            demand(
                not known or 150 < frame.fpa_temperature_k < 400,
                f"fpa_temperature_k is {frame.fpa_temperature_k}: give kelvin",
            )
            demand(
                declared.has_shutter or FrameFlag.SHUTTER not in frame.flags,
                "a frame is flagged SHUTTER but has_shutter is False",
            )


def software_triggers_give_their_index(subject: Subject) -> None:
    """In mode ``software`` each trigger makes one frame, which carries the index of the trigger."""
    indices = [0, 1, 2, 5, 6, 1000]
    with subject.bench() as bench:
        declared = _start(bench)
        if TriggerMode.SOFTWARE not in declared.trigger_modes:
            raise NotApplicable("mode 'software' is not declared")
        bench.verb("arm", TriggerMode.SOFTWARE, _gentle(declared))
        frames = take_frames(bench, TriggerMode.SOFTWARE, len(indices), triggers=iter(indices))
        got = [frame.trigger_index for frame in frames]
        demand(got == indices, f"triggers {indices} made frames with trigger_index {got}")


def trigger_returns_at_once(subject: Subject) -> None:
    """`trigger` starts an exposure and does not wait for the frame."""
    with subject.bench() as bench:
        declared = _start(bench)
        if TriggerMode.SOFTWARE not in declared.trigger_modes:
            raise NotApplicable("mode 'software' is not declared")
        bench.verb("arm", TriggerMode.SOFTWARE, _gentle(declared))
        took_s = []
        for index in range(2):
            start_s = time.monotonic()
            bench.verb("trigger", index)
            took_s.append(time.monotonic() - start_s)
        demand(
            min(took_s) < _TRIGGER_RETURNS_S,
            f"trigger() took {min(took_s):.2g} s: return at once and wait for the frame in frames()",
        )


def free_running_frames_have_no_trigger(subject: Subject) -> None:
    """In mode ``free_run`` no frame claims a trigger."""
    with subject.bench() as bench:
        declared = _start(bench)
        if TriggerMode.FREE_RUN not in declared.trigger_modes:
            raise NotApplicable("mode 'free_run' is not declared")
        bench.verb("arm", TriggerMode.FREE_RUN, _gentle(declared))
        claimed = {frame.trigger_index for frame in take_frames(bench, TriggerMode.FREE_RUN, 3)}
        demand(claimed == {-1}, f"free-running frames carry trigger_index {sorted(claimed)}: give -1")


def only_declared_modes_are_accepted(subject: Subject) -> None:
    """`arm` takes every declared trigger mode and refuses all others."""
    with subject.bench() as bench:
        declared = _start(bench)
        for mode in TriggerMode:
            if mode in declared.trigger_modes:
                bench.verb("arm", mode, _gentle(declared))
                bench.verb("disarm")
            else:
                why = "declare the mode in capabilities.trigger_modes, or refuse it"
                bench.refused(why, "arm", mode, _gentle(declared))


def frame_rates_are_kept_or_refused(subject: Subject) -> None:
    """`arm` refuses more than the declared rate; a free-running camera keeps the rate that it took."""
    with subject.bench() as bench:
        declared = _start(bench)
        mode = sensible_mode(declared)
        fastest_hz = declared.max_frame_rate_hz
        why = f"the declared max_frame_rate_hz is {fastest_hz:g}"
        bench.refused(why, "arm", mode, 2 * fastest_hz)
        bench.verb("arm", mode, fastest_hz)
        frames = take_frames(bench, mode, 50, for_s=1.5)
        timed = declared.tick_rate_hz > 0 and declared.counter_bits > 0
        if mode is not TriggerMode.FREE_RUN or not timed or len(frames) < 3:
            return
        steps = (frames[-1].counter - frames[0].counter) % 2**declared.counter_bits
        rate_hz = steps * declared.tick_rate_hz / (frames[-1].ticks - frames[0].ticks)
        demand(
            abs(rate_hz / fastest_hz - 1) < 0.02,
            f"armed at {fastest_hz:g} frames/s the camera makes {rate_hz:.4g}, by its own counter and ticks",
        )


def waiting_for_a_trigger_can_be_aborted(subject: Subject) -> None:
    """A camera that waits for a trigger that never comes ends soon after the host asks it to."""
    with subject.bench() as bench:
        declared = _start(bench)
        waiting = sorted(declared.trigger_modes - {TriggerMode.FREE_RUN})
        if not waiting:
            raise NotApplicable("no triggered mode is declared")
        for mode in waiting:
            bench.verb("arm", mode, _gentle(declared))
            host = FrameSink(declared.rows, declared.columns)
            frame = demand_abort(bench, "frames", host, bench.device.frames(host))
            demand(frame is None, f"in mode '{mode}' a frame came without a trigger")
            bench.verb("disarm")


def waiting_for_a_slow_frame_can_be_aborted(subject: Subject) -> None:
    """A camera that runs free at one frame in ten seconds ends soon after the host asks it to."""
    with subject.bench() as bench:
        declared = _start(bench)
        if TriggerMode.FREE_RUN not in declared.trigger_modes:
            raise NotApplicable("mode 'free_run' is not declared")
        try:
            bench.do("arm()", lambda: bench.device.arm(TriggerMode.FREE_RUN, 0.1))
        except ThermacqError as error:
            raise NotApplicable(f"it does not run this slowly: {error}") from None
        host = FrameSink(declared.rows, declared.columns)
        generator = bench.device.frames(host)
        demand_abort(bench, "frames", host, generator)
        demand_end(bench, "frames", host, generator)


def _start(bench: Bench) -> CameraCapabilities:
    bench.start()
    declared: CameraCapabilities = bench.capabilities
    return declared


def _gentle(declared: CameraCapabilities) -> float:
    return min(GENTLE_RATE_HZ, declared.max_frame_rate_hz)


def _arm(bench: Bench) -> TriggerMode:
    mode = sensible_mode(bench.capabilities)
    bench.verb("arm", mode, _gentle(bench.capabilities))
    return mode


def _demand_some(items: list[int] | list[Frame]) -> None:
    demand(len(items) >= 3, f"only {len(items)} frames came")


def _demand_rising(name: str, values: list[int]) -> None:
    for one, two in pairwise(values):
        demand(one < two, f"{name} goes from {one} to {two}: it must rise from frame to frame")
