from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from thermacq_calibration import CalibrationError
from thermacq_calibration.geometry.rigid_motion import fit_rigid_motion


def cloud(rng, views=8, each=54):
    """Boards of corners in front of a camera, their views, and covariances ten times longer along z."""
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(6)), axis=-1).reshape(-1, 2)[:each] * 0.03
    points = []
    for _ in range(views):
        flat = np.column_stack([grid - grid.mean(axis=0), np.zeros(len(grid))])
        turn = Rotation.from_rotvec(rng.uniform(-0.4, 0.4, 3)).as_matrix()
        points.append(flat @ turn.T + rng.uniform([-0.1, -0.1, 0.6], [0.1, 0.1, 0.8]))
    covariance = np.broadcast_to(np.diag([1e-4, 1e-4, 1e-3]) ** 2, (views * len(grid), 3, 3))
    return np.concatenate(points), covariance, np.repeat(np.arange(views), len(grid))


vectors = st.tuples(*[st.floats(-3, 3)] * 3)


@settings(deadline=None, max_examples=30)
@given(turn=vectors, shift=vectors, seed=st.integers(0, 99))
def test_an_exact_motion_is_found_exactly(turn, shift, seed):
    source, covariance, view = cloud(np.random.default_rng(seed), views=2)
    rotation = Rotation.from_rotvec(turn).as_matrix()
    motion = fit_rigid_motion(source, source @ rotation.T + shift, covariance, covariance, view)
    np.testing.assert_allclose(motion.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(motion.translation_m, shift, atol=1e-9)
    np.testing.assert_allclose(motion.apply(source), source @ rotation.T + shift, atol=1e-9)
    assert (motion.views, motion.points) == (2, 108)


@pytest.mark.parametrize("views", [3, 12])
def test_errors_agree_with_the_stated_covariance(views):
    """Points less certain along the lines of sight of two cameras that look from two sides, 60 repeats."""
    rotation, shift = Rotation.from_rotvec([0.1, 2.8, -0.4]).as_matrix(), np.array([0.1, -0.7, 0.4])
    scores, plain = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        source, covariance, view = cloud(rng, views)
        target = source @ rotation.T + shift
        noisy = [
            points + np.einsum("nij,nj->ni", np.sqrt(covariance), rng.standard_normal(points.shape))
            for points in (source, target)
        ]
        motion = fit_rigid_motion(*noisy, covariance, covariance, view)
        turned = Rotation.from_matrix(rotation @ motion.rotation.T).as_rotvec()
        error = np.concatenate([turned, shift - motion.translation_m])
        scores.append(error / np.sqrt(np.diag(motion.covariance)))
        equal = fit_rigid_motion(*noisy, 1e-8 * np.eye(3) + 0 * covariance, 0 * covariance, view)
        plain.append(np.linalg.norm(shift - equal.translation_m) / np.linalg.norm(error[3:]))
        assert 0.5 < motion.chi2 < 1.6
    assert 0.75 < np.std(scores) < 1.3
    # Weights by certainty are worth having.
    assert np.median(plain) > 1.0


def test_hopeless_points_are_refused():
    line = np.outer(np.arange(9.0), [1.0, 2.0, 3.0])
    covariance, view = np.broadcast_to(np.eye(3), (9, 3, 3)), np.zeros(9, int)
    with pytest.raises(CalibrationError, match="on one line"):
        fit_rigid_motion(line, line + 1, covariance, covariance, view)
    with pytest.raises(CalibrationError, match="not 2"):
        fit_rigid_motion(line[:2], line[:2], covariance[:2], covariance[:2], view[:2])
