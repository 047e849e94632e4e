"""How fast the simulated flume draws, on one core: stereo pairs of waves, still water, chessboards.

The baseline of a drawn frame is one plain ``cv2.remap`` (linear, float32) of a picture of the same size,
about the least that any renderer with a texture must do.
"""

from __future__ import annotations

import statistics
import time
import tomllib
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from thermacq_drivers.simflume.bolometer import lagged_temperature
from thermacq_drivers.simflume.camera import CameraSettings, in_condition
from thermacq_drivers.simflume.lens import build_lens
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.projection import PixelGrid, intersect
from thermacq_drivers.simflume.ready_made import scene_toml
from thermacq_drivers.simflume.scene import View, build_surface, build_view
from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import SensorSettings
from thermacq_drivers.simflume.settings import parse_scene

ROWS, COLUMNS = 512, 640
REPEATS = 40
BASELINE = "one cv2.remap of a frame"
WAVE = {"surface": {"kind": "regular", "case": "T0.791-H2/25"}}


def run() -> list[dict[str, Any]]:
    """Rows of the benchmark."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return _run()
    finally:
        cv2.setNumThreads(threads)


def _run() -> list[dict[str, Any]]:
    remap_s = _median_s(_plain_remap())
    rows = [{"name": BASELINE, "value": remap_s * 1e3, "unit": "ms"}]
    for name, scene in (("wave", WAVE), ("still water", {})):
        view = build_view(parse_scene(scene), Mounting())
        drawn_s = _median_s(lambda view=view: view.temperature(0.3, 0))
        exposed_s = _median_s(_exposure(view))
        rows.append(_row(f"{name}: apparent temperature of a frame", drawn_s, remap_s))
        rows.append(_row(f"{name}: frame with optics, noise and counts", exposed_s, remap_s))
        rows.append({"name": f"{name}: stereo pairs per core", "value": 0.5 / exposed_s, "unit": "1/s"})
    raw_s = _raw_frame_s()
    rows.append(_row("wave: frame of a raw camera with all its physics", raw_s, remap_s))
    rows.append({"name": "wave: stereo pairs of raw cameras per core", "value": 0.5 / raw_s, "unit": "1/s"})
    rows.append(_row("wave: rays met with the water, all pixels", _median_s(_intersection()), remap_s))
    board = build_view(parse_scene({"view": "chessboard", "chessboard": {"frames_per_view": 1}}), Mounting())
    numbers = iter(range(REPEATS + 1))
    rows.append(
        _row("chessboard: one pose", _median_s(lambda: board.temperature(0.0, next(numbers))), remap_s)
    )
    return rows


def _row(name: str, seconds: float, remap_s: float) -> dict[str, Any]:
    return {
        "name": name,
        "value": seconds * 1e3,
        "unit": "ms",
        "baseline": BASELINE,
        "ratio": seconds / remap_s,
    }


def _median_s(action: Callable[[], object]) -> float:
    action()
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        action()
        times.append(time.perf_counter() - begun)
    return statistics.median(times)


def _plain_remap() -> Callable[[], object]:
    picture = np.random.default_rng(1).standard_normal((ROWS, COLUMNS)).astype(np.float32)
    rows, columns = np.mgrid[:ROWS, :COLUMNS].astype(np.float32) * np.float32(0.99)
    return lambda: cv2.remap(picture, columns, rows, cv2.INTER_LINEAR)


def _exposure(view: View) -> Callable[[], object]:
    sensor = Sensor(SensorSettings(), ROWS, COLUMNS, 1, "left")
    counts = np.empty((ROWS, COLUMNS), np.uint16)
    return lambda: sensor.expose(view.temperature(0.3, 0), 0, counts)


def _raw_frame_s() -> float:
    """Mean time of successive frames at 50 Hz: some cost more, when drift and 1/f noise move on."""
    table = tomllib.loads(scene_toml("dirty-sensor"))
    scene = parse_scene({**table, **WAVE})
    camera = in_condition(CameraSettings(), scene.camera)
    view = build_view(scene, camera, camera.bolometer.line_time_s)
    lens = build_lens(camera.lens, camera, integrated=False) if camera.lens else None
    sensor = Sensor(camera.sensor, ROWS, COLUMNS, 1, "left", lens=lens, warm_up=camera.warm_up)
    counts = np.empty((ROWS, COLUMNS), np.uint16)

    def draw(frame: int) -> None:
        time_s = frame / 50
        sensor.expose(lagged_temperature(view, camera.bolometer, time_s, frame), frame, counts, time_s)

    draw(0)
    begun = time.perf_counter()
    for frame in range(1, REPEATS + 1):
        draw(frame)
    return (time.perf_counter() - begun) / REPEATS


def _intersection() -> Callable[[], object]:
    camera = build_camera(Mounting())
    surface, grid = build_surface(parse_scene(WAVE)), PixelGrid(ROWS, COLUMNS)
    rays = camera.rays(grid.nodes_px)
    return lambda: grid.spread(intersect(surface, camera, rays, 0.3))
