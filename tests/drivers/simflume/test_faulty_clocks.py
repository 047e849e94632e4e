"""Pulses lost, late and doubled, pulses that a camera misses, and clocks with jitter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from thermacq.devices import DeviceContext, TriggerMode
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.simflume.camera import SimulatedCamera
from thermacq_drivers.simflume.epoch import DeviceClockSettings
from thermacq_drivers.simflume.trigger import SimulatedTrigger

MakeContext = Callable[..., DeviceContext]
PERIOD_NS = 20_000_000


def pulse_times(context: DeviceContext, host: Any, count: int, **settings: Any) -> np.ndarray:
    source = SimulatedTrigger(context)
    source.open()
    source.configure(settings)
    source.arm(50.0, count)
    pulses = list(source.pulses(host))
    source.close()
    assert [pulse.index for pulse in pulses] == list(range(count))
    return np.array([pulse.host_ns for pulse in pulses])


def test_doubled_pulses_come_twice(context: MakeContext, host: Any) -> None:
    times = pulse_times(context("box"), host, 400, double_probability=0.2, double_s=0.003)
    intervals = np.diff(times)
    assert set(intervals) <= {PERIOD_NS, 3_000_000, PERIOD_NS - 3_000_000}
    doubles = np.count_nonzero(intervals == 3_000_000)
    assert doubles == pytest.approx(400 * 0.2 / 1.2, rel=0.35)


def test_late_pulses_come_late(context: MakeContext, host: Any) -> None:
    times = pulse_times(context("box"), host, 400, late_probability=0.1, late_s=0.005)
    late_ns = times - np.arange(400) * PERIOD_NS
    assert set(late_ns) == {0, 5_000_000}
    assert np.count_nonzero(late_ns) == pytest.approx(40, rel=0.5)


def test_pulses_stay_in_order_whatever_goes_wrong(context: MakeContext, host: Any) -> None:
    wrong = {"late_probability": 0.3, "late_s": 0.05, "double_probability": 0.3, "double_s": 0.05}
    times = pulse_times(context("box"), host, 300, jitter_s=0.005, skip_probability=0.1, **wrong)
    assert np.all(np.diff(times) > 0)
    np.testing.assert_array_equal(
        times, pulse_times(context("box"), host, 300, jitter_s=0.005, skip_probability=0.1, **wrong)
    )


def frames_of(context: DeviceContext, host: Any, pulses: int, **settings: Any) -> list[tuple[int, ...]]:
    """(counter, trigger index, ticks) of the frames that a camera takes on evenly spaced pulses."""
    camera = SimulatedCamera(context)
    camera.open()
    camera.configure(settings)
    camera.arm(TriggerMode.HARDWARE, 50.0)
    line = LineWriter(context.runtime_dir, "trigger")
    line.start_session()
    for index in range(pulses):
        line.emit(index * PERIOD_NS)
    line.finish_session()
    frames = []
    for frame in camera.frames(host):
        frames.append((frame.counter, frame.trigger_index, frame.ticks))
        if frame.trigger_index >= pulses - 3:
            break
    camera.close()
    return frames


def test_a_missed_pulse_leaves_no_gap_of_the_counter(
    context: MakeContext, small: dict[str, Any], host: Any
) -> None:
    loop = {"cached_loop_frames": 1}
    frames = frames_of(context(scene={"seed": 3}), host, 500, **small, **loop, missed_pulse_probability=0.1)
    counters, indices, ticks = np.array(frames).T
    np.testing.assert_array_equal(counters, np.arange(len(counters)))
    assert 500 - len(indices) == pytest.approx(50, rel=0.4)
    np.testing.assert_array_equal(ticks, indices * 20_000)


def test_jitter_of_a_clock_is_in_the_ticks_only(
    context: MakeContext, small: dict[str, Any], host: Any
) -> None:
    clock = {"offset_s": 1.0, "jitter_s": 1e-4, "tick_rate_hz": 1e7}
    frames = np.array(frames_of(context(), host, 303, **small, cached_loop_frames=1, clock=clock))
    error_s = frames[:, 2] / 1e7 - 1.0 - frames[:, 1] * 0.02
    assert error_s.std() == pytest.approx(1e-4, rel=0.15)
    settings = DeviceClockSettings.model_validate(clock)
    drawn_s = np.concatenate([settings.drawn_jitter_s(1, "left", int(number)) for number in frames[:, 0]])
    np.testing.assert_allclose(error_s, drawn_s, atol=6e-8)


def test_a_clock_never_reads_below_zero() -> None:
    with pytest.raises(ValidationError, match="no clock reads below 0"):
        DeviceClockSettings(jitter_s=1e-3)
    assert DeviceClockSettings(offset_s=1.0, jitter_s=1e-3).drawn_jitter_s(1, "a", 0, 9).shape == (9,)
    assert not DeviceClockSettings().drawn_jitter_s(1, "a", 0, 9).any()
