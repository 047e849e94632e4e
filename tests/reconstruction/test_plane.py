from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.plane import fit_plane, plane_covariance


def plane_points(normal, distance, shape=(60, 80), noise=0.0, seed=0):
    """Points on a plane below a camera, in picture order."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(np.linspace(-0.35, 0.35, shape[0]), np.linspace(-0.45, 0.45, shape[1]), indexing="ij")
    rays = np.stack([u, v, np.ones(shape)], axis=-1)
    points = rays * (-distance / (rays @ normal))[..., None]
    return points + noise * rng.standard_normal(shape)[..., None] * normal


@settings(max_examples=20, deadline=None)
@given(tilt=st.floats(0, 45), turn=st.floats(0, 360), distance=st.floats(0.3, 3.0), seed=st.integers(0, 99))
def test_a_plane_is_found_among_outliers(tilt, turn, distance, seed):
    tilt, turn = np.radians(tilt), np.radians(turn)
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    points = plane_points(normal, distance, noise=0.0005, seed=seed)
    rng = np.random.default_rng(seed)
    wrong = rng.random(points.shape[:2]) < 0.35
    points[wrong] *= rng.uniform(0.5, 1.5, wrong.sum())[:, None]
    points[::7, ::5] = np.nan
    plane = fit_plane(points, threshold_m=0.003, seed=seed)
    assert np.degrees(np.arccos(min(1.0, plane.normal @ normal))) < 0.05
    assert abs(plane.distance_m - distance) < 0.0005
    assert 0.0004 < plane.sigma_m < 0.0007
    assert plane.points > 0.6 * np.isfinite(points[..., 0]).sum()


def test_the_same_seed_gives_the_same_plane():
    points = plane_points(np.array([0.0, 0.0, -1.0]), 1.0, noise=0.01)
    first, second = fit_plane(points, 0.02, seed=4), fit_plane(points, 0.02, seed=4)
    np.testing.assert_array_equal(first.normal, second.normal)
    assert first.distance_m == second.distance_m


def test_too_few_points_are_refused():
    points = np.full((10, 10, 3), np.nan)
    points[:4, :4] = np.random.default_rng(0).random((4, 4, 3))
    with pytest.raises(ReconstructionError, match="only 16 were matched"):
        fit_plane(points, 0.01)


def test_points_that_fill_space_are_no_plane():
    points = np.random.default_rng(0).random((40, 40, 3)) + 1
    with pytest.raises(ReconstructionError, match="no plane is supported by half"):
        fit_plane(points, 0.01)


def test_points_on_one_line_are_no_plane():
    points = np.linspace(0, 1, 400)[:, None] * np.zeros(3) + np.array([1.0, 2.0, 3.0])
    with pytest.raises(ReconstructionError, match="on one line"):
        fit_plane(points, 0.01)


@pytest.mark.slow
def test_the_covariance_holds_for_errors_that_share_matching_windows():
    """Disparity errors of 0.03 px over an inclined plane: errors over their standard uncertainties are normal."""
    height, focal, baseline, tilt = 0.6, 353.0, 0.06, np.radians(22.8)
    v, u = np.mgrid[:256, :320].astype(float)
    up = np.array([0, -np.sin(tilt), -np.cos(tilt)])
    axes = np.array([[0, -np.cos(tilt), np.sin(tilt)], [-1.0, 0, 0]])
    rays = np.stack([(u - 160) / focal, (v - 128) / focal, np.ones_like(u)], axis=-1)
    disparity = -baseline * focal * (rays @ up) / height
    scores = []
    for seed in range(50):
        error = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(disparity.shape), 5.0)
        points = rays * (baseline * focal / (disparity + 0.03 * error / error.std()))[..., None]
        plane = fit_plane(points, 0.003)
        off = [plane.distance_m - height, *(-(axes @ plane.normal) / (plane.normal @ up))]
        scores.append(off / np.sqrt(np.diag(plane_covariance(plane, points, axes))))
    # 50 normal numbers have a standard deviation between 0.75 and 1.27 in 99 of 100 cases.
    assert (np.std(scores, axis=0) > 0.7).all()
    assert (np.std(scores, axis=0) < 1.3).all()


def test_too_few_points_have_no_covariance():
    normal = np.array([0.0, 0.0, -1.0])
    points = plane_points(normal, 1.0)
    axes = np.array([[1.0, 0, 0], [0, -1.0, 0]])
    assert np.isnan(plane_covariance(fit_plane(points, 0.01), np.full((4, 4, 3), np.nan), axes)).all()
