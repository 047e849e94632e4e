from __future__ import annotations

import numpy as np
import pytest

from thermacq_drivers.simflume.cases import TABLE_II
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.projection import PixelGrid, check_view, intersect, water_points
from thermacq_drivers.simflume.regular_wave import solve_wave
from thermacq_drivers.simflume.surfaces import StillWater

CAMERAS = {side: build_camera(Mounting(side=side)) for side in ("left", "right")}


@pytest.fixture(scope="module")
def grid() -> PixelGrid:
    return PixelGrid(512, 640)


@pytest.mark.parametrize("name", ["still", *TABLE_II])
def test_every_pixel_sees_its_own_point_of_the_water(name: str, grid: PixelGrid) -> None:
    pixels = np.stack(np.meshgrid(np.arange(640.0), np.arange(512.0)), axis=-1)
    if name == "still":
        surface = StillWater()
    else:
        surface = solve_wave(TABLE_II[name].period_s, TABLE_II[name].steepness, 0.9)
    for side, time_s in (("left", 0.11), ("right", 0.43)):
        camera = CAMERAS[side]
        points = water_points(surface, camera, camera.rays(grid.nodes_px), time_s)
        x, y = grid.spread(points[..., 0]), grid.spread(points[..., 1])
        seen = camera.project(np.stack([x, y, surface.elevation(x, y, time_s)], axis=-1))
        assert np.linalg.norm(seen - pixels, axis=-1).max() < 0.001


def test_single_precision_is_good_to_a_thousandth_of_a_pixel(grid: PixelGrid) -> None:
    values = grid.nodes_px[..., 1] * 2 + 3000
    np.testing.assert_allclose(grid.spread_single(values), grid.spread(values), atol=0.001)


def test_pixels_of_a_band_are_those_of_the_whole(grid: PixelGrid) -> None:
    values = np.sin(grid.nodes_px[..., 0] / 90) * np.cos(grid.nodes_px[..., 1] / 70)
    band = grid.spread(values, slice(100, 137))
    column, row = np.meshgrid(np.arange(640.0), np.arange(100.0, 137.0))
    np.testing.assert_allclose(band, np.sin(column / 90) * np.cos(row / 70), atol=1e-9)


def test_oversampled_pixels_lie_evenly_within_each_pixel() -> None:
    fine = PixelGrid(16, 20, oversample=4, node_rows=4, node_columns=4)
    rows = fine.spread(fine.nodes_px[..., 1])
    np.testing.assert_allclose(rows[:4, 0], [-0.375, -0.125, 0.125, 0.375], atol=1e-12)
    assert rows.shape == (64, 80)


def test_depth_is_measured_along_the_optical_axis() -> None:
    camera = CAMERAS["left"]
    middle = camera.rays(camera.matrix[:2, 2])
    depth = intersect(StillWater(), camera, middle[None], 0.0)
    assert depth[0] == pytest.approx(0.6 / np.cos(np.radians(22.8)), rel=1e-12)


def test_a_camera_under_water_is_refused() -> None:
    wave = solve_wave(1.186, 0.0625, 0.9)
    with pytest.raises(ValueError, match=r"under water: the surface rises to 0\.0"):
        check_view(build_camera(Mounting(height_m=0.05)), wave)


@pytest.mark.parametrize("tilt_deg", [62.0, 89.0])
def test_a_camera_that_looks_along_the_water_is_refused(tilt_deg: float) -> None:
    with pytest.raises(ValueError, match="tilt the camera less"):
        check_view(build_camera(Mounting(tilt_deg=tilt_deg)), StillWater())
