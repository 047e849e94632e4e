"""Products of a known short-crested sea with known errors, as two pairs would see it; fused, and aligned."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from thermacq.errors import ReconstructionError, StoreError
from thermacq.reconstruction import Grid, WorldFrame, open_product
from thermacq.reconstruction.fusion import common_times, fuse
from thermacq.reconstruction.product import ProductWriter
from thermacq.reconstruction.water_overlap import placing_by_water
from thermacq.store import RunHeader

SPACING_M = 0.01
HEADER = RunHeader(
    "run-1", "sea", "2026-01-02T03:04:05Z", 1_767_323_045_000_000_000, 0, "virtual", True, {}, None
)
WAVES = [(0.9, 0.0, 0.010, 0.3), (0.6, 0.7, 0.006, 1.1), (0.5, -0.9, 0.005, 4.0), (0.8, 1.6, 0.004, 2.0)]


def sea(x, y, t, waves=WAVES):
    """Sum of waves (length m, direction rad, amplitude m, phase)."""
    eta = 0.0
    for length, direction, amplitude, phase in waves:
        k = 2 * np.pi / length
        along = x * np.cos(direction) + y * np.sin(direction)
        eta = eta + amplitude * np.cos(k * along - np.sqrt(9.81 * k) * t + phase)
    return eta


def frame(calibration, joined):
    rotation = np.array([[0, -0.92, 0.39], [-1, 0, 0], [0, -0.39, -0.92]])
    u, _, vt = np.linalg.svd(rotation)
    source = {"calibration_sha256": calibration}
    if joined and calibration != "A":
        source["joined"] = {"to_calibration_sha256": "A"}
    place = np.array([0.0, 0.0, 0.6])
    return WorldFrame(u @ vt, place, 5e-4, 2e-4, np.eye(3) * 1e-10, 100, 10, source)


def write(
    path, x_range, *, cameras, noise_m=5e-4, offset_m=0.0, seed=0, frames=40, waves=WAVES, place=None, **more
):
    """A product over x_range, 0.3 m wide; `place` (x, y, yaw) moves its own coordinates off the true ones."""
    x, y = (np.round(np.arange(*one, SPACING_M), 9) for one in (x_range, (-0.15, 0.151)))
    t = np.arange(frames) * 0.02 * more.pop("slower", 1.0)
    there = np.meshgrid(x, y)
    if place is not None:
        cosine, sine = np.cos(place[2]), np.sin(place[2])
        there = (
            place[0] + cosine * there[0] - sine * there[1],
            place[1] + sine * there[0] + cosine * there[1],
        )
    eta = sea(*there, t[:, None, None], waves) + offset_m
    eta = (eta + noise_m * np.random.default_rng(seed).standard_normal(eta.shape)).astype(np.float32)
    eta[:, 3, 4] = np.nan
    world = frame(cameras, more.pop("joined", True))
    attributes = {
        "run_id": "run-1",
        "calibration_sha256": cameras,
        "cameras": cameras,
        "world_frame": world.to_dict(),
        "simulated": True,
        "focal_px": 706.0,
        **more,
    }
    u = np.full(eta.shape[1:], noise_m, np.float32)
    with ProductWriter(path, Grid(x, y, SPACING_M), t, attributes, HEADER, u) as product:
        product.append(eta, np.where(np.isfinite(eta), 9, 0).astype(np.int32), np.full_like(eta, 1e-4))
    return path


@pytest.fixture
def two(tmp_path):
    """Two products that overlap by 0.2 m; the second is three times noisier and 1 mm too high."""
    first = write(tmp_path / "a.nc", (0.0, 0.5), cameras="A", noise_m=4e-4, seed=1)
    second = write(tmp_path / "b.nc", (0.3, 0.8), cameras="B", noise_m=12e-4, offset_m=1e-3, seed=2)
    return first, second


def errors(path):
    with open_product(path) as product:
        x, y = np.meshgrid(product["x"].to_numpy(), product["y"].to_numpy())
        return product["eta"].to_numpy() - sea(x, y, product["time"].to_numpy()[:, None, None]), x


def test_fused_is_better_than_each_in_the_overlap_and_covers_both(tmp_path):
    first = write(tmp_path / "a.nc", (0.0, 0.5), cameras="A", noise_m=5e-4, seed=1)
    second = write(tmp_path / "b.nc", (0.3, 0.8), cameras="B", noise_m=8e-4, seed=2)
    fused = fuse(first, second, tmp_path / "c.nc")
    assert (fused.frames, fused.left_out, fused.cells) == (40, 0, (31, 80))
    inner = (0.32, 0.47)
    rms = {}
    for path in (first, second, tmp_path / "c.nc"):
        error, x = errors(path)
        rms[path.name] = np.sqrt(np.nanmean(error[:, (x > inner[0]) & (x < inner[1])] ** 2))
    assert rms["c.nc"] < rms["a.nc"] < rms["b.nc"]
    with open_product(tmp_path / "c.nc") as product:
        u = product["eta_u"].sel(x=0.4, y=0.0, method="nearest").item()
        # Weights 1/u² of independent errors: 1/sqrt(1/5² + 1/8²) = 4.24.
        assert u == pytest.approx(4.24e-4, rel=0.01)
        assert rms["c.nc"] == pytest.approx(u, rel=0.15)
        assert product["eta_points"].sel(x=0.4, y=0.0, method="nearest").to_numpy().tolist() == [18] * 40
        attributes = product.attrs
    assert [origin["product"] for origin in json.loads(attributes["fused_from"])] == ["a.nc", "b.nc"]
    assert attributes["run_id"] == "run-1"
    assert "cameras" not in attributes
    assert attributes["simulated"] == "true"
    assert json.loads(attributes["overlap"])["cells"] == fused.overlap.cells


def test_the_overlap_residual_is_stated(two, tmp_path):
    fused = fuse(*two, tmp_path / "c.nc")
    assert fused.overlap.mean_m == pytest.approx(-1e-3, abs=5e-5)
    assert fused.overlap.sigma_m == pytest.approx(np.hypot(4e-4, 12e-4), rel=0.03)
    assert fused.overlap.expected_sigma_m == pytest.approx(np.hypot(4e-4, 12e-4), rel=0.01)
    # Averaged over 40 frames the noise is 6.3 times smaller.
    assert fused.overlap.steady_sigma_m == pytest.approx(np.hypot(4e-4, 12e-4) / 40**0.5, rel=0.15)
    assert fused.doubts == ()


def test_products_that_differ_meet_without_a_step(two, tmp_path):
    """An offset of 1 mm is spread: no jump of the mean error between neighbouring columns above 0.3 mm."""
    fuse(*two, tmp_path / "c.nc")
    error, _ = errors(tmp_path / "c.nc")
    profile = np.nanmean(error, axis=(0, 1))
    assert abs(profile[:25]).max() < 2e-4
    assert profile[-25:].mean() == pytest.approx(1e-3, abs=1e-4)
    assert np.abs(np.diff(profile)).max() < 3e-4


def test_a_cell_of_one_product_alone_is_its_own(two, tmp_path):
    fuse(*two, tmp_path / "c.nc")
    with open_product(tmp_path / "c.nc") as fused, open_product(two[0]) as first:
        own = fused["eta"].isel(x=slice(0, 30)).to_numpy()
        np.testing.assert_allclose(own, first["eta"].isel(x=slice(0, 30)).to_numpy(), atol=1e-7)
        assert np.isnan(own[:, 3, 4]).all()


def test_what_is_doubtful_is_said(tmp_path):
    first = write(tmp_path / "a.nc", (0.0, 0.5), cameras="A")
    far = write(tmp_path / "b.nc", (0.7, 0.9), cameras="B", joined=False, seed=3)
    apart = fuse(first, far, tmp_path / "c.nc")
    assert apart.overlap is None
    assert "one world frame" in apart.doubts[0]
    assert "do not overlap" in apart.doubts[1]
    high = write(tmp_path / "d.nc", (0.3, 0.8), cameras="B", offset_m=0.01, seed=4)
    doubts = fuse(first, high, tmp_path / "e.nc").doubts
    assert re.search(r"differ by -(9.9|10.0)", doubts[0])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"run_id": "run-2"}, "different recordings"),
        ({"cameras": "A"}, "same cameras"),
        ({"slower": 1.7}, "taken at the same times"),
        ({"x_range": (0.303, 0.6)}, "do not coincide"),
        ({"world_frame": "none"}, "no world frame|in which world frame"),
    ],
)
def test_products_that_do_not_belong_together_are_refused(tmp_path, more, message):
    first = write(tmp_path / "a.nc", (0.0, 0.5), cameras="A")
    values = {"x_range": (0.3, 0.8), "cameras": "B", **more}
    second = write(tmp_path / "b.nc", values.pop("x_range"), **values)
    with pytest.raises(ReconstructionError, match=message):
        fuse(first, second, tmp_path / "c.nc")
    assert not list(tmp_path.glob("c.nc*"))


def test_an_existing_file_is_kept(two, tmp_path):
    (tmp_path / "c.nc").write_text("mine")
    with pytest.raises(StoreError, match="exists"):
        fuse(*two, tmp_path / "c.nc")


def placed(tmp_path, seed, waves=WAVES, near=(0.02, -0.02, 0.03), noise_m=4e-4):
    """Place found for a second product whose own coordinates lie at (0.3, 0.02) m, turned by 177 degrees."""
    true = np.array([0.8, 0.02, np.radians(177.0)])
    first = write(tmp_path / f"a{seed}.nc", (0.0, 0.6), cameras="A", noise_m=noise_m, seed=seed, waves=waves)
    second = write(
        tmp_path / f"b{seed}.nc",
        (0.1, 0.6),
        cameras="B",
        noise_m=noise_m,
        seed=seed + 99,
        waves=waves,
        place=true,
    )
    with open_product(first) as one, open_product(second) as other:
        return true, placing_by_water(one, other, common_times(one, other), np.zeros(2), tuple(true + near))


@pytest.mark.slow
def test_the_water_places_the_second_pair_within_its_uncertainty(tmp_path):
    scores = []
    for seed in range(5):
        true, placing = placed(tmp_path, seed)
        error = np.array([placing.x_m, placing.y_m, -placing.yaw_rad]) - true
        error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
        scores.append(error / np.sqrt(np.diag(placing.covariance)))
        assert placing.source["correlation"] > 0.97
    assert 0.4 < np.std(scores) < 1.6
    assert np.abs(error[:2]).max() < 1e-3


def test_long_crests_and_still_water_leave_the_place_open(tmp_path):
    with pytest.raises(ReconstructionError, match="long-crested"):
        placed(tmp_path, 0, waves=[(0.9, 0.0, 0.01, 0.3)])
    with pytest.raises(ReconstructionError, match="do not agree anywhere"):
        placed(tmp_path, 1, waves=[(0.9, 0.0, 0.0, 0.3)])
