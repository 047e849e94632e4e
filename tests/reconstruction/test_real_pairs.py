"""Public pairs from import to depth, as a user of existing footage would go."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from thermacq.cli.app import app


def run(*words):
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, f"{result.output}\n{result.exception}"
    return result.stdout


def imported(folder, left, right, size, **geometry):
    run("import", "--left", left, "--right", right, "--rate-hz", "1", "-o", folder / "run.h5")
    words = [word for name, value in geometry.items() for word in (f"--{name.replace('_', '-')}", value)]
    run("calibration", "rectified", "--size", size, *words, "-o", folder / "calibration.json")
    return folder / "run.h5", "-c", folder / "calibration.json", "--json"


def test_motorcycle_cloud_agrees_with_the_true_depth(shared_data, tmp_path):
    data = shared_data / "middlebury_motorcycle"
    pair = imported(
        tmp_path,
        data / "motorcycle_left.png",
        data / "motorcycle_right.png",
        "741x500",
        focal_px=994.978,
        baseline_m=0.193001,
        doffs_px=31.086,
    )
    # Visible light and steps of depth everywhere: small blocks, no smoothing, nothing to refine.
    for_steps = ["block_size=3", "presmooth_px=0", "shading_degree=0", "refine=false", "mode=hh"]
    settings = [word for setting in for_steps for word in ("--set", setting)]
    words = ("--truth", data / "motorcycle_disp.npz", "--cloud", tmp_path / "cloud.ply")
    values = json.loads(run("disparity", *pair, *words, *settings))
    assert values["errors"]["density"] > 0.846
    assert values["errors"]["bad2"] < 0.059
    assert values["errors"]["epe_px"] < 0.99
    assert values["depth_errors"]["median_relative"] < 0.004
    assert values["depth_errors"]["within_1_percent"] > 0.85
    assert values["cloud_points"] > 300_000


def test_raw_16_bit_thermal_pair_is_matched(shared_data, tmp_path):
    data = shared_data / "ms2_thermal"
    pair = imported(
        tmp_path,
        data / "left_000011_thr.png",
        data / "right_000011_thr.png",
        "640x256",
        focal_px=430,
        baseline_m=0.3,
    )
    values = json.loads(run("disparity", *pair, "--set", "min_disparity=0", "--set", "max_disparity=40"))
    assert values["density"] > 0.6
    assert 5 < values["disparity_px"]["median"] < 15


@pytest.mark.parametrize("number", [1, 2])
def test_thermal_pair_with_negative_disparities_is_matched(shared_data, tmp_path, number):
    data = shared_data / "cats_thermal_stereo"
    pair = imported(
        tmp_path,
        data / f"left_{number}.png",
        data / f"right_{number}.png",
        "640x480",
        focal_px=700,
        baseline_m=0.1,
        doffs_px=60,
    )
    values = json.loads(run("disparity", *pair))
    assert values["disparity_px"]["median"] < 0
    assert values["settings"]["min_disparity"] <= -32
    assert values["density"] > 0.5
