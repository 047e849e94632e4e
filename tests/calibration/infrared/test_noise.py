"""3-D noise: synthetic cubes of known components, bad pixels, and pictures that are none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from thermacq_calibration import CalibrationError
from thermacq_calibration.infrared.noise import COMPONENTS, NoiseAccumulator, noise_3d
from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import SensorSettings

SIGMA = {"t": 6.0, "v": 20.0, "h": 30.0, "tv": 4.0, "th": 8.0, "vh": 50.0, "tvh": 35.0}


def cube(random, shape=(64, 48, 60), sigma=SIGMA, level=6000.0):
    """Sequence (t, v, h) with the given standard deviations."""
    total = np.full(shape, level)
    for name, level_of in sigma.items():
        size = [count if axis in name else 1 for axis, count in zip("tvh", shape, strict=True)]
        total += level_of * random.standard_normal(size)
    return total


@pytest.fixture(scope="module")
def many():
    random = np.random.default_rng(1)
    return [noise_3d(cube(random)) for _ in range(100)]


# Standard error of the mean over 100 cubes: 1.8 % of the variance for 59 degrees of freedom, or half of
# that of the deviation; the other components have far more.
@pytest.mark.parametrize("name", COMPONENTS)
def test_the_mean_over_cubes_is_the_truth(many, name: str) -> None:
    variance = np.mean([found.component(name).variance for found in many])
    assert math.sqrt(variance) == pytest.approx(SIGMA[name], rel=0.014)


def test_intervals_cover_the_truth_as_often_as_they_say(many) -> None:
    covered = {
        name: sum(found.component(name).low <= SIGMA[name] <= found.component(name).high for found in many)
        for name in COMPONENTS
    }
    # 95 % of 100 with a deviation of 2.2; three of them.
    assert all(89 <= count <= 100 for count in covered.values()), covered
    assert sum(covered.values()) / (7 * 100) == pytest.approx(0.95, abs=0.02)


def test_an_absent_component_is_reported_as_0_with_a_flag() -> None:
    random = np.random.default_rng(3)
    found = [noise_3d(cube(random, (12, 8, 10), {"tvh": 1.0, "th": 0.3})) for _ in range(150)]
    flagged = [each.tv for each in found if each.tv.is_negative]
    assert 0.3 < len(flagged) / len(found) < 0.75
    assert all(component.sigma == component.low == 0 for component in flagged)
    for name in ("t", "v", "h", "tv", "vh"):
        assert abs(np.mean([each.component(name).variance for each in found])) < 0.006, name
        # Its truth, 0, lies in nearly all intervals.
        assert np.mean([each.component(name).low == 0 for each in found]) > 0.94, name
    assert np.mean([each.th.variance for each in found]) == pytest.approx(0.09, rel=0.1)


def test_a_large_offset_and_the_order_of_adding_lose_no_digits() -> None:
    random = np.random.default_rng(4)
    small = cube(random, (16, 12, 14), level=0.0)
    at_zero, far_off = noise_3d(small), noise_3d(small + 1e7)
    for name in COMPONENTS:
        assert far_off.component(name).variance == pytest.approx(
            at_zero.component(name).variance, rel=1e-6, abs=1e-4
        )
    assert far_off.mean - at_zero.mean == pytest.approx(1e7)


def test_bad_pixels_leave_no_trace() -> None:
    random = np.random.default_rng(5)
    found = []
    for _ in range(60):
        values = cube(random, (32, 40, 50))
        bad = random.uniform(size=(40, 50)) < 0.03
        values[:, bad] = random.choice([0.0, 16383.0], size=(32, int(bad.sum())))
        found.append(noise_3d(values, bad))
    for name in COMPONENTS:
        variance = np.mean([each.component(name).variance for each in found])
        tolerance = 0.06 if name in ("t", "v", "h") else 0.02
        assert math.sqrt(variance) == pytest.approx(SIGMA[name], rel=tolerance), name


def test_a_dead_row_is_left_out() -> None:
    random = np.random.default_rng(6)
    values = cube(random, (20, 30, 40))
    bad = np.zeros((30, 40), bool)
    bad[7] = True
    values[:, 7] = 16383
    found = noise_3d(values, bad)
    assert found.tvh.sigma == pytest.approx(SIGMA["tvh"], rel=0.03)
    assert found.bad_pixels == 40


def test_differences_between_frames_agree_until_something_drifts() -> None:
    random = np.random.default_rng(7)
    values = cube(random, (40, 30, 40))
    still = noise_3d(values)
    assert still.high_frequency_tvh == pytest.approx(still.tvh.sigma, rel=0.01)
    drifting = values + np.linspace(0, 1, 40)[:, None, None] * random.normal(0, 100, (30, 40))
    moved = noise_3d(drifting)
    assert moved.high_frequency_tvh == pytest.approx(SIGMA["tvh"], rel=0.02)
    assert moved.tvh.sigma > 1.2 * moved.high_frequency_tvh


def test_spatial_deviation_is_free_of_temporal_noise() -> None:
    random = np.random.default_rng(8)
    found = [noise_3d(cube(random, (4, 30, 40), {"vh": 10.0, "tvh": 40.0})).spatial_sigma for _ in range(40)]
    assert np.mean(found) == pytest.approx(10.0, rel=0.03)


def test_memory_does_not_grow_with_the_frames() -> None:
    accumulator = NoiseAccumulator()
    picture = np.random.default_rng(9).normal(0, 1, (20, 30))
    sizes = []
    for _ in range(3):
        for _ in range(20):
            accumulator.add(picture)
        sizes.append(
            sum(np.asarray(value).nbytes for value in vars(accumulator).values() if value is not None)
        )
    assert len(set(sizes)) == 1
    assert accumulator.frames == 60
    assert np.allclose(accumulator.mean_picture, picture)


def test_wrong_pictures_are_refused() -> None:
    accumulator = NoiseAccumulator()
    with pytest.raises(CalibrationError, match="at least 1 pictures"):
        _ = accumulator.mean_picture
    accumulator.add(np.ones((4, 5)))
    with pytest.raises(CalibrationError, match="at least 2 pictures"):
        accumulator.noise()
    with pytest.raises(CalibrationError, match=r"is \(5, 4\)"):
        accumulator.add(np.ones((5, 4)))
    with pytest.raises(CalibrationError, match="not finite"):
        accumulator.add(np.full((4, 5), np.nan))
    with pytest.raises(CalibrationError, match="2 x 2"):
        accumulator.add(np.ones(4))
    with pytest.raises(CalibrationError, match="map of bad pixels"):
        NoiseAccumulator(np.ones((3, 3), bool)).add(np.ones((4, 5)))
    with pytest.raises(CalibrationError, match="too few are left"):
        noise_3d(np.ones((3, 4, 5)), np.ones((4, 5), bool))


def simulated_noise(seed, rows, columns):
    """3-D noise of 64 frames of a simulated camera; levels as `SIGMA`, in counts of 1 mK."""
    settings = SensorSettings(
        netd_k=SIGMA["tvh"] / 1000,
        frame_noise_k=SIGMA["t"] / 1000,
        row_noise_k=SIGMA["tv"] / 1000,
        column_noise_k=SIGMA["th"] / 1000,
        offset_k=SIGMA["vh"] / 1000,
        row_offset_k=SIGMA["v"] / 1000,
        column_offset_k=SIGMA["h"] / 1000,
        gain=0.0,
        shading_k=0.0,
        blur_px=0.0,
        bad_pixel_fraction=0.0,
        counts_per_k=1000.0,
    )
    sensor = Sensor(settings, rows, columns, seed, "left")
    accumulator = NoiseAccumulator()
    counts = np.empty((rows, columns), np.uint16)
    for index in range(64):
        sensor.expose(np.full(counts.shape, 295.0, np.float32), index, counts, index * 0.02)
        accumulator.add(counts)
    return accumulator.noise()


@pytest.mark.slow
def test_the_simulators_noise_is_found_again() -> None:
    found = [simulated_noise(seed, 64, 80) for seed in range(60)]
    for name in COMPONENTS:
        components = [each.component(name) for each in found]
        # The standard error of the rarest, t, is 1.2 %.
        sigma = math.sqrt(np.mean([one.variance for one in components]))
        assert sigma == pytest.approx(SIGMA[name], rel=0.02), name
        assert np.mean([one.low <= SIGMA[name] <= one.high for one in components]) >= 0.88, name


@pytest.mark.slow
def test_one_simulated_camera_of_full_size_is_right_within_two_per_cent() -> None:
    found = simulated_noise(1, 512, 640)
    for name in ("tv", "th", "vh", "tvh"):
        assert found.component(name).sigma == pytest.approx(SIGMA[name], rel=0.02), name
    for name in ("vh", "tvh"):
        assert found.component(name).sigma == pytest.approx(SIGMA[name], rel=0.01), name
