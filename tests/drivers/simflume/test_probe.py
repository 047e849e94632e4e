from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from thermacq.devices import DeviceContext, SampleBlock, WaveProbe
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.simflume.probe import SimulatedProbe
from thermacq_drivers.simflume.scene import build_surface
from thermacq_drivers.simflume.settings import parse_scene

MakeContext = Callable[..., DeviceContext]


def armed(context: DeviceContext, settings: dict[str, Any]) -> SimulatedProbe:
    probe = SimulatedProbe(context)
    probe.open()
    probe.configure(settings)
    probe.arm()
    return probe


def take(probe: SimulatedProbe, host: Any, blocks: int) -> list[SampleBlock]:
    stream = probe.samples(host)
    return [next(stream) for _ in range(blocks)]


def test_it_is_a_wave_probe(context: MakeContext) -> None:
    probe = SimulatedProbe(context("p"))
    assert isinstance(probe, WaveProbe)
    assert probe.open().driver == "sim-probe"
    assert probe.configure({})["volts_per_m"] == 20.0
    assert probe.capabilities.unit == "V"


def test_the_series_is_the_surface_with_the_stated_errors(
    context: MakeContext, wave: dict[str, Any], host: Any
) -> None:
    settings = {
        "x_m": 0.31,
        "y_m": 0.02,
        "sample_rate_hz": 200,
        "volts_per_m": 10.0,
        "zero_v": 1.5,
        "coefficient_error": 0.02,
        "noise_m": 0.0004,
        "clock": {"offset_s": 3.0, "drift_ppm": 200.0, "tick_rate_hz": 1e7},
    }
    blocks = take(armed(context(scene=wave), settings), host, 50)
    values = np.concatenate([block.values for block in blocks])[:, 0]
    ticks = np.concatenate([block.ticks for block in blocks])
    np.testing.assert_array_equal(np.diff(ticks), 50_000)
    assert ticks[0] == 30_000_000
    scene_s = (ticks / 1e7 - 3.0) / 1.0002
    eta = build_surface(parse_scene(wave)).elevation(np.full(1, 0.31), np.full(1, 0.02), scene_s)
    error_m = (values - 1.5) / (10.0 * 1.02) - eta
    assert error_m.std() == pytest.approx(0.0004, rel=0.1)
    assert abs(error_m.mean()) < 0.0001
    slope = np.polyfit(eta, (values - 1.5) / 10.0, 1)[0]
    assert slope == pytest.approx(1.02, abs=0.002)
    assert [block.first_index for block in blocks[:3]] == [0, 20, 40]
    assert all(block.host_ns >= scene * 1e9 - 1 for block, scene in zip(blocks, scene_s[19::20], strict=True))


def test_blocks_are_reproducible(context: MakeContext, wave: dict[str, Any], host: Any) -> None:
    first, second = (take(armed(context(scene=wave), {}), host, 3) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.values, other.values)
        np.testing.assert_array_equal(one.ticks, other.ticks)


def test_blocks_last_at_most_a_quarter_second(context: MakeContext, host: Any) -> None:
    for rate_hz in (5, 200, 10_000):
        (block,) = take(armed(context(), {"sample_rate_hz": rate_hz}), host, 1)
        assert (len(block.values) - 1) / rate_hz <= 0.25


def test_channels_have_noise_of_their_own(context: MakeContext, host: Any) -> None:
    (block,) = take(armed(context(), {"channels": ["a", "b"]}), host, 1)
    assert block.values.shape == (20, 2)
    assert np.abs(block.values[:, 0] - block.values[:, 1]).max() > 0


def test_pulses_of_the_line_are_stamped_in_virtual_time(context: MakeContext, host: Any) -> None:
    made = context()
    probe = armed(made, {"line": "trigger", "clock": {"offset_s": 1.0}})
    assert probe.capabilities.has_trigger_line
    line = LineWriter(made.runtime_dir, "trigger")
    line.start_session()
    for index in range(10):
        line.emit(index * 20_000_000)
    line.finish_session()
    pulses = np.concatenate([block.pulse_ticks for block in take(probe, host, 3)])
    np.testing.assert_array_equal(pulses, 1_000_000 + np.arange(10) * 20_000)
    probe.close()


def test_a_line_that_nobody_pulses_is_a_timeout(context: MakeContext, host: Any) -> None:
    probe = armed(context(), {"line": "trigger", "timeout_s": 0.05})
    with pytest.raises(DeviceTimeout, match="is its source armed"):
        take(probe, host, 1)
    probe.close()


def test_garbage(context: MakeContext, host: Any) -> None:
    blocks = take(armed(context(), {"garbage_from_s": 0.1}), host, 2)
    assert np.abs(blocks[0].values).max() < 1
    assert not np.isfinite(blocks[1].values).all() or np.abs(blocks[1].values).max() > 1e5


def test_silence_and_disconnection(context: MakeContext, host: Any) -> None:
    silent = armed(context(), {"silent_from_s": 0.0, "timeout_s": 0.05})
    with pytest.raises(DeviceTimeout, match="no samples"):
        take(silent, host, 1)
    gone = armed(context(), {"fail_at_s": 0.15})
    with pytest.raises(DeviceDisconnected) as caught:
        take(gone, host, 2)
    assert caught.value.last_frame == 19
    gone.disarm()


def test_stopping_and_wrong_states(context: MakeContext, host: Any) -> None:
    probe = SimulatedProbe(context())
    probe.close()
    with pytest.raises(DeviceFault, match="not open"):
        probe.arm()
    probe.open()
    with pytest.raises(DeviceFault, match="not armed"):
        next(probe.samples(host))
    with pytest.raises(DeviceFault, match="distinct"):
        probe.configure({"channels": ["a", "a"]})
    with pytest.raises(DeviceFault, match="did you mean 'noise_m'"):
        probe.configure({"noise": 1})
    probe.arm()
    host.stop = True
    assert next(probe.samples(host), None) is None
    probe.close()
