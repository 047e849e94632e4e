from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thermacq.devices import DeviceContext, TriggerSource
from thermacq.errors import DeviceDisconnected, DeviceFault
from thermacq.timing import RealClock, VirtualClock
from thermacq.timing.trigger_line import LineReader, LineWriter
from thermacq_drivers.simflume.epoch import DeviceClockSettings, SceneTime
from thermacq_drivers.simflume.trigger import SimulatedTrigger

MakeContext = Callable[..., DeviceContext]


def armed(context: DeviceContext, settings: dict[str, Any], count: int | None) -> SimulatedTrigger:
    source = SimulatedTrigger(context)
    source.open()
    source.configure(settings)
    source.arm(50.0, count)
    return source


def test_pulses_come_at_the_rate_asked(context: MakeContext, host: Any) -> None:
    source = armed(context("box"), {}, 5)
    assert isinstance(source, TriggerSource)
    pulses = list(source.pulses(host))
    assert [pulse.index for pulse in pulses] == list(range(5))
    assert [pulse.host_ns for pulse in pulses] == [index * 20_000_000 for index in range(5)]
    source.close()


def test_jitter_drift_and_skipped_pulses(context: MakeContext, host: Any) -> None:
    settings = {"jitter_s": 1e-4, "drift_ppm": 1000.0, "skip_probability": 0.3}
    times = np.array([pulse.host_ns for pulse in armed(context("box"), settings, 200).pulses(host)])
    cycles = np.rint(times / 19_980_020)
    assert cycles[-1] == pytest.approx(200 / 0.7, rel=0.2)
    jitter_ns = times - cycles * 20e6 / 1.001
    assert jitter_ns.std() == pytest.approx(1e5, rel=0.2)


def test_followers_see_what_the_source_emits(context: MakeContext, host: Any, tmp_path: Path) -> None:
    follower = LineReader(tmp_path, "trigger")
    source = armed(context("box"), {}, 3)
    emitted = [(pulse.index, pulse.host_ns) for pulse in source.pulses(host)]
    assert [follower.take() for _ in range(follower.waiting)] == emitted
    assert follower.finished
    follower.close()


def test_in_virtual_time_the_source_waits_for_its_followers(
    context: MakeContext, host: Any, tmp_path: Path
) -> None:
    follower = LineReader(tmp_path, "trigger")
    source = armed(context("box"), {}, None)
    runner = threading.Thread(target=lambda: list(source.pulses(host)))
    runner.start()
    taken = 0
    while taken < 200:
        assert follower.waiting <= 64
        while follower.waiting:
            follower.take()
            taken += 1
    host.stop = True
    runner.join(5)
    assert not runner.is_alive()
    follower.close()
    source.close()


def test_unplugged_and_wrong_states(context: MakeContext, host: Any) -> None:
    source = armed(context("box"), {"fail_at_pulse": 2}, 5)
    stream = source.pulses(host)
    next(stream), next(stream)
    with pytest.raises(DeviceDisconnected):
        next(stream)
    source.disarm()
    with pytest.raises(DeviceFault, match="not open"):
        source.arm(50.0, 1)
    with pytest.raises(DeviceDisconnected):
        source.open()
    source = armed(context("box"), {}, 5)
    with pytest.raises(DeviceFault, match="at most 1000"):
        source.arm(5000.0, 1)
    source.disarm()
    with pytest.raises(DeviceFault, match="not armed"):
        next(source.pulses(host))
    source.close()


def test_a_line_serves_one_session_after_the_other(tmp_path: Path) -> None:
    writer = LineWriter(tmp_path, "a")
    first = LineReader(tmp_path, "a")
    assert not first.finished
    writer.start_session()
    writer.emit(10)
    writer.emit(20)
    writer.finish_session()
    assert first.take() == (0, 10)
    assert not first.finished
    assert writer.lead() == 1
    second = LineReader(tmp_path, "a")
    writer.start_session()
    writer.emit(30)
    assert second.waiting == 1
    assert second.take() == (0, 30)
    assert not second.finished
    writer.finish_session()
    assert second.finished
    first.close()
    second.close()
    assert writer.lead() == 0


def test_a_follower_armed_in_mid_session_sees_its_end(tmp_path: Path) -> None:
    writer = LineWriter(tmp_path, "a")
    writer.start_session()
    writer.emit(10)
    late = LineReader(tmp_path, "a")
    assert late.waiting == 0
    writer.finish_session()
    assert late.finished


def test_scene_time_is_agreed_once_in_real_time(tmp_path: Path) -> None:
    first, second = SceneTime(RealClock(), tmp_path), SceneTime(RealClock(), tmp_path)
    assert first.seconds(5_000_000_000) == 0.0
    assert second.seconds(5_500_000_000) == 0.5
    assert second.host_ns(0.5) == 5_500_000_000
    assert [path.name for path in tmp_path.iterdir()] == ["scene-start"]
    assert SceneTime(VirtualClock(), tmp_path).seconds(250_000_000) == 0.25


def test_a_device_clock_reads_offset_and_drift() -> None:
    clock = DeviceClockSettings(offset_s=2.0, drift_ppm=-50.0, tick_rate_hz=1000.0)
    assert clock.ticks(100.0) == round((2.0 + 100.0 * (1 - 50e-6)) * 1000)
    assert clock.scene_s(clock.reading_s(33.3)) == pytest.approx(33.3, abs=1e-12)
    assert clock.host_period_s(1.0) == pytest.approx(1 + 50e-6, abs=1e-8)
