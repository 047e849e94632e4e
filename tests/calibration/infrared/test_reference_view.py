"""Temporal statistics of a uniform view in one pass, and the views that are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq_calibration import CalibrationError, observe

SHAPE = (10, 14)


def stack(count=40, seed=1, level=6000.0, sigma=3.0) -> np.ndarray:
    random = np.random.default_rng(seed)
    pattern = random.normal(level, 100, SHAPE)
    return np.rint(pattern + random.normal(0, sigma, (count, *SHAPE))).astype(np.uint16)


@settings(max_examples=25, deadline=None)
@given(count=st.integers(16, 70), seed=st.integers(0, 1000), level=st.floats(500, 60000))
def test_mean_and_noise_are_those_of_the_whole_stack(count, seed, level):
    frames = stack(count, seed, level)
    view = observe(iter(frames))
    np.testing.assert_allclose(view.mean, frames.mean(axis=0), rtol=1e-6)
    # What all pixels do together, here only the sampling of the median, is taken out of the noise.
    np.testing.assert_allclose(view.noise, frames.std(axis=0, ddof=1), atol=1.0)
    assert view.frames == count


def test_drift_and_noise_of_whole_frames_are_no_noise_of_pixels():
    frames = stack(64).astype(np.float32)
    moving = frames + np.linspace(0, 200, 64, dtype=np.float32)[:, None, None]
    still, moved = observe(frames), observe(moving)
    np.testing.assert_allclose(moved.noise, still.noise, rtol=1e-3)
    np.testing.assert_allclose(moved.mean, still.mean + 100, rtol=1e-5)


def test_jump_is_the_largest_step_between_block_means():
    frames = np.full((64, *SHAPE), 1000.0, np.float32)
    frames += np.random.default_rng(0).normal(0, 1e-3, frames.shape).astype(np.float32)
    frames[32:, 3, 4] += 50
    frames[40:, 5, 6] += 50
    view = observe(frames)
    assert view.jump[3, 4] == pytest.approx(50, abs=0.01)
    # It jumped in the middle of a block, which then has half of it.
    assert view.jump[5, 6] == pytest.approx(25, abs=0.01)
    assert np.median(view.jump) < 0.01


def test_frames_repeated_while_the_shutter_is_closed_do_not_count():
    frames = stack(20)
    with_repeats = [*frames[:10], *[frames[9]] * 30, *frames[10:]]
    view = observe(with_repeats)
    assert view.frames == 20
    np.testing.assert_array_equal(view.mean, observe(frames).mean)


def test_a_buffer_that_is_used_again_may_carry_the_frames():
    buffer = np.empty(SHAPE, np.uint16)

    def reuse():
        for frame in stack(20):
            buffer[:] = frame
            yield buffer

    np.testing.assert_array_equal(observe(reuse()).noise, observe(stack(20)).noise)


def nan_frames():
    frames = stack(20).astype(np.float32)
    frames[7, 2, 2] = np.nan
    return frames


def saturated():
    frames = stack(20)
    frames[:, :5] = 16383
    return frames


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], "0 different frames"),
        (stack(15), "cold has 15 different frames, fewer than 16"),
        (np.repeat(stack(1), 50, axis=0), "1 different frame,.*49 more only repeat"),
        (saturated(), "50.0% of the pixels of view cold never change; most stand at 16383 counts"),
        (nan_frames(), "frame 7 of view cold holds values that are not finite"),
        ([*stack(3), np.zeros((5, 5), np.uint16)], "frame 3 of view cold has 5 x 5 pixels"),
        (np.zeros((20, 4)), "not a picture"),
        (np.zeros((20, 4, 4), complex), "not a picture"),
    ],
)
def test_what_is_no_steady_uniform_view_is_refused(frames, message):
    with pytest.raises(CalibrationError, match=message):
        observe(frames, name="cold")


def test_temperatures_must_be_in_kelvin():
    with pytest.raises(CalibrationError, match=r"temperature of 21.5 K.*\n.*kelvin"):
        observe(stack(), temperature_k=21.5)
