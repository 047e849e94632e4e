from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from thermacq_drivers.simflume.settings import TextureSettings
from thermacq_drivers.simflume.texture import PERIOD_M, ThermalTexture, grid_place


def sample(texture: ThermalTexture, x_m: np.ndarray, y_m: np.ndarray, time_s: float) -> np.ndarray:
    x, y = np.broadcast_arrays(x_m, y_m)
    return texture.sample(grid_place(x).astype(np.float32), grid_place(y).astype(np.float32), time_s)


@pytest.fixture(scope="module")
def texture() -> ThermalTexture:
    return ThermalTexture(TextureSettings(), seed=3)


WHOLE = np.arange(0, 1.024, 0.001)


def test_strength_is_as_asked_at_any_time(texture: ThermalTexture) -> None:
    for time_s in (0.0, 1.0, 2.0, 3.9, 100.7):
        seen = sample(texture, WHOLE[:, None], WHOLE[None, :], time_s)
        assert seen.std() == pytest.approx(0.3, rel=0.1)
        assert abs(seen.mean()) < 0.02


def test_correlation_lengths_and_streaks(texture: ThermalTexture) -> None:
    seen = sample(texture, WHOLE[:, None], WHOLE[None, :], 0.0)
    lags_m = np.array([0.002, 0.004, 0.008, 0.016])
    lengths_m = np.array([0.003, 0.008, 0.024])
    expected = np.exp(-0.5 * (lags_m[:, None] / lengths_m) ** 2).mean(axis=1)
    for lag_m, correlation in zip(lags_m, expected, strict=True):
        across, along = round(lag_m / 0.001), round(2.5 * lag_m / 0.001)
        variance = seen.var()
        assert np.mean(seen * np.roll(seen, across, axis=1)) / variance == pytest.approx(
            correlation, abs=0.06
        )
        assert np.mean(seen * np.roll(seen, along, axis=0)) / variance == pytest.approx(correlation, abs=0.06)


def test_the_pattern_is_replaced_in_its_lifetime(texture: ThermalTexture) -> None:
    def seen(time_s: float) -> np.ndarray:
        return sample(texture, WHOLE[:, None], WHOLE[None, :], time_s).ravel()

    assert np.corrcoef(seen(1.0), seen(1.02))[0, 1] > 0.999
    assert np.corrcoef(seen(0.0), seen(2.0))[0, 1] == pytest.approx(np.cos(np.pi / 4), abs=0.1)
    assert abs(np.corrcoef(seen(0.0), seen(8.0))[0, 1]) < 0.2


def test_it_repeats_after_its_period_only(texture: ThermalTexture) -> None:
    x, y = np.linspace(0, 0.4, 60)[:, None], np.linspace(-0.3, 0.3, 80)[None, :]
    here = sample(texture, x, y, 0.5)
    np.testing.assert_allclose(sample(texture, x + 7 * PERIOD_M, y - PERIOD_M, 0.5), here, atol=2e-3)
    assert np.abs(sample(texture, x + 0.5, y, 0.5) - here).max() > 0.3


def test_sampling_places_the_pattern_to_a_hundredth_of_a_pixel(texture: ThermalTexture) -> None:
    # An exact bilinear sampling of the same grid; a pixel of the paper's camera sees 0.92 mm.
    random = np.random.default_rng(2)
    rows = random.uniform(10, 4000, (50, 60)).astype(np.float32)
    columns = random.uniform(10, 4000, (50, 60)).astype(np.float32)
    field = texture._field
    exact = map_coordinates(field.astype(np.float64), [rows, columns], order=1)
    import cv2

    sampled = cv2.remap(field, columns, rows, cv2.INTER_LINEAR)
    gradient_k_per_step = np.diff(field, axis=1).std()
    steps_per_pixel = 0.92 / 0.25
    error_px = (sampled - exact).std() / gradient_k_per_step / steps_per_pixel
    assert error_px < 0.01


def test_equal_seeds_give_equal_patterns() -> None:
    x, y = np.linspace(0, 0.1, 20)[:, None], np.linspace(0, 0.1, 20)[None, :]
    settings = TextureSettings(rms_k=0.5)
    first = sample(ThermalTexture(settings, 5), x, y, 1.0)
    np.testing.assert_array_equal(sample(ThermalTexture(settings, 5), x, y, 1.0), first)
    assert np.abs(sample(ThermalTexture(settings, 6), x, y, 1.0) - first).max() > 0.1


def test_no_texture_at_all_is_refused() -> None:
    with pytest.raises(ValueError, match="nothing in its pictures can be matched"):
        TextureSettings(rms_k=0.0)


STIRRED = {"rms_k": 0.35, "lengths_m": (0.004, 0.01), "streakiness": 2, "stirring_m": 0.012, "eddies_m": 0.03}


@pytest.mark.parametrize("warm_streaks", [0.0, 0.5])
def test_a_stirred_pattern_is_as_strong_as_asked(warm_streaks: float) -> None:
    texture = ThermalTexture(TextureSettings(warm_streaks=warm_streaks, **STIRRED), 3)
    seen = sample(texture, WHOLE[:, None], WHOLE[None, :], 0.0)
    assert seen.std() == pytest.approx(0.35, rel=0.05)
    assert abs(seen.mean()) < 0.02
    skew = np.mean((seen - seen.mean()) ** 3) / seen.std() ** 3
    # expm1 of a Gaussian of standard deviation s has the skew of a log-normal: 1.75 for s = 0.5.
    assert skew == pytest.approx(1.75 if warm_streaks else 0.0, abs=0.35)


def test_a_stirred_pattern_is_periodic_and_seeded() -> None:
    texture = ThermalTexture(TextureSettings(**STIRRED), 3)
    x, y = np.linspace(0, 0.4, 60)[:, None], np.linspace(-0.3, 0.3, 80)[None, :]
    here = sample(texture, x, y, 0.5)
    np.testing.assert_allclose(sample(texture, x + 2 * PERIOD_M, y - PERIOD_M, 0.5), here, atol=4e-3)
    again = sample(ThermalTexture(TextureSettings(**STIRRED), 3), x, y, 0.5)
    np.testing.assert_array_equal(again, here)
    # No seam: steps across the border of the period are as large as elsewhere.
    whole = sample(texture, WHOLE[:, None], WHOLE[None, :], 0.0)
    for axis in (0, 1):
        steps = np.abs(np.diff(whole, axis=axis, append=np.take(whole, [0], axis=axis)))
        assert np.take(steps, -1, axis=axis).mean() < 1.3 * steps.mean()


def test_eddies_draw_filaments() -> None:
    """Stirring shortens the pattern across filaments, and turns streaks away from the drift."""
    calm = ThermalTexture(TextureSettings(**{**STIRRED, "stirring_m": 0.0}), 3)
    stirred = ThermalTexture(TextureSettings(**STIRRED), 3)
    along, across = [], []
    for texture in (calm, stirred):
        seen = sample(texture, WHOLE[:, None], WHOLE[None, :], 0.0)
        along.append(np.std(np.diff(seen, axis=0)))
        across.append(np.std(np.diff(seen, axis=1)))
    assert along[1] > 1.5 * along[0]
    assert across[1] / along[1] < across[0] / along[0]


def test_the_lifetime_is_that_of_the_settings() -> None:
    for lifetime_s in (2.0, 8.0):
        texture = ThermalTexture(TextureSettings(lifetime_s=lifetime_s), 6)
        begun = sample(texture, WHOLE[:, None], WHOLE[None, :], 0.0)
        half = sample(texture, WHOLE[:, None], WHOLE[None, :], lifetime_s / 2)
        gone = sample(texture, WHOLE[:, None], WHOLE[None, :], lifetime_s)
        assert np.corrcoef(begun.ravel(), half.ravel())[0, 1] == pytest.approx(np.cos(np.pi / 4), abs=0.12)
        assert abs(np.corrcoef(begun.ravel(), gone.ravel())[0, 1]) < 0.2
