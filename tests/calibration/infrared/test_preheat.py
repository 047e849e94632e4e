"""The preheat monitor against formulas and against the simulator's truth."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from thermacq_calibration import CalibrationError
from thermacq_calibration.infrared.preheat import Grade, PreheatLimits, judge_preheat, preheat_history
from thermacq_calibration.infrared.warm_up import WarmUp
from thermacq_drivers.simflume.camera import CameraSettings, in_condition, make_sensor
from thermacq_drivers.simflume.ready_made import scene_toml
from thermacq_drivers.simflume.sensor_settings import ShutterSettings
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.shutter import Shutter
from thermacq_drivers.simflume.warm_up import fpa_reading, fpa_temperature

STEP_S = 2.0
SHORT = PreheatLimits(minimum_s=0.0, drift_window_s=300.0)


def steady(minutes=10.0, fpa=0.0, drift=0.0, seed=0, period_s=60.0, **changed):
    """Rates in K/min; the shutter takes the drift away every `period_s`, 100 counts per kelvin."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0, 60 * minutes, STEP_S)
    closed = (time_s % period_s) < STEP_S
    values = {
        "time_s": time_s,
        "fpa_temperature_k": 300 + fpa / 60 * time_s + random.normal(0, 0.005, len(time_s)),
        "level_counts": 6000 + 100 * drift / 60 * (time_s % period_s) + random.normal(0, 0.2, len(time_s)),
        "closed": closed,
    }
    return WarmUp(**{**values, **changed})


@pytest.mark.parametrize(
    ("fpa", "grade"), [(0.0, Grade.EXCELLENT), (0.03, Grade.PASS), (-0.03, Grade.PASS), (0.06, Grade.FAIL)]
)
def test_the_slope_of_the_temperature_decides(fpa: float, grade: Grade) -> None:
    found = judge_preheat(steady(fpa=fpa), 100.0, SHORT).fpa
    assert found.grade is grade
    assert found.value == pytest.approx(fpa, abs=4 * found.standard_error)
    # Of a straight line with 5 mK of noise at 150 even times in 300 s.
    assert found.standard_error == pytest.approx(60 * 0.005 / math.sqrt(150 * 300**2 / 12), rel=0.2)


@pytest.mark.parametrize(
    ("drift", "grade"), [(0.0, Grade.EXCELLENT), (0.006, Grade.PASS), (0.02, Grade.FAIL), (-0.02, Grade.FAIL)]
)
@pytest.mark.parametrize("flagged", [True, False])
def test_drift_is_seen_between_corrections_also_when_no_frame_caught_the_shutter(
    drift, grade, flagged
) -> None:
    seen = steady(drift=drift, period_s=180.0)
    if not flagged:
        closed = np.zeros(len(seen.time_s), bool)
        seen = steady(drift=drift, period_s=180.0, closed=closed, is_sparse=True)
    found = judge_preheat(seen, 100.0, SHORT).drift
    assert found.grade is grade
    assert found.value == pytest.approx(drift, abs=4 * found.standard_error)
    assert "between shutter corrections" in found.note


def test_a_restless_view_hides_corrections_that_no_frame_caught() -> None:
    random = np.random.default_rng(5)
    time_s = np.arange(0, 600, STEP_S)
    level = 6000 + 100 * 0.03 / 60 * (time_s % 180) + random.normal(0, 2.5, 300)
    closed = (time_s % 180) < STEP_S
    sparse = steady(level_counts=level, closed=np.zeros(300, bool), is_sparse=True)
    found = judge_preheat(sparse, 100.0, SHORT).drift
    # Taken as one piece the sawtooth would look nearly level.
    assert found.grade is Grade.FAIL
    assert found.value + 2 * found.standard_error > 0.03
    caught = judge_preheat(steady(level_counts=level, closed=closed), 100.0, SHORT).drift
    assert caught.value == pytest.approx(0.03, abs=4 * caught.standard_error)
    assert caught.standard_error < found.standard_error / 2


def test_two_standard_errors_count() -> None:
    random = np.random.default_rng(0)
    noisy = steady(fpa_temperature_k=300 + random.normal(0, 1.0, 300))
    found = judge_preheat(noisy, 100.0, SHORT).fpa
    assert abs(found.value) < found.limit < abs(found.value) + 2 * found.standard_error
    assert found.grade is Grade.FAIL
    assert math.isnan(found.ready_in_s)


def test_samples_that_are_alike_count_less() -> None:
    """The spread of slopes of correlated noise is what their standard errors say."""
    found = []
    for seed in range(200):
        random = np.random.default_rng(seed)
        noise = np.convolve(random.normal(0, 1, 319), 0.8 ** np.arange(20), "valid")
        found.append(judge_preheat(steady(fpa_temperature_k=300 + 0.01 * noise), 100.0, SHORT).fpa)
    spread = np.std([one.value for one in found])
    assert np.mean([one.standard_error for one in found]) == pytest.approx(spread, rel=0.25)


def test_a_shutter_that_is_seen_is_compared_with_itself() -> None:
    drift = 0.02
    time_s = np.arange(0, 600, STEP_S)
    closed = (time_s % 60) < 6
    random = np.random.default_rng(1)
    level = np.where(closed, 6000 + 100 * drift / 60 * time_s, 9000) + random.normal(0, 0.2, len(time_s))
    found = judge_preheat(steady(level_counts=level, closed=closed, frozen=False), 100.0, SHORT).drift
    assert found.value == pytest.approx(drift, abs=0.001)
    assert found.grade is Grade.FAIL
    assert "on the shutter" in found.note
    few = closed & (time_s < 70)
    assert (
        judge_preheat(steady(closed=few, frozen=False), 100.0, SHORT).drift.note == "not enough samples yet"
    )


def test_what_cannot_be_judged_is_said_and_does_not_stand_in_the_way() -> None:
    found = judge_preheat(steady(), None, SHORT)
    assert found.drift.grade is Grade.UNKNOWN
    assert "counts per kelvin" in found.drift.note
    assert found.is_go
    no_shutter = steady(has_shutter=False, closed=np.zeros(300, bool))
    assert "no shutter" in judge_preheat(no_shutter, 100.0, SHORT).drift.note
    silent = steady(fpa_temperature_k=np.full(300, np.nan))
    assert "temperature" in judge_preheat(silent, 100.0, SHORT).fpa.note
    assert judge_preheat(silent, 100.0, SHORT).is_go
    nothing = judge_preheat(silent, None, SHORT)
    assert not nothing.is_go
    assert math.isnan(nothing.ready_in_s)


def test_time_must_pass_and_the_window_must_be_full() -> None:
    found = judge_preheat(steady(minutes=10), 100.0)
    assert not found.is_go
    assert found.ready_in_s == found.time.ready_in_s == pytest.approx(1800 - 598)
    short = judge_preheat(steady(minutes=3), 100.0, SHORT)
    assert short.fpa.grade is short.drift.grade is Grade.FAIL
    assert not short.is_go
    assert math.isnan(short.ready_in_s)


def test_a_reading_in_steps_is_not_trusted_below_its_steps() -> None:
    time_s = np.arange(0, 600, STEP_S)
    # Of the difference of two readings in steps of 0.1 K, 300 s apart.
    rounding = 60 * 0.1 / math.sqrt(6) / 300
    found = [
        judge_preheat(steady(fpa_temperature_k=np.round(start + rate / 60 * time_s, 1)), 100.0, SHORT).fpa
        for rate in np.linspace(0.02, 0.05, 13)
        for start in np.linspace(300, 300.1, 10, endpoint=False)
    ]
    wrong = np.array([one.value for one in found]) - np.repeat(np.linspace(0.02, 0.05, 13), 10)
    assert all(one.standard_error >= rounding for one in found)
    assert np.mean(np.abs(wrong) < 2 * rounding) > 0.95


def test_the_time_to_ready_of_an_exponential_is_exact() -> None:
    time_s = np.arange(0, 1200, STEP_S)
    seen = steady(minutes=20, fpa_temperature_k=305 - 10 * np.exp(-time_s / 480))
    predicted = judge_preheat(seen, None, SHORT)
    assert predicted.fpa.grade is Grade.FAIL
    long_s = np.arange(0, 2400, STEP_S)
    later = steady(minutes=40, fpa_temperature_k=305 - 10 * np.exp(-long_s / 480))
    go_s = next(p.time_s for p in preheat_history(later, None, SHORT, every_s=4.0) if p.is_go)
    assert predicted.time_s + predicted.ready_in_s == pytest.approx(go_s, abs=15)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"time_s": np.zeros(300)}, "rise"),
        ({"closed": np.zeros(3, bool)}, "as many"),
        ({"level_counts": np.full(300, np.nan)}, "not finite"),
    ],
)
def test_wrong_samples_are_refused(changed, message) -> None:
    with pytest.raises(CalibrationError, match=message):
        judge_preheat(steady(**changed), 100.0)


def test_a_wrong_scale_or_window_is_refused() -> None:
    for scale in (0.0, -1.0, math.nan):
        with pytest.raises(CalibrationError, match="above 0"):
            judge_preheat(steady(), scale)
    with pytest.raises(CalibrationError, match="windows"):
        PreheatLimits(window_s=0.0)


ROWS, COLUMNS = 64, 80
CALM = {"netd_k": 0.0, "frame_noise_k": 0.0, "row_noise_k": 0.0, "column_noise_k": 0.0, "flicker_k": 0.0}


def cold_camera():
    """Settings of scene ``cold-start`` before a blackbody; a small picture with the whole field of view."""
    scene = parse_scene({**tomllib.loads(scene_toml("cold-start")), "view": "uniform"})
    return scene, in_condition(CameraSettings(rows=ROWS, columns=COLUMNS, pixel_pitch_um=136.0), scene.camera)


@pytest.fixture(scope="module")
def cold_start():
    """An hour of it as `WarmUp`, one frame every 2 s."""
    scene, camera = cold_camera()
    sensor, shutter = make_sensor(camera, scene, "left"), Shutter(camera.shutter, scene.seed, "left")
    time_s = np.arange(0, 3600, STEP_S)
    counts = np.empty((ROWS, COLUMNS), np.uint16)
    level, closed = np.empty(len(time_s)), np.zeros(len(time_s), bool)
    for number, at_s in enumerate(time_s):
        # As a faster recording tells it: closed at any time since the sample before.
        closed[number] = any(
            shutter.closed_since(at_s - ago_s) is not None for ago_s in (0.0, 0.4, 0.8, 1.2, 1.6)
        )
        if closed[number] and number:
            level[number] = level[number - 1]
            continue
        sensor.expose(np.full((ROWS, COLUMNS), 295.0, np.float32), number, counts, at_s)
        level[number] = counts.mean()
    fpa = np.array([fpa_reading(camera.warm_up, at_s, 1, "left", n) for n, at_s in enumerate(time_s)])
    return WarmUp(time_s, fpa, level, closed)


def true_drift_k_per_min(minutes):
    """Of the level of a camera without noise and shutter."""
    scene, camera = cold_camera()
    quiet = camera.sensor.model_copy(update={**CALM, "column_flicker_k": 0.0, "bad_pixel_fraction": 0.0})
    sensor = make_sensor(
        camera.model_copy(update={"sensor": quiet, "shutter": ShutterSettings()}), scene, "left"
    )
    counts = np.empty((ROWS, COLUMNS), np.uint16)

    def level_k(time_s):
        sensor.expose(np.full(counts.shape, 295.0, np.float32), 0, counts, time_s)
        return counts.mean() / 100

    return level_k(60 * minutes + 30) - level_k(60 * minutes - 30)


def test_a_cold_start_gets_its_go_not_before_the_truth_allows_and_soon_after(cold_start) -> None:
    _, camera = cold_camera()
    history = preheat_history(cold_start, 100.0)
    go_min = next(p.time_s for p in history if p.is_go) / 60
    assert true_drift_k_per_min(go_min) <= 0.010
    rise = fpa_temperature(camera.warm_up, 60 * go_min + 30) - fpa_temperature(
        camera.warm_up, 60 * go_min - 30
    )
    assert rise <= 0.050
    # The mean over the last ten minutes is the drift of about five minutes ago.
    assert true_drift_k_per_min(go_min - 7) > 0.010
    # Whoever was told go is not told no-go again.
    assert all(p.is_go for p in history if p.time_s >= 60 * go_min)


def test_without_the_shutter_in_sight_the_go_comes_later_but_not_earlier(cold_start) -> None:
    blind = replace(cold_start, closed=np.zeros(len(cold_start.time_s), bool), is_sparse=True)
    go_s, blind_go_s = (
        next(p.time_s for p in preheat_history(seen, 100.0) if p.is_go) for seen in (cold_start, blind)
    )
    assert go_s <= blind_go_s < 3600


def test_the_prediction_holds_within_four_minutes_from_half_way_on(cold_start) -> None:
    history = preheat_history(cold_start, 100.0)
    go_s = next(p.time_s for p in history if p.is_go)
    errors_min = [(p.time_s + p.ready_in_s - go_s) / 60 for p in history if go_s / 2 <= p.time_s < go_s]
    assert np.abs(errors_min).max() < 6
    assert np.sqrt(np.mean(np.square(errors_min))) < 2.5
    last_quarter = errors_min[len(errors_min) // 2 :]
    assert np.abs(last_quarter).max() < 3


def test_judged_by_its_temperature_alone_a_cold_start_is_ready_after_28_minutes(cold_start) -> None:
    history = preheat_history(cold_start, None, SHORT)
    go_min = next(p.time_s for p in history if p.is_go) / 60
    # 10 K / 480 s exp(-t / 480 s) = 50 mK/min at 25.8 minutes.
    assert 25.8 <= go_min <= 25.8 + 3.5
    early = next(p for p in history if p.time_s >= 720)
    assert (early.time_s + early.ready_in_s) / 60 == pytest.approx(go_min, abs=1.0)
