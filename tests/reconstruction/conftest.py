"""Synthetic truth: textured surfaces seen by a rectified pair in the paper's geometry, as arrays and as a run file.

The right picture is rendered by solving ``u - d(u, v) = u_right`` on every pixel, so that the disparity of
the left picture is known exactly; the texture is a cubic spline through a random field.
"""

from __future__ import annotations

import dataclasses
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from thermacq.rig import Rig
from thermacq.store import CameraStream, FrameRow, RunHeader, RunWriter
from thermacq_calibration import StereoCalibration

COUNTS_PER_K = 100.0
FRAME_NS = 20_000_000


@dataclass(frozen=True)
class Scene:
    """A rectified pair above water; lengths in metres. World: x up the picture, camera above (0, 0)."""

    rows: int = 256
    columns: int = 320
    focal_px: float = 352.95
    baseline_m: float = 0.06
    height_m: float = 0.6
    tilt_deg: float = 22.8
    texture_k: float = 0.3
    noise_k: float = 0.035
    correlation_px: float = 1.5
    shading_k: float = 0.0
    gain_right: float = 1.0
    elevation: Callable[[Any, Any, float], Any] = field(default=lambda x, y, t: 0.0 * x)

    @property
    def centre(self) -> tuple[float, float]:
        return (self.columns - 1) / 2, (self.rows - 1) / 2

    @property
    def rotation(self) -> np.ndarray:
        """Camera to world: X along the picture's up, Y to its left, Z up."""
        tilt = np.radians(self.tilt_deg)
        up = np.array([0.0, -np.sin(tilt), -np.cos(tilt)])
        ahead = np.array([0.0, -np.cos(tilt), np.sin(tilt)])
        return np.stack([ahead, np.cross(up, ahead), up])

    def calibration(self) -> StereoCalibration:
        made = StereoCalibration.from_rectified(
            (self.columns, self.rows), self.focal_px, self.centre, self.baseline_m
        )
        # The same rig has the same record: its hash covers the time at which it was made.
        return dataclasses.replace(made, created="2026-01-02T03:04:05+00:00")

    def disparity(self, u: np.ndarray, v: np.ndarray, time_s: float = 0.0) -> np.ndarray:
        """Rays intersected with the surface by fixed-point iteration."""
        rays = (
            np.stack(
                [(u - self.centre[0]) / self.focal_px, (v - self.centre[1]) / self.focal_px, np.ones_like(u)],
                axis=-1,
            )
            @ self.rotation.T
        )
        z = self.height_m / -rays[..., 2]
        for _ in range(10):
            eta = self.elevation(z * rays[..., 0], z * rays[..., 1], time_s)
            z = (self.height_m - eta) / -rays[..., 2]
        return self.baseline_m * self.focal_px / z

    def pair(self, time_s: float = 0.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Left and right picture (float64, counts) and the disparity of the left one."""
        rng = np.random.default_rng(seed)
        margin, fine = 120, 2
        size = ((self.rows + 2 * margin) * fine, (self.columns + 2 * margin) * fine)
        texture = ndimage.gaussian_filter(rng.standard_normal(size), self.correlation_px * fine, mode="wrap")
        texture *= self.texture_k / texture.std()
        spline = ndimage.spline_filter(texture, order=3, mode="grid-wrap")

        def look(u: np.ndarray, v: np.ndarray) -> np.ndarray:
            place = [(v + margin) * fine, (u + margin) * fine]
            return ndimage.map_coordinates(spline, place, order=3, prefilter=False, mode="grid-wrap")

        v, u = np.mgrid[: self.rows, : self.columns].astype(float)
        disparity = self.disparity(u, v, time_s)
        seen = u + disparity
        for _ in range(6):
            seen = u + self.disparity(seen, v, time_s)
        left, right = look(u, v), self.gain_right * look(seen, v)
        x, y = u / self.columns - 0.5, v / self.rows - 0.5
        left += self.noise_k * rng.standard_normal(left.shape) + self.shading_k * (x * x + y)
        right += self.noise_k * rng.standard_normal(left.shape) + self.shading_k * (y * y - x)
        return 3000 + COUNTS_PER_K * left, 3000 + COUNTS_PER_K * right, disparity


@dataclass(frozen=True)
class RigTables:
    """What a synthetic run says about its rig beside the cameras."""

    reconstruction: dict[str, Any] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)


def write_run(
    path: Path,
    scene: Scene,
    frames: int,
    *,
    tables: RigTables = RigTables(),
    calibration: bool = True,
    lonely_right: bool = False,
) -> Path:
    """Write a run file of a synthetic scene, one new texture for each frame."""
    names = ("left", "right")
    rig = Rig.model_validate(
        {
            "cameras": {name: {"driver": "test-pattern"} for name in names},
            "reconstruction": tables.reconstruction,
            "world": tables.world,
        }
    )
    header = RunHeader(
        run_id=str(uuid.uuid5(uuid.NAMESPACE_URL, path.name)),
        title="synthetic",
        start_time="2026-01-02T03:04:05+00:00",
        wall_anchor_ns=1_767_323_045_000_000_000,
        host_anchor_ns=1_000,
        clock="virtual",
        simulated=True,
        rig=rig.model_dump(mode="json"),
        calibration=scene.calibration().to_dict() if calibration else None,
        versions={},
    )
    cameras = [CameraStream(name=name, rows=scene.rows, columns=scene.columns) for name in names]
    with RunWriter.create(path, header, cameras) as writer:
        _write_frames(writer, scene, frames, header.host_anchor_ns, lonely_right)
        writer.finish({}, "done")
    return path


def _write_frames(writer: RunWriter, scene: Scene, frames: int, start_ns: int, lonely_right: bool) -> None:
    names = ("left", "right")
    for index in range(frames):
        moment_ns = start_ns + index * FRAME_NS
        left, right, _ = scene.pair(index * FRAME_NS / 1e9, seed=100 + index)
        for name, picture in zip(names, (left, right), strict=True):
            trigger = index + 1000 if lonely_right and name == "right" else index
            row = FrameRow(
                counter=index, ticks=-1, host_ns=moment_ns, trigger_index=trigger, trigger_ns=moment_ns
            )
            writer.append_frame(name, np.rint(picture).astype(np.uint16), row)


@pytest.fixture
def scene() -> type[Scene]:
    return Scene


@pytest.fixture
def rig_tables() -> type[RigTables]:
    return RigTables


@pytest.fixture
def make_run() -> Callable[..., Path]:
    return write_run


@pytest.fixture(scope="session")
def still_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Still water, 10 pairs."""
    return write_run(tmp_path_factory.mktemp("still") / "still.h5", Scene(), 10)


def standing_wave(x: Any, y: Any, time_s: float) -> Any:
    """Amplitude 10 mm, wavelength 0.4 m along x, period 0.4 s."""
    return 0.010 * np.cos(2 * np.pi * x / 0.4) * np.cos(2 * np.pi * time_s / 0.4) + 0.0 * y


@pytest.fixture(scope="session")
def wave_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A standing wave over one period, 20 pairs."""
    path = tmp_path_factory.mktemp("wave") / "wave.h5"
    return write_run(path, Scene(elevation=standing_wave), 20)


@pytest.fixture
def wave() -> Callable[..., Any]:
    return standing_wave
