"""What each kind of wave gauge makes of the water, against formulas."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import j1

from thermacq.devices import DeviceContext
from thermacq.errors import DeviceFault
from thermacq.plugins import plugins
from thermacq.rig import parse_rig
from thermacq_drivers.simflume.epoch import DeviceClockSettings
from thermacq_drivers.simflume.gauges import disc_mean, steps
from thermacq_drivers.simflume.probe import SimulatedProbe
from thermacq_drivers.simflume.ready_made import rig_toml
from thermacq_drivers.simflume.scene import build_surface
from thermacq_drivers.simflume.settings import parse_scene

MakeContext = Callable[..., DeviceContext]
RATE_HZ = 200.0
CYLINDER = {"cylinder": {"x_m": 0.42, "y_m": -0.03, "radius_m": 0.06}}


def readings_m(context: DeviceContext, host: Any, seconds: float, **settings: Any) -> tuple[Any, Any]:
    """Times of the scene and readings in metres of a probe without noise, both (samples,); NaN: a gap."""
    probe = SimulatedProbe(context)
    probe.open()
    probe.configure({"noise_m": 0.0, "volts_per_m": 10.0, **settings})
    probe.arm()
    stream = probe.samples(host)
    values = np.full(round(seconds * RATE_HZ), np.nan)
    for block in stream:
        assert np.isfinite(block.values).all()
        np.testing.assert_array_equal(np.diff(block.ticks), 1e6 / RATE_HZ)
        left = values[block.first_index :]
        left[: len(block.values)] = block.values[: left.size, 0]
        if len(block.values) >= left.size:
            break
    probe.close()
    return np.arange(values.size) / RATE_HZ, values / 10.0


def true_m(scene: dict[str, Any], time_s: Any) -> Any:
    place = np.full(time_s.shape, 0.25), np.full(time_s.shape, -0.03)
    return build_surface(parse_scene(scene)).elevation(*place, time_s)


def test_the_meniscus_lags_behind_the_water(context: MakeContext, wave: dict[str, Any], host: Any) -> None:
    time_s, read_m = readings_m(context(scene=wave), host, 2.0, kind="capacitance", meniscus_m=0.0006)
    rate = (true_m(wave, time_s + 1e-5) - true_m(wave, time_s - 1e-5)) / 2e-5
    error_m = read_m - true_m(wave, time_s)
    moving = np.abs(rate) > 0.05
    assert np.count_nonzero(moving) > 300
    np.testing.assert_allclose(error_m[moving], -0.0006 * np.sign(rate[moving]), atol=1e-7)
    np.testing.assert_allclose(error_m, -0.0006 * np.tanh(rate / 0.01), atol=2e-6)


def test_a_capacitance_gauge_in_still_water_has_no_hysteresis(context: MakeContext, host: Any) -> None:
    assert not readings_m(context(), host, 0.5, kind="capacitance")[1].any()


def test_static_immersion_replaces_the_waves(context: MakeContext, wave: dict[str, Any], host: Any) -> None:
    levels = (-0.05, 0.0, 0.05, 0.0)
    settings = {"immersion_steps_m": levels, "seconds_per_step": 0.5, "coefficient_error": 0.01}
    time_s, read_m = readings_m(context(scene=wave), host, 2.5, **settings)
    seen = np.array([*levels, levels[-1]])[(time_s / 0.5).astype(int)]
    np.testing.assert_allclose(read_m, 1.01 * seen, atol=1e-12)
    _, hung_m = readings_m(context(scene=wave), host, 2.5, kind="capacitance", **settings)
    direction = np.array([-1, 1, 1, -1, -1])[(time_s / 0.5).astype(int)]
    np.testing.assert_allclose(hung_m, 1.01 * (seen - 0.0005 * direction), atol=1e-12)


@given(st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=6), st.floats(0.1, 10))
def test_steps_hold_for_their_time(levels_m: list[float], seconds: float) -> None:
    middle_s = (np.arange(len(levels_m)) + 0.5) * seconds
    np.testing.assert_array_equal(steps(levels_m, seconds, middle_s)[0], levels_m)
    assert steps(levels_m, seconds, np.array([1e4]))[0] == levels_m[-1]


def test_the_coefficient_drifts_with_the_water(context: MakeContext, host: Any) -> None:
    scene = {"water_temperature_k": 297.0}
    temperature = {
        "coefficient_per_k": 0.02,
        "calibrated_at_k": 295.0,
        "warming_k_per_h": 90.0,
        "immersed_m": 0.3,
    }
    settings = {"immersion_steps_m": (0.1,), "temperature": temperature}
    time_s, read_m = readings_m(context(scene=scene), host, 4.0, **settings)
    gain = 1 + 0.02 * (2.0 + time_s / 40)
    np.testing.assert_allclose(read_m, gain * 0.4 - 0.3, atol=1e-12)
    assert read_m[0] == pytest.approx(0.116)


def test_a_footprint_averages_a_wave_as_theory_says() -> None:
    wave = {"surface": {"kind": "regular", "period_s": 0.55, "steepness": 0.005}}
    surface = build_surface(parse_scene(wave))
    time_s, radius_m = np.linspace(0, 0.55, 50, endpoint=False), 0.05
    mean = disc_mean(surface, 0.25, -0.03, radius_m, time_s)
    k = surface.wavenumber_rad_m
    first = [abs(np.fft.rfft(series)[1]) for series in (mean, true_m(wave, time_s))]
    assert first[0] / first[1] == pytest.approx(2 * j1(k * radius_m) / (k * radius_m), abs=1e-5)
    assert first[0] / first[1] < 0.96


def test_an_ultrasonic_gauge_holds_each_ping(context: MakeContext, host: Any) -> None:
    wave = {"surface": {"kind": "regular", "period_s": 0.8, "steepness": 0.02}}
    sonic = {"ping_rate_hz": 40.0, "footprint_radius_m": 0.015, "dropout_probability": 0.0}
    time_s, read_m = readings_m(context(scene=wave), host, 1.0, kind="ultrasonic", ultrasonic=sonic)
    held = read_m.reshape(-1, 5)
    np.testing.assert_array_equal(held, held[:, :1].repeat(5, axis=1))
    surface = build_surface(parse_scene(wave))
    np.testing.assert_allclose(
        held[:, 0], disc_mean(surface, 0.25, -0.03, 0.015, time_s[::5]), rtol=0, atol=1e-12
    )


def test_echoes_are_lost_on_slopes_and_at_random(
    context: MakeContext, wave: dict[str, Any], host: Any
) -> None:
    sonic = {"ping_rate_hz": RATE_HZ, "slope_limit": 0.1, "dropout_probability": 0.0}
    time_s, read_m = readings_m(context(scene=wave), host, 2.0, kind="ultrasonic", ultrasonic=sonic)
    place = np.full(time_s.shape, 0.25), np.full(time_s.shape, -0.03)
    slope = np.hypot(*build_surface(parse_scene(wave)).slope(*place, time_s))
    np.testing.assert_array_equal(np.isnan(read_m), slope > 0.1)
    assert 0.1 < np.isnan(read_m).mean() < 0.9
    sonic = {"ping_rate_hz": RATE_HZ, "dropout_probability": 0.1}
    runs = [readings_m(context(), host, 10.0, kind="ultrasonic", ultrasonic=sonic)[1] for _ in range(2)]
    assert np.isnan(runs[0]).mean() == pytest.approx(0.1, abs=0.03)
    np.testing.assert_array_equal(*runs)


def test_jitter_moves_the_samples_not_their_stamps(
    context: MakeContext, wave: dict[str, Any], host: Any
) -> None:
    clock = {"offset_s": 1.0, "jitter_s": 0.001}
    time_s, read_m = readings_m(context("p", scene=wave), host, 2.0, clock=clock)
    settings = DeviceClockSettings.model_validate(clock)
    jitter_s = np.concatenate([settings.drawn_jitter_s(1, "p", first, 20) for first in range(0, 400, 20)])
    assert jitter_s.std() == pytest.approx(0.001, rel=0.15)
    np.testing.assert_allclose(read_m, true_m(wave, time_s - jitter_s), atol=1e-9)


def test_a_probe_inside_the_cylinder_is_refused(context: MakeContext) -> None:
    probe = SimulatedProbe(context(scene=CYLINDER))
    probe.open()
    with pytest.raises(DeviceFault, match="stands inside the cylinder of radius"):
        probe.configure({"x_m": 0.40})
    probe.configure({"x_m": 0.35})
    with pytest.raises(DeviceFault, match="its footprint reaches the cylinder"):
        probe.configure({"x_m": 0.35, "kind": "ultrasonic"})
    text = rig_toml("two-pairs").replace("x_m = 0.26", "x_m = 0.4")
    (finding,) = plugins().rig_checks(parse_rig(text))
    assert finding.severity == "error"
    assert "'probe': it stands inside the cylinder" in finding.message
