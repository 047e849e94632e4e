from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from thermacq.devices import DeviceContext, TriggerMode
from thermacq.errors import RigError, StoreError, ThermacqError
from thermacq.hooks import TruthRequest
from thermacq.plugins import plugins
from thermacq.rig import parse_rig
from thermacq.store import CameraStream, FrameRow, RunHeader, RunWriter, open_run
from thermacq.timing import VirtualClock
from thermacq_drivers.simflume.camera import SimulatedCamera
from thermacq_drivers.simflume.cases import TABLE_II
from thermacq_drivers.simflume.commands import app
from thermacq_drivers.simflume.correspondence import correspondence
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.ready_made import rig_toml, scene_names, scene_toml
from thermacq_drivers.simflume.scene import build_surface
from thermacq_drivers.simflume.settings import parse_scene
from thermacq_drivers.simflume.sight import build_sight
from thermacq_drivers.simflume.truth_file import write_truth

ROOT = Path(__file__).resolve().parents[3]
FRAMES = 4


def rig_values(scene: dict[str, Any], small: dict[str, Any], **left: Any) -> dict[str, Any]:
    rig = parse_rig(rig_toml()).model_dump(mode="json")
    for side in ("left", "right"):
        rig["cameras"][side]["settings"] = {**small, "side": side, **left}
    return {**rig, "scene": scene}


@pytest.fixture
def record(tmp_path: Path, small: dict[str, Any], host: Any) -> Callable[..., Path]:
    """Record a short run with a simulated left camera; the right one gets no frames."""

    def make(scene: dict[str, Any], **left: Any) -> Path:
        rig = rig_values(scene, small, **left)
        clock = VirtualClock()
        camera = SimulatedCamera(DeviceContext("left", clock, scene, tmp_path))
        camera.open()
        camera.configure(rig["cameras"]["left"]["settings"])
        camera.arm(TriggerMode.SOFTWARE, 50.0)
        header = RunHeader("id", "", "2020-01-01T00:00:00Z", 0, 0, "virtual", True, rig)
        capabilities = {"counter_bits": 16, "bit_depth": 14}
        streams = [CameraStream(name, 128, 160, capabilities=capabilities) for name in ("left", "right")]
        writer = RunWriter.create(tmp_path / "run.h5", header, streams)
        stream = camera.frames(host)
        for index in range(FRAMES):
            clock.wait_until_ns(index * 20_000_000)
            camera.trigger(index)
            frame = next(stream)
            row = FrameRow(
                frame.counter, frame.ticks, frame.host_ns, index, index * 20_000_000, int(frame.flags)
            )
            writer.append_frame("left", frame.counts, row)
        writer.finish({}, "completed")
        return tmp_path / "run.h5"

    return make


def test_the_hook_gives_elevation_and_facts(wave: dict[str, Any], small: dict[str, Any]) -> None:
    rig = rig_values(wave, small)
    time_s, x_m, y_m = np.array([0.0, 0.1, 5.0]), np.linspace(0.1, 0.5, 7), np.array([-0.1, 0.1])
    truth = plugins().truth(TruthRequest(wave, time_s, x_m, y_m, rig))
    assert truth is not None
    assert truth.eta_m.shape == (3, 2, 7)
    surface = build_surface(parse_scene(wave))
    np.testing.assert_allclose(truth.eta_m[2, 1], surface.elevation(x_m, np.zeros(1), 5.0), atol=1e-15)
    json.dumps(truth.facts)
    assert truth.facts["surface"]["period_s"] == pytest.approx(0.791)
    assert truth.facts["clocks"]["probe"]["drift_ppm"] == 25.0
    calibration = truth.facts["calibration"]
    assert calibration["baseline_m"] == pytest.approx(0.0604, abs=1e-4)
    left, right = (
        build_camera(Mounting.model_validate({**small, "side": side})) for side in ("left", "right")
    )
    point = np.array([0.2, 0.0, 0.03])
    in_left = left.rotation @ (point - left.centre_m)
    in_right = np.array(calibration["rotation"]) @ in_left + calibration["translation_m"]
    np.testing.assert_allclose(right.project_camera(in_right), right.project(point), atol=1e-9)
    pose = calibration["left_camera_to_world"]
    np.testing.assert_allclose(
        np.array(pose["rotation"]) @ in_left + pose["translation_m"], point, atol=1e-12
    )


def test_the_hook_is_silent_about_scenes_of_others() -> None:
    nothing = np.zeros(1)
    assert plugins().truth(TruthRequest({}, nothing, nothing, nothing)) is None
    assert plugins().truth(TruthRequest({"simulator": "other"}, nothing, nothing, nothing)) is None
    rig = {"cameras": {"left": {"driver": "sim-camera"}}}
    still = plugins().truth(TruthRequest({}, nothing, nothing, nothing, rig))
    assert still is not None
    assert still.facts["surface"] == {"kind": "still"}


def test_the_truth_file(
    record: Callable[..., Path], wave: dict[str, Any], small: dict[str, Any], tmp_path: Path
) -> None:
    run = record(wave, clock={"offset_s": 4.0, "drift_ppm": 50.0, "tick_rate_hz": 1e9})
    output = tmp_path / "truth.nc"
    write_truth(run, output, spacing_m=0.02, dense_frames=[2])
    surface = build_surface(parse_scene(wave))
    with xr.open_dataset(output, engine="h5netcdf") as truth:
        np.testing.assert_allclose(truth.time, np.arange(FRAMES) * 0.02, atol=2e-9)
        x, y = np.meshgrid(truth.x, truth.y)
        np.testing.assert_allclose(truth.eta[3], surface.elevation(x, y, 0.06), atol=1e-8)
        left, right = (
            build_camera(Mounting.model_validate({**small, "side": side})) for side in ("left", "right")
        )
        expected = correspondence(build_sight(parse_scene(wave), surface, left), right, 0.04)
        np.testing.assert_allclose(truth.left_depth[0], expected.depth_m, atol=1e-8)
        np.testing.assert_allclose(truth.left_column[0], expected.column_px, atol=1e-5)
        assert json.loads(truth.attrs["facts"])["clocks"]["left"]["offset_s"] == 4.0
        assert len(truth.attrs["run_sha256"]) == 64
        # What both cameras see: more than a third of a metre along the flume, half a metre across it.
        assert np.ptp(truth.x.values) > 0.35
        assert np.ptp(truth.y.values) > 0.5


def test_the_truth_of_a_loop_repeats(
    record: Callable[..., Path], wave: dict[str, Any], tmp_path: Path
) -> None:
    run = record(wave, cached_loop_frames=3)
    write_truth(run, tmp_path / "truth.nc", spacing_m=0.05, dense_frames=[])
    with xr.open_dataset(tmp_path / "truth.nc", engine="h5netcdf") as truth:
        np.testing.assert_allclose(truth.time, [0.0, 0.02, 0.04, 0.0])


def test_truth_that_cannot_be_written_is_explained(
    record: Callable[..., Path], wave: dict[str, Any], tmp_path: Path
) -> None:
    run = record(wave)
    with pytest.raises(ThermacqError, match="no frame 99"):
        write_truth(run, tmp_path / "a.nc", 0.01, [99])
    with pytest.raises(StoreError, match="exists"):
        write_truth(run, run, 0.01, [])
    with pytest.raises(StoreError, match="cannot be written"):
        write_truth(run, tmp_path / "nowhere" / "a.nc", 0.01, [])
    with pytest.raises(StoreError, match="no run file"):
        write_truth(tmp_path / "none.h5", tmp_path / "a.nc", 0.01, [])


def test_a_run_without_water_has_no_dense_truth(record: Callable[..., Path], tmp_path: Path) -> None:
    run = record({"view": "chessboard"})
    with pytest.raises(ThermacqError, match="not the water"):
        write_truth(run, tmp_path / "a.nc", 0.01, [0])


def test_bad_pixels_are_told_by_reason(record: Callable[..., Path], tmp_path: Path) -> None:
    raw = {"sensor": {"bad_pixels": "raw", "bad_pixel_fraction": 0.01, "offset_k": 1.0}}
    scene = {"view": "uniform", "uniform": {"temperatures_k": [295.0]}, "camera": raw}
    run = record(scene)
    write_truth(run, tmp_path / "truth.nc", 0.05, [])
    truth = xr.load_dataset(tmp_path / "truth.nc", engine="h5netcdf")
    bad = truth.left_bad_pixels
    assert bad.attrs["flag_meanings"] == "dead hot noisy blinking outlier"
    assert (bad.to_numpy() > 0).mean() == pytest.approx(0.01, rel=0.25)
    assert (truth.right_bad_pixels.to_numpy() != bad.to_numpy()).any()
    with open_run(run) as file:
        counts = file.counts("left", 0)
    assert (counts[bad.to_numpy() == 2] == 2**14 - 1).all()
    # The offsets are those of the picture, up to noise.
    good = bad.to_numpy() == 0
    assert (counts - truth.left_offset.to_numpy())[good].std() < 8
    assert "eta" not in truth


def test_corners_of_each_frame(record: Callable[..., Path], tmp_path: Path) -> None:
    scene = {"view": "chessboard", "chessboard": {"frames_per_view": 2}}
    run = record(scene, shutter={"at_s": [0.05], "closed_s": 0.5})
    write_truth(run, tmp_path / "truth.nc", 0.05, [])
    truth = xr.load_dataset(tmp_path / "truth.nc", engine="h5netcdf")
    corners = truth.left_corners.to_numpy()
    assert corners.shape == (4, 54, 2)
    np.testing.assert_array_equal(corners[0], corners[1])
    assert np.abs(corners[2] - corners[0]).max() > 5
    assert np.isnan(corners[3]).all()  # frozen by the shutter


def test_examples_are_what_the_commands_print() -> None:
    runner = CliRunner()
    printed = {name: runner.invoke(app, ["scene", name]).stdout for name in ("still", "chessboard")}
    printed["wave"] = runner.invoke(app, ["scene", "T0.791-H2/25"]).stdout
    for name, text in printed.items():
        assert (ROOT / "examples" / "scenes" / f"{name}.toml").read_text() == text
    assert (ROOT / "examples" / "simulated_flume.toml").read_text() == runner.invoke(app, ["rig"]).stdout


def test_every_ready_scene_is_valid() -> None:
    import tomllib

    for name in scene_names():
        parse_scene(tomllib.loads(scene_toml(name)))
    with pytest.raises(RigError, match="no scene 'storm'"):
        scene_toml("storm")


def test_list_shows_table_ii() -> None:
    rows = json.loads(CliRunner().invoke(app, ["list", "--json"]).stdout)
    assert [row["name"] for row in rows] == list(TABLE_II)
    assert all(row["height_m"] == pytest.approx(row["paper_height_m"], rel=0.02) for row in rows)
    assert "T1.186-H1/16" in CliRunner().invoke(app, ["list"]).stdout


def test_the_truth_command(record: Callable[..., Path], wave: dict[str, Any], tmp_path: Path) -> None:
    output = tmp_path / "truth.nc"
    result = CliRunner().invoke(app, ["truth", str(record(wave)), "-o", str(output), "--dense", "1"])
    assert result.exit_code == 0
    with xr.open_dataset(output, engine="h5netcdf") as truth:
        assert truth.right_depth.shape == (1, 128, 160)


def test_rig_checks_find_what_does_not_fit() -> None:
    def findings(old: str, new: str) -> str:
        text = rig_toml()
        assert old in text
        return "; ".join(f.message for f in plugins().rig_checks(parse_rig(text.replace(old, new))))

    assert findings("[clock]", "[clock]") == ""
    assert "both simulated cameras are on the left side" in findings('side = "right"', 'side = "left"')
    assert "stands at (0.25, -0.03) m" in findings(
        "x_m = 0.25\ny_m = -0.03\ncoef", "x_m = 0.2\ny_m = -0.03\ncoef"
    )
    assert "20 V/m" in findings("coefficient_m_per_unit = 0.05", "coefficient_m_per_unit = 0.5")
    assert "which nobody pulses" in findings("sample_rate_hz", 'line = "c"\nsample_rate_hz')
    box = (
        '[trigger_sources.box]\ndriver = "sim-trigger"\nsettings = { line = "b" }\n[trigger]\nsource = "box"'
    )
    text = rig_toml().replace('[trigger]\nmode = "software"', f'{box}\nmode = "hardware"')
    messages = [finding.message for finding in plugins().rig_checks(parse_rig(text))]
    assert "camera 'left' listens to line 'trigger', the source pulses 'b'" in messages
