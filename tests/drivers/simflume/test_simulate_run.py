"""``thermacq simulate run``: every ready scene through the ordinary recorder."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from thermacq.errors import RigError, StoreError
from thermacq.plugins import plugins
from thermacq.rig import parse_rig
from thermacq.store import open_run
from thermacq_drivers.simflume.commands import app
from thermacq_drivers.simflume.ready_made import RIGS, rig_toml, scene_summaries, scene_toml
from thermacq_drivers.simflume.scene import build_surface
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.simulate_run import simulate

Recording = Future[tuple[subprocess.CompletedProcess[str], Path]]


def simulate_run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "thermacq", "simulate", "run", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "NO_COLOR": "1"}
    )


@pytest.mark.parametrize("name", RIGS)
def test_ready_rigs_fit_themselves(name: str) -> None:
    values = tomllib.loads(rig_toml(name))
    assert plugins().rig_checks(parse_rig(rig_toml(name))) == []
    assert CliRunner().invoke(app, ["rig", name]).stdout == rig_toml(name)
    parse_scene(values["scene"])


def test_what_is_not_there_is_refused_before_anything_is_recorded(tmp_path: Path) -> None:
    run, truth = tmp_path / "run.h5", tmp_path / "truth.nc"
    with pytest.raises(RigError, match="no scene 'storm'"):
        simulate("storm", None, run, [], None)
    with pytest.raises(RigError, match="no ready rig 'storm'"):
        simulate("still", "storm", run, [], None)
    truth.touch()
    with pytest.raises(StoreError, match="exists"):
        simulate("still", None, run, [], truth)
    assert not run.exists()


def test_a_scene_file_in_the_place_of_a_command_is_run(tmp_path: Path) -> None:
    (tmp_path / "storm.toml").write_text("wind = 12\n")
    command = [sys.executable, "-m", "thermacq", "simulate", "storm.toml", "-o", "run.h5", "--frames", "3"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "wind" in done.stderr
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.slow
def test_a_scene_file_with_its_truth(tmp_path: Path) -> None:
    scene, run, truth = tmp_path / "waves.toml", tmp_path / "run.h5", tmp_path / "truth.nc"
    scene.write_text(scene_toml("T0.791-H2/25"))
    done = simulate_run(scene, "-o", run, "--frames", "3", "--truth", truth)
    assert done.returncode == 0, done.stderr
    surface = build_surface(parse_scene(tomllib.loads(scene_toml("T0.791-H2/25"))))
    with open_run(run) as recorded, xr.open_dataset(truth, engine="h5netcdf") as known:
        assert recorded.complete
        assert recorded.frame_count("left") == 3
        np.testing.assert_allclose(known.time, np.arange(3) * 0.02, atol=1e-6)
        x, y = np.meshgrid(known.x, known.y)
        np.testing.assert_allclose(known.eta[2], surface.elevation(x, y, float(known.time[2])), atol=1e-12)
        assert known.attrs["run_sha256"] == recorded.sha256()


@pytest.mark.slow
def test_errors_and_exit_status_of_the_recorder_pass_through(tmp_path: Path) -> None:
    scene, run = tmp_path / "bad.toml", tmp_path / "run.h5"
    scene.write_text('surface = { kind = "regular", period_s = 0.8, steepness = 0.2 }\n')
    done = simulate_run(scene, "-o", run, "--frames", "3", "--truth", tmp_path / "truth.nc")
    assert done.returncode == 1
    assert "steep" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == [scene]


@pytest.mark.slow
def test_the_mis_synchronised_rig(tmp_path: Path) -> None:
    run, truth = tmp_path / "run.h5", tmp_path / "truth.nc"
    done = simulate_run("mis-synchronised", "-o", run, "--frames", "100", "--truth", truth)
    assert done.returncode == 0, done.stderr
    with open_run(run) as recorded:
        left, right = recorded.frames("left"), recorded.frames("right")
        pulse_s = left.trigger_ns / 1e9
        assert len(left) == 100
        assert 85 < len(right) < 100
        assert np.isin(right.trigger_index, left.trigger_index).all()
        # Pulses missed and frames lost: only the lost ones show in the camera's counter.
        gaps = (np.diff(right.sequence_number) - 1).sum()
        assert 0 < gaps < (np.diff(right.trigger_index) - 1).sum()
        latency_s = (right.ticks / 1e6 - 3.25) / (1 - 250e-6) - right.trigger_ns / 1e9
        assert 0.003 < latency_s.mean() < 0.0034
        assert 0.0001 < latency_s.std() < 0.0004
    with xr.open_dataset(truth, engine="h5netcdf") as known:
        np.testing.assert_allclose(known.time, pulse_s, atol=1e-6)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Recording]]:
    """Every scene, recorded two at a time: a recording of three frames waits for its processes most of the time."""
    folder = tmp_path_factory.mktemp("scenes")

    def record(name: str) -> tuple[subprocess.CompletedProcess[str], Path]:
        path = folder / f"{name}.h5"
        return simulate_run(name, "-o", path, "--frames", "3"), path

    with ThreadPoolExecutor(2) as pool:
        yield {name: pool.submit(record, name) for name in scene_summaries()}


@pytest.mark.slow
@pytest.mark.parametrize("name", scene_summaries())
def test_every_scene_can_be_recorded(name: str, recordings: dict[str, Recording]) -> None:
    done, path = recordings[name].result()
    assert done.returncode == 0, done.stderr
    with open_run(path) as run:
        assert run.complete
        assert run.frame_count("left") == 3
        counts = run.counts("left", 2)
        assert counts.std() > 0
        assert np.ptp(counts) < 2**14
