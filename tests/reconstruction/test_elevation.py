"""The whole stage on synthetic runs whose surface is known."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from thermacq.errors import ReconstructionError, StoreError
from thermacq.reconstruction import (
    check_flat,
    find_world_frame,
    open_product,
    open_source,
    parts_folder_of,
    reconstruct,
    virtual_probe,
)


def silent(stage, done, total):
    pass


@pytest.fixture(scope="module")
def world(still_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("world") / "parts"
    frame = find_world_frame(open_source(still_run), folder, how="still water", workers=1, progress=silent)
    assert not folder.exists()
    return frame


@pytest.fixture(scope="module")
def product(wave_run, world, tmp_path_factory):
    path = tmp_path_factory.mktemp("product") / "eta.nc"
    result = reconstruct(open_source(wave_run), path, world=world, workers=2, progress=silent)
    assert result.pairs == 20
    return path


def truth_on(dataset, wave):
    x, y = np.meshgrid(dataset["x"].to_numpy(), dataset["y"].to_numpy())
    return np.stack([wave(x, y, t) for t in dataset["time"].to_numpy()])


def test_still_water_gives_the_pose_of_the_camera(world, scene):
    true = scene()
    assert world.camera_height_m == pytest.approx(true.height_m, abs=0.0005)
    assert world.tilt_deg == pytest.approx(true.tilt_deg, abs=0.05)
    np.testing.assert_allclose(world.rotation, true.rotation, atol=0.001)
    # Half the paper's resolution, so half its disparity: twice the 0.3 mm of the paper's Fig. 11.
    assert world.sigma_m < 0.0006
    assert world.sigma_mean_m < world.sigma_m
    check_flat(world)


def test_elevation_agrees_with_the_truth(product, wave):
    with open_product(product) as dataset:
        eta, true = dataset["eta"].to_numpy(), truth_on(dataset, wave)
        known = np.isfinite(eta)
        error = (eta - true)[known]
        assert known.mean() > 0.7
        assert np.percentile(np.abs(error), 95) < 0.0025
        assert abs(error.mean()) < 0.0003
        assert (eta[known] @ true[known]) / (true[known] @ true[known]) == pytest.approx(1.0, abs=0.02)
        probe = virtual_probe(dataset, 0.2, 0.0)
        x, t = 0.2, probe.time_s
        assert np.sqrt(np.mean((probe.eta_m - wave(x, 0.0, t)) ** 2)) < 0.0012


def test_every_supported_cell_has_its_points_and_no_other_has_a_height(product):
    with open_product(product) as dataset:
        eta, points = dataset["eta"].to_numpy(), dataset["eta_points"].to_numpy()
        least = dataset.attrs["min_points_per_cell"]
        np.testing.assert_array_equal(np.isfinite(eta), points >= least)
        np.testing.assert_array_equal(np.isfinite(dataset["eta_sd"].to_numpy()), points >= least)


def test_the_product_says_where_it_comes_from(product, wave_run):
    with open_product(product) as dataset:
        attributes = dataset.attrs
        source = open_source(wave_run)
        assert attributes["run_sha256"] == source.run_sha256
        assert attributes["calibration_sha256"] == source.calibration.sha256
        assert json.loads(attributes["matcher_settings"]) == source.settings
        assert attributes["world_frame_from"] == "still water"
        assert attributes["simulated"] == "true"
        assert json.loads(attributes["world_frame"])["frames"] == 10


def test_processes_and_one_process_give_the_same_numbers(product, wave_run, world, tmp_path):
    path = tmp_path / "eta.nc"
    reconstruct(open_source(wave_run), path, world=world, workers=1, progress=silent)
    with open_product(product) as first, open_product(path) as second:
        np.testing.assert_array_equal(first["eta"].to_numpy(), second["eta"].to_numpy())


def test_without_a_world_frame_the_mean_surface_is_the_plane(wave_run, tmp_path):
    """A standing wave over one whole period has a flat mean."""
    result = reconstruct(open_source(wave_run), tmp_path / "eta.nc", world=None, workers=2, progress=silent)
    assert result.world.camera_height_m == pytest.approx(0.6, abs=0.001)
    with open_product(tmp_path / "eta.nc") as dataset:
        assert dataset.attrs["world_frame_from"] == "mean surface"
    assert not parts_folder_of(tmp_path / "eta.nc").exists()


def test_an_interrupted_reconstruction_goes_on_where_it_stopped(wave_run, world, product, tmp_path):
    output, seen = tmp_path / "eta.nc", []

    def interrupt(stage, done, total):
        if done >= 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(open_source(wave_run), output, world=world, workers=1, progress=interrupt)
    assert not output.exists()
    assert list(parts_folder_of(output).glob("*/part-*.npz"))
    reconstruct(open_source(wave_run), output, world=world, workers=1, progress=lambda *p: seen.append(p[1]))
    assert seen[0] == 8
    with open_product(product) as first, open_product(output) as second:
        np.testing.assert_array_equal(first["eta"].to_numpy(), second["eta"].to_numpy())
    assert not parts_folder_of(output).exists()


def test_other_settings_do_not_take_over_old_parts(wave_run, world, tmp_path):
    output, seen = tmp_path / "eta.nc", []

    def interrupt(stage, done, total):
        if done >= 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(open_source(wave_run), output, world=world, workers=1, progress=interrupt)
    source = open_source(wave_run, frames="0:8", settings={"block_size": 5})
    reconstruct(source, output, world=world, workers=1, progress=lambda *p: seen.append(p[1]))
    assert seen[0] == 0


def test_waves_are_not_taken_for_still_water(wave_run, tmp_path):
    frame = find_world_frame(
        open_source(wave_run), tmp_path / "parts", how="still water", workers=1, progress=silent
    )
    with pytest.raises(ReconstructionError, match="not still water"):
        check_flat(frame)


def test_an_existing_product_and_a_foreign_world_frame_are_refused(wave_run, world, tmp_path):
    source = open_source(wave_run)
    (tmp_path / "eta.nc").write_text("mine")
    with pytest.raises(StoreError, match="exists"):
        reconstruct(source, tmp_path / "eta.nc", world=world, workers=1, progress=silent)
    assert (tmp_path / "eta.nc").read_text() == "mine"
    foreign = dataclasses.replace(world, source={**world.source, "calibration_sha256": "other"})
    with pytest.raises(ReconstructionError, match="another calibration"):
        reconstruct(source, tmp_path / "new.nc", world=foreign, workers=1, progress=silent)


def test_a_matcher_that_finds_nothing_is_explained(wave_run, world, tmp_path):
    settings = {"min_disparity": 100, "max_disparity": 120}
    source = open_source(wave_run, frames="0:2", settings=settings)
    with pytest.raises(ReconstructionError, match=r"no common view|found no surface"):
        reconstruct(source, tmp_path / "eta.nc", world=world, workers=1, progress=silent)
    with pytest.raises(ReconstructionError, match=r"found nothing|plane"):
        find_world_frame(source, tmp_path / "parts", how="still water", workers=1, progress=silent)
    assert not (tmp_path / "eta.nc").exists()
