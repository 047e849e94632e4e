"""The three commands, as a user runs them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from thermacq.cli.app import app
from thermacq.reconstruction import load_disparity, load_world_frame, open_product


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def failure(*words):
    """What a failing command would tell the user."""
    result = run(*words)
    assert result.exit_code != 0
    error = result.exception
    assert hasattr(error, "what"), f"{type(error).__name__}: {error}"
    return error.what


def test_still_water_then_waves_to_a_product(still_run, wave_run, tmp_path):
    world, eta = tmp_path / "world.json", tmp_path / "eta.nc"
    result = run("still-water", still_run, "-o", world, "--workers", 1)
    assert result.exit_code == 0, result.output
    assert "standard deviation 0." in result.stdout
    assert "tilted 22." in result.stdout
    assert load_world_frame(world).frames == 10
    result = run("reconstruct", wave_run, "-w", world, "-o", eta, "--frames", "0:4", "--workers", 1, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["pairs"] == 4
    with open_product(eta) as dataset:
        assert dataset.sizes["time"] == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == ["eta.nc", "world.json"]


def test_without_a_world_frame_it_says_what_zero_is(still_run, tmp_path):
    result = run("reconstruct", still_run, "-o", tmp_path / "eta.nc", "--frames", "0:3", "--workers", 1)
    assert result.exit_code == 0, result.output
    assert "z = 0 is the mean surface of 3 pairs of this run" in result.stdout


def test_disparity_of_one_pair_with_truth_and_point_cloud(still_run, tmp_path, scene):
    truth = tmp_path / "truth.npz"
    np.savez(truth, scene().pair()[2])
    cloud, output = tmp_path / "cloud.ply", tmp_path / "d.npz"
    words = ("disparity", still_run, "--frame", 3, "--truth", truth, "-o", output, "--cloud", cloud)
    result = run(*words, "--json")
    assert result.exit_code == 0, result.output
    values = json.loads(result.stdout)
    assert values["errors"]["density"] > 0.85
    assert values["errors"]["epe_px"] < 0.05
    assert values["depth_errors"]["within_1_percent"] > 0.99
    assert np.isfinite(load_disparity(output)).sum() == values["cloud_points"]
    assert cloud.read_bytes().startswith(b"ply\n")
    assert "exists" in failure(*words)
    plain = run("disparity", still_run, "--truth", truth, "--set", "refine=false")
    assert "bad2" in plain.stdout
    assert "EPE" in plain.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--frame", "99"), "range 99:100 holds none"),
        (("--set", "blok_size=3"), "block_size"),
        (("--set", "nonsense"), "no setting"),
        (("--matcher", "nonsense"), "no matcher named"),
        (("-c", "missing.json"), "there is no file"),
        (("--truth", "missing.npz"), "there is no file"),
    ],
)
def test_wrong_words_are_explained(still_run, words, message):
    assert message in failure("disparity", still_run, *words)


def test_wrong_files_are_explained(still_run, wave_run, tmp_path):
    (tmp_path / "no.h5").write_text("no run")
    (tmp_path / "mine.json").write_text("mine")
    (tmp_path / "mine.nc").write_text("mine")
    assert "HDF5" in failure("disparity", tmp_path / "no.h5")
    assert "exists" in failure("still-water", still_run, "-o", tmp_path / "mine.json")
    assert "exists" in failure(
        "reconstruct", still_run, "-o", tmp_path / "mine.nc", "--workers", 1, "--frames", "0:1"
    )
    assert "world frame" in failure(
        "reconstruct", still_run, "-w", tmp_path / "mine.json", "-o", tmp_path / "a.nc"
    )
    assert "no folder" in failure("reconstruct", still_run, "-o", tmp_path / "none" / "eta.nc")
    assert "no folder" in failure("still-water", still_run, "-o", tmp_path / "none" / "world.json")
    assert "not still water" in failure(
        "still-water", wave_run, "-o", tmp_path / "w.json", "--frames", "0:4", "--workers", 1
    )
    assert not (tmp_path / "w.json").exists()


@pytest.mark.slow
def test_ctrl_c_keeps_parts_says_how_to_go_on_and_the_same_command_does(wave_run, tmp_path):
    """The real thing: SIGINT to the whole process group, as a terminal sends it."""
    output = tmp_path / "eta.nc"
    command = [sys.executable, "-m", "thermacq", "reconstruct", wave_run, "-o", output, "--workers", "2"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    folder = tmp_path / "eta.nc.parts"
    deadline = time.monotonic() + 60
    while not list(folder.glob("*/part-*.npz")) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=280)
    assert process.returncode == 130
    assert "Run the same command again" in said
    assert "Traceback" not in said
    assert not output.exists()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert output.exists()
    assert not folder.exists()
