"""Fixtures that several test folders share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import settings
from scipy.spatial.transform import Rotation

from thermacq.hooks import Truth
from thermacq.reconstruction import Grid, WorldFrame
from thermacq.reconstruction.product import ProductWriter
from thermacq.store import (
    CameraStream,
    Event,
    EventKind,
    FrameRow,
    ProbeStream,
    RunHeader,
    RunWriter,
    open_run,
)
from thermacq_calibration import Board, CameraModel, Detection, StereoCalibration, View

# How long an example takes says nothing on a busy computer.
settings.register_profile("thermacq", parent=settings.default, deadline=None)
settings.load_profile("thermacq")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real data beside the repository; tests that need it are skipped where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"real data is not here ({folder})")
    return folder


@dataclass(frozen=True)
class SyntheticPair:
    """Two pinhole cameras with known geometry that look at a chessboard held in known poses.

    A pose is (rotation (3, 3), translation (3,) metres), board to left camera.
    """

    truth: StereoCalibration
    board: Board

    def poses(self, count: int, seed: int = 0, tilt_deg: float = 35.0):
        """Diverse poses, all of the board in both pictures."""
        random = np.random.default_rng(seed)
        found = []
        while len(found) < count:
            tilt = Rotation.from_euler(
                "xyz", [*random.uniform(-tilt_deg, tilt_deg, 2), random.uniform(-15, 15)], degrees=True
            ).as_matrix()
            middle = self.corner_points().mean(axis=0)
            depth = random.uniform(0.55, 0.9)
            shift = np.append(random.uniform(-0.3, 0.3, 2) * depth, depth)
            pose = (tilt, shift - tilt @ middle)
            if all(self._inside(corners) for corners in self.corners(pose)):
                found.append(pose)
        return found

    def corner_points(self):
        """Inner corners in the board's frame, (corners, 3) metres."""
        rows, columns = np.mgrid[: self.board.rows, : self.board.columns]
        return np.stack([columns, rows, 0 * rows], axis=-1).reshape(-1, 3) * self.board.square_m

    def corners(self, pose, noise_px: float = 0.0, seed: int = 0):
        """Pixels of the corners in the left and the right picture."""
        random = np.random.default_rng(seed)
        points = self.corner_points() @ pose[0].T + pose[1]
        turn, _ = cv2.Rodrigues(self.truth.rotation)
        still = np.zeros(3)
        found = []
        for camera, rvec, tvec in (
            (self.truth.left, still, still),
            (self.truth.right, turn, self.truth.translation_m),
        ):
            pixels = cv2.projectPoints(points, rvec, tvec, camera.matrix, camera.distortion)[0].reshape(-1, 2)
            found.append(pixels + random.normal(0, noise_px, pixels.shape))
        return found

    def views(self, count: int, noise_px: float = 0.0, seed: int = 0, tilt_deg: float = 35.0):
        """Views with corners as a perfect detector with noise would find them."""
        views = []
        for index, pose in enumerate(self.poses(count, seed, tilt_deg)):
            pixels = self.corners(pose, noise_px, seed=1000 * seed + index)
            views.append(View(f"{index:02d}", *(Detection(one, 2.5, 500.0) for one in pixels)))
        return views

    def pictures(self, pose, **look):
        """Left and right picture of a pose; see `render`. Lens distortion is left out."""
        right = (
            self.truth.rotation @ pose[0],
            self.truth.rotation @ pose[1] + self.truth.translation_m,
        )
        return tuple(
            self.render(camera.matrix, one, **look)
            for camera, one in ((self.truth.left, pose), (self.truth.right, right))
        )

    def render(self, matrix, pose, blur_px=0.7, contrast=800.0, noise=6.0, inverted=False, seed=0):
        """Picture of the board, (rows, columns) uint16; the first inner square is bright unless inverted."""
        columns, rows = self.truth.image_size
        fine = 3
        v, u = np.mgrid[: rows * fine, : columns * fine].astype(float)
        u, v = (u + 0.5) / fine - 0.5, (v + 0.5) / fine - 0.5
        rotation, shift = pose
        homography = np.linalg.inv(matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], shift]))
        x, y, w = np.tensordot(homography, np.stack([u, v, np.ones_like(u)]), axes=1)
        x, y = x / w / self.board.square_m, y / w / self.board.square_m
        bright = (np.floor(x) + np.floor(y)) % 2 == 0
        on_board = (x > -1) & (x < self.board.columns) & (y > -1) & (y < self.board.rows)
        light = np.where(on_board, bright != inverted, False).astype(float)
        light = light.reshape(rows, fine, columns, fine).mean(axis=(1, 3))
        light = cv2.GaussianBlur(light, (0, 0), blur_px)
        counts = 8000 + contrast * light + np.random.default_rng(seed).normal(0, noise, light.shape)
        return np.rint(counts).astype(np.uint16)

    def _inside(self, corners) -> bool:
        margin = 0.07 * self.truth.image_size[0]
        limits = np.array(self.truth.image_size) - 1 - margin
        return bool((corners >= margin).all() and (corners <= limits).all())


def _pair(size, focal, distortion) -> SyntheticPair:
    columns, rows = size
    matrices = [
        np.array([[focal + shift, 0, columns / 2 + shift], [0, focal + shift, rows / 2 - shift], [0, 0, 1]])
        for shift in (0.0, 2.0)
    ]
    rotation = Rotation.from_euler("xyz", [0.4, -0.8, 0.3], degrees=True).as_matrix()
    truth = StereoCalibration(
        size,
        CameraModel(matrices[0], np.array(distortion)),
        CameraModel(matrices[1], np.array(distortion) * 0.8),
        rotation,
        np.array([-0.06, 0.0006, -0.0009]),
    )
    return SyntheticPair(truth, Board(9, 6, 0.05))


@pytest.fixture(scope="session")
def pair() -> SyntheticPair:
    """The paper's cameras (640 x 512, f = 705.9 px, 6 cm) with distorting lenses; for corners."""
    return _pair((640, 512), 705.9, [-0.12, 0.06, 3e-4, -2e-4, 0.0])


@pytest.fixture(scope="session")
def small_pair() -> SyntheticPair:
    """Cameras of a quarter of the pixels and without distortion; for pictures."""
    return _pair((320, 256), 352.9, [0.0, 0.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class MeasuredWave:
    """A tiny run of a wave along x, the products of it and of still water; everything follows a formula.

    The product shows the wave 2 % too low, the probe reads 1 % too high and its clock is 20 ppm fast.
    """

    run: Path
    product: Path
    still: Path
    calibration: Path
    wave_number: float = 2 * np.pi / 0.95
    angular_frequency: float = 2 * np.pi / 0.791
    amplitude_m: float = 0.04

    def elevation(self, time_s, x_m):
        """Elevation, metres; the arguments broadcast."""
        return self.amplitude_m * np.cos(self.wave_number * x_m - self.angular_frequency * time_s)


@pytest.fixture(scope="session")
def measured_wave(tmp_path_factory) -> MeasuredWave:
    """Run and products of a known wave, for everything that judges results."""
    folder = tmp_path_factory.mktemp("measured")
    files = MeasuredWave(
        folder / "wave.h5", folder / "wave.nc", folder / "still.nc", folder / "calibration.json"
    )
    calibration = StereoCalibration.from_rectified((160, 128), 176.0, (79.5, 63.5), 0.06)
    calibration.save(files.calibration)
    _write_wave_run(files, calibration)
    with open_run(files.run) as run:
        header, run_sha256 = run.header, run.sha256()
    tilt = np.radians(22.8)
    world = WorldFrame(
        rotation=np.array([[0, -np.cos(tilt), np.sin(tilt)], [-1, 0, 0], [0, -np.sin(tilt), -np.cos(tilt)]]),
        translation_m=np.array([0.0, 0.0, 0.6]),
        sigma_m=3e-4,
        sigma_mean_m=1e-4,
        covariance=np.zeros((3, 3)),
        points=1000,
        frames=10,
    )
    attributes = {
        "run": "wave.h5",
        "run_id": header.run_id,
        "run_sha256": run_sha256,
        "calibration_sha256": calibration.sha256,
        "matcher": "sgbm",
        "matcher_settings": {"min_disparity": 8, "max_disparity": 40},
        "simulated": True,
        "thermacq_version": "0",
        "world_frame": world.to_dict(),
        "world_frame_from": "world.json",
        "camera_height_m": 0.6,
        "still_water_sigma_m": 3e-4,
        "focal_px": 176.0,
        "baseline_m": 0.06,
        "pairs_left_out": 0,
        "min_points_per_cell": 3,
    }
    grid = Grid(np.round(np.arange(0.1, 0.501, 0.02), 9), np.round(np.arange(-0.1, 0.101, 0.02), 9), 0.02)
    time_s = np.arange(200) * 0.02
    wave = 0.98 * np.broadcast_to(files.elevation(time_s[:, None, None], grid.x_m), (200, *grid.shape))
    _write_product(files.product, grid, time_s, wave, attributes, header)
    noise = np.random.default_rng(0).normal(0, 3e-4, (10, *grid.shape))
    _write_product(files.still, grid, time_s[:10], noise, attributes, header)
    return files


@pytest.fixture
def known_truth(monkeypatch, measured_wave):
    """A plugin that knows the truth of the scene of `measured_wave`, and of no other."""

    class Plugins:
        def truth(self, request):
            if request.scene.get("surface") != "wave":
                return None
            return Truth(measured_wave.elevation(request.time_s[:, None, None], request.x_m))

    monkeypatch.setattr("thermacq.evaluation.run_comparison.plugins", Plugins)


def _write_product(path, grid, time_s, eta_m, attributes, header) -> None:
    eta = eta_m.astype(np.float32)
    eta[:, :, 0] = np.nan
    with ProductWriter(path, grid, time_s, attributes, header) as product:
        product.append(eta, np.where(np.isfinite(eta), 9, 0).astype(np.int32), np.full_like(eta, 5e-4))


def _write_wave_run(files: MeasuredWave, calibration: StereoCalibration) -> None:
    rig = {
        "cameras": {"left": {"driver": "x"}, "right": {"driver": "x"}},
        "probes": {"P1": {"driver": "y", "x_m": 0.3, "coefficient_m_per_unit": 0.05, "zero_raw": 2.5}},
        "scene": {"surface": "wave"},
    }
    header = RunHeader(
        "run-1",
        "A <b>known</b> wave",
        "2026-01-01T00:00:00Z",
        0,
        10**9,
        "virtual",
        True,
        rig,
        calibration.to_dict(),
    )
    texture = cv2.GaussianBlur(np.random.default_rng(1).normal(0, 1, (128, 200)), (0, 0), 1.5)
    counts = np.clip(9000 + 800 * texture / texture.std(), 0, 65535).astype(np.uint16)
    streams = [CameraStream(name, 128, 160) for name in ("left", "right")]
    with RunWriter.create(files.run, header, streams, [ProbeStream("P1", ("a",), "V", 1e6)]) as writer:
        for index in range(200):
            fired = 10**9 + index * 20_000_000
            for name, shift in (("left", 0), ("right", 24)):
                row = FrameRow(index, -1, fired + 10**6, trigger_index=index, trigger_ns=fired)
                writer.append_frame(name, counts[:, shift : shift + 160], row)
        probe_s = np.arange(-50, 450) * 0.01
        ticks = np.rint((probe_s * (1 + 20e-6) + 7) * 1e6).astype(np.int64)
        volts = 2.5 + 1.01 * files.elevation(probe_s, 0.3) / 0.05
        pulses = np.rint((np.arange(200) * 0.02 * (1 + 20e-6) + 7) * 1e6).astype(np.int64)
        for start in range(0, 500, 25):
            block = slice(start, start + 25)
            received = 10**9 + round(float(probe_s[block][-1]) * 1e9) + 10**6
            seen = pulses[(pulses >= ticks[block][0]) & (pulses <= ticks[block][-1])]
            writer.append_samples("P1", volts[block, None], ticks[block], start, received, seen)
        writer.append_event(Event(10**9 + 5 * 10**8, "left", EventKind.LATE_TRIGGER, 25, "<i>late</i>"))
        sync = {
            "clock": "virtual",
            "note": "virtual clock: skew is simulated",
            "trigger_mode": "software",
            "pairs": 200,
            "paired_by": "trigger index",
            "unpaired": {"left": 0, "right": 0},
            "skew_ns": {"p50": 0.0, "p99": 0.0, "max": 0.0},
            "skew_source": "host times at which the triggers were fired",
            "late_triggers": {"left": 1, "right": 0},
            "devices": {"left": {"received": 200, "written": 200, "lost": {"late_trigger": 1}}},
            "clocks": {"P1": None},
        }
        writer.finish({"sync": sync}, "frames")
