"""Still stretches of a recording."""

from __future__ import annotations

import numpy as np
import pytest

from thermacq_calibration.targets.poses import changes, pixel_noise, still_stretches


def recording(held, noise=10.0, seed=0):
    """Frames of a bar pattern: each number says for how many frames a position is held."""
    random = np.random.default_rng(seed)
    columns = np.arange(64)
    for position, count in enumerate(held):
        pattern = 8000 + 300 * (((columns + 7 * position) // 8) % 2)
        for _ in range(count):
            yield pattern + random.normal(0, noise, (48, 64))


@pytest.mark.parametrize("noise", [0.0, 10.0, 40.0])
def test_held_positions_are_found(noise):
    assert still_stretches(*changes(recording([8, 8, 8], noise))) == [
        range(8),
        range(8, 16),
        range(16, 24),
    ]


def test_short_stops_and_motion_are_dropped():
    assert still_stretches(*changes(recording([6, 1, 1, 1, 3, 1, 9]))) == [range(6), range(13, 22)]


def test_a_board_that_always_moves_gives_nothing():
    assert still_stretches(*changes(recording([1] * 20))) == []


def test_a_board_that_never_moves_is_one_pose():
    assert still_stretches(*changes(recording([12]))) == [range(12)]


@pytest.mark.parametrize("frames", [0, 1])
def test_recordings_without_pairs_of_frames_give_nothing(frames):
    assert still_stretches(*changes(recording([frames]))) == []


def test_pixel_noise_is_measured_beside_smooth_content():
    v, u = np.mgrid[:200, :300]
    smooth = 8000 + 3 * u + 50 * np.sin(v / 30)
    noisy = smooth + np.random.default_rng(1).normal(0, 12, smooth.shape)
    assert pixel_noise(noisy) == pytest.approx(12, rel=0.03)
