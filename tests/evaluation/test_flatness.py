from __future__ import annotations

import numpy as np
import pytest

from thermacq.errors import ReconstructionError
from thermacq.evaluation.flatness import fit_plane, flatness, plane_at

X = np.linspace(0.1, 0.5, 30)
Y = np.linspace(-0.2, 0.2, 20)


def test_a_plane_is_given_back():
    plane = np.array([0.01, 0.2, -0.3])
    assert fit_plane(plane_at(plane, X, Y), X, Y) == pytest.approx(plane)


def test_parts_of_the_deviation():
    generator = np.random.default_rng(0)
    bump = 0.002 * np.cos(8 * X)[None, :] * np.cos(9 * Y)[:, None]
    frames = np.array([0.003 + bump + generator.normal(0, 0.001, bump.shape) for _ in range(400)])
    found = flatness(frames, X, Y)
    assert found.mean_m == pytest.approx(frames.mean(), abs=1e-12)
    assert found.overall_sd_m == pytest.approx(frames.std(), rel=1e-9)
    assert found.temporal_sd_m == pytest.approx(0.001, rel=0.02)
    assert found.fixed_sd_m == pytest.approx(bump.std(), rel=0.02)
    assert found.cell_sd_m == pytest.approx(frames.std(axis=0, ddof=1))
    assert found.mean_deviation_m == pytest.approx(frames.mean(axis=0))
    assert found.median_cell_sd_m == pytest.approx(0.001, rel=0.02)
    assert found.frames == 400


def test_a_tilted_world_plane_is_told_from_noise():
    tilt = plane_at(np.array([0.0, 0.02, 0.01]), X, Y)
    generator = np.random.default_rng(1)
    found = flatness((tilt + generator.normal(0, 3e-4, tilt.shape) for _ in range(50)), X, Y)
    assert found.overall_sd_m > 0.002
    assert found.plane_sd_m == pytest.approx(3e-4, rel=0.02)


def test_drift_of_the_plane():
    planes = np.stack(
        [np.linspace(0, 0.005, 11), np.linspace(0, 0.003, 11), np.linspace(0, 0.004, 11)], axis=1
    )
    found = flatness((plane_at(plane, X, Y) for plane in planes), X, Y)
    assert found.offset_drift_m == pytest.approx(0.005)
    assert found.tilt_drift_rad == pytest.approx(0.005)


def test_unsupported_cells_stay_unsupported():
    frames = np.zeros((5, Y.size, X.size))
    frames[:, :3] = np.nan
    frames[1:, 3] = np.nan
    found = flatness(frames, X, Y)
    assert np.isnan(found.mean_deviation_m[:3]).all()
    assert np.isnan(found.cell_sd_m[3]).all()
    assert (found.mean_deviation_m[3:] == 0).all()
    assert found.seen_fraction[3] == pytest.approx(np.full(X.size, 0.2))


@pytest.mark.parametrize("frames", [[], [np.full((Y.size, X.size), np.nan)]])
def test_nothing_seen_is_refused(frames):
    with pytest.raises(ReconstructionError, match="no frame with enough"):
        flatness(frames, X, Y)


def test_cells_on_one_line_make_no_plane():
    eta = np.full((Y.size, X.size), np.nan)
    eta[4] = 0.0
    assert np.isnan(fit_plane(eta, X, Y)).all()
