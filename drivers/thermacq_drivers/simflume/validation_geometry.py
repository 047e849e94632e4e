"""Checks of what the simulated cameras see, and where: projection, rays, correspondence and occlusion."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion, map_coordinates, spline_filter

from thermacq_drivers.simflume.cases import TABLE_II
from thermacq_drivers.simflume.correspondence import CYLINDER, Correspondence, correspondence
from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.ready_made import rig_toml, scene_summaries, scene_toml
from thermacq_drivers.simflume.scene import WaterView, build_surface
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.settings import SceneSettings, parse_scene
from thermacq_drivers.simflume.sight import CAPILLARY_LENGTH_M, Sight, build_sight
from thermacq_drivers.simflume.surfaces import Floats
from thermacq_drivers.simflume.validation_water import Check

WARP_TOLERANCE_K = 0.001
WARPED_SCENES: dict[str, dict[str, Any]] = {
    "still water": {},
    "a wave of H/λ = 2/25": {"surface": {"kind": "regular", "case": "T0.791-H2/25"}},
    "an irregular sea": {"surface": {"kind": "irregular"}},
    "a cylinder in a wave": {"surface": {"kind": "regular", "case": "T0.791-H2/25"}, "cylinder": {}},
}
_TIME_S = 0.43
_TIMES_S = (0.43, 21.7)
_STRIDE_PX = 5
_AT_ONCE = 100
# So few points that every surface sums its waves exactly instead of looking into a table.
_BORDER_PX = 6
_EDGE_PX = 4
_NEARER = 0.001
# Relative difference of depth that counts as something nearer, 0.6 mm.


def geometry_checks(scenes: Sequence[str] | None = None) -> list[Check]:
    """All checks of this module; `scenes` are those whose rays are followed, None for all with water."""
    return [
        *projection_checks(),
        *(ray_check(name) for name in scenes or water_scenes()),
        *warp_checks(),
        *occlusion_checks(),
    ]


def projection_checks() -> list[Check]:
    """Projected points of both cameras against OpenCV's projectPoints, the worst of 10 000 in view."""
    checks = []
    for side in ("left", "right"):
        camera = build_camera(Mounting.model_validate({"side": side}))
        random = generator(1, side, "validation points")
        pixels = random.uniform((0, 0), (camera.columns - 1, camera.rows - 1), (10_000, 2))
        points = camera.centre_m + random.uniform(0.3, 2.0, (10_000, 1)) * camera.rays(pixels)
        vector, _ = cv2.Rodrigues(camera.rotation)
        shift = -camera.rotation @ camera.centre_m
        known, _ = cv2.projectPoints(points, vector, shift, camera.matrix, camera.distortion)
        worst = float(np.abs(camera.project(points) - known[:, 0]).max())
        checks.append(Check(f"projection against OpenCV, {side} camera", "px", 0.0, worst, 1e-6))
    return checks


def water_scenes() -> list[str]:
    """Names of all shipped scenes that show water."""
    names = [*scene_summaries(), *TABLE_II]
    return [name for name in names if tomllib.loads(scene_toml(name)).get("view", "water") == "water"]


def ray_check(name: str) -> Check:
    """How far from its pixel the water that a pixel sees is drawn, in either picture: the worst."""
    settings = parse_scene(tomllib.loads(scene_toml(name)))
    worst = 0.0
    for left, right in sight_pairs(settings, "two-pairs" if name == "two-pairs" else "paper"):
        for sight, other in ((left, right), (right, left)):
            for time_s in _TIMES_S:
                worst = max(worst, ray_residual_px(settings, sight, other, time_s))
    return Check(f"rays meet the water, scene {name}", "px", 0.0, worst, 0.001)


def sight_pairs(settings: SceneSettings, rig: str = "paper") -> Iterator[tuple[Sight, Sight]]:
    """Left and right camera before a scene, for each pair of a ready rig."""
    surface = build_surface(settings)
    line_time_s = settings.camera.bolometer.line_time_s if settings.camera.bolometer else 0.0
    cameras = [table.get("settings", {}) for table in tomllib.loads(rig_toml(rig))["cameras"].values()]
    geometry = set(Mounting.model_fields)
    mountings = [
        Mounting.model_validate({key: value for key, value in camera.items() if key in geometry})
        for camera in cameras
    ]
    for left, right in zip(mountings[::2], mountings[1::2], strict=True):
        yield (
            build_sight(settings, surface, build_camera(left), line_time_s),
            build_sight(settings, surface, build_camera(right), line_time_s),
        )


def ray_residual_px(settings: SceneSettings, sight: Sight, other: Sight, time_s: float) -> float:
    """Largest displacement in both pictures between points that are seen and the water above or below."""
    camera = sight.camera
    depth, on_cylinder = sight.depth(time_s)
    rows, columns = np.mgrid[0 : camera.rows : _STRIDE_PX, 0 : camera.columns : _STRIDE_PX]
    on_water = ~on_cylinder[rows, columns]
    rows, columns = rows[on_water], columns[on_water]
    rays = camera.rays(np.stack([columns, rows], -1).astype(np.float64))
    points = camera.centre_m + depth[rows, columns, None] * rays
    moved = points.copy()
    moved[:, 2] = _water_level(settings, sight, points, rows, time_s)
    return max(
        float(np.linalg.norm(eye.project(moved) - eye.project(points), axis=1).max())
        for eye in (camera, other.camera)
    )


def _water_level(
    settings: SceneSettings, sight: Sight, points: Floats, rows: NDArray[np.int_], time_s: float
) -> Floats:
    """Elevation with meniscus at points (points, 3), each when its row is read out."""
    line_time_s = settings.camera.bolometer.line_time_s if settings.camera.bolometer else 0.0
    level = np.empty(len(points))
    for start in range(0, len(points), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        read_s = np.asarray(time_s + line_time_s * rows[part], np.float64) if line_time_s else time_s
        level[part] = sight.surface.elevation(points[part, 0], points[part, 1], read_s)
    if settings.cylinder is not None:
        cylinder = settings.cylinder
        radius = np.hypot(points[:, 0] - cylinder.x_m, points[:, 1] - cylinder.y_m)
        beyond = np.maximum(radius - cylinder.radius_m, 0.0)
        level += cylinder.meniscus_m * np.exp(-beyond / CAPILLARY_LENGTH_M)
    return level


def warp_checks() -> list[Check]:
    """Left noise-free picture minus the right one warped by the true disparity, its standard deviation.

    It must stay far below the NETD of 35 mK; 0.1 px of disparity make 6 mK. Lamps and surroundings are left out: what the water mirrors is
    not the same in both pictures.
    """
    return [
        Check(f"warped by the true disparity, {name}", "K", 0.0, deviation, WARP_TOLERANCE_K)
        for name, scene in WARPED_SCENES.items()
        for deviation in warped_deviations(scene)
    ]


def warped_deviations(scene: dict[str, Any], shifts_px: Sequence[float] = (0.0,)) -> list[float]:
    """Standard deviation in kelvin of the left minus the warped right picture, of water that both see.

    Each of `shifts_px` in turn is added to the true disparity, to show how much a wrong one matters.
    """
    settings = parse_scene(scene)
    left, right = next(sight_pairs(settings))
    seen = [WaterView(settings, sight.camera).temperature(_TIME_S, 0) for sight in (left, right)]
    truth = correspondence(left, right.camera, _TIME_S)
    edges = binary_dilation(right.depth(_TIME_S)[1], iterations=_EDGE_PX).astype(np.float64)
    compared = (
        ~truth.occluded & ~truth.outside & ~binary_dilation(truth.seen == CYLINDER, iterations=_EDGE_PX)
    )
    compared &= map_coordinates(edges, [truth.row_px, truth.column_px], order=1) == 0
    compared &= _inside(truth.row_px, truth.column_px, left)
    rows, columns = np.mgrid[0 : left.camera.rows, 0 : left.camera.columns].astype(np.float64)
    compared &= _inside(rows, columns, left)
    coefficients = spline_filter(seen[1].astype(np.float64), order=5)
    row_px, column_px = truth.row_px[compared], truth.column_px[compared]
    deviations = []
    for shift_px in shifts_px:
        warped = map_coordinates(coefficients, [row_px, column_px - shift_px], order=5, prefilter=False)
        deviations.append(float((seen[0][compared] - warped).std()))
    return deviations


def _inside(row_px: Floats, column_px: Floats, sight: Sight) -> NDArray[np.bool_]:
    """Whether places lie well within the picture."""
    last_row, last_column = sight.camera.rows - 1 - _BORDER_PX, sight.camera.columns - 1 - _BORDER_PX
    within: NDArray[np.bool_] = (row_px > _BORDER_PX) & (row_px < last_row)
    return within & (column_px > _BORDER_PX) & (column_px < last_column)


def occlusion_checks() -> list[Check]:
    """Left and right truth of the cylinder scenes against each other, for both pairs of cameras."""
    settings = parse_scene(tomllib.loads(scene_toml("two-pairs")))
    checks = []
    for pair, (left, right) in zip(
        ("upstream", "downstream"), sight_pairs(settings, "two-pairs"), strict=True
    ):
        there = correspondence(left, right.camera, _TIME_S)
        back = correspondence(right, left.camera, _TIME_S)
        returns, hidden = left_and_right(there, back, left, right)
        checks.append(Check(f"left to right and back, 99 %, {pair} pair", "px", 0.0, returns, 0.01))
        checks.append(Check(f"occlusion not as depths say, {pair} pair", "%", 0.0, hidden, 0.5))
    return checks


def left_and_right(
    there: Correspondence, back: Correspondence, left: Sight, right: Sight
) -> tuple[float, float]:
    """How well the correspondence of both cameras agrees.

    Returns
    -------
    float
        99 % quantile of the distance, in columns, between a pixel of the left picture and the place to
        which its correspondence in the right one leads back, of pixels that both see.
    float
        Pixels in both fields of view that are marked occluded although the right picture shows nothing
        nearer there, or the reverse; in per cent of the occluded ones. Places within a pixel of the
        cylinder's outline in the right picture are left out, as depths cannot be interpolated there.
    """
    shown = back.seen == CYLINDER
    outline = (binary_dilation(shown) & ~binary_erosion(shown)).astype(np.float64)
    inside = _inside(there.row_px, there.column_px, left) & ~there.outside
    inside &= map_coordinates(outline, [there.row_px, there.column_px], order=1) == 0
    rows, columns = np.nonzero(inside)
    place = [there.row_px[inside], there.column_px[inside]]
    occluded = there.occluded[inside]
    returned = map_coordinates(back.column_px, place, order=1)
    returns = float(np.quantile(np.abs(returned - columns)[~occluded], 0.99))
    rays = left.camera.rays(np.stack([columns, rows], -1).astype(np.float64))
    points = left.camera.centre_m + there.depth_m[inside][:, None] * rays
    depth = (points - right.camera.centre_m) @ right.camera.rotation[2]
    nearest = map_coordinates(back.depth_m, place, order=1)
    nearer = nearest < depth * (1 - _NEARER)
    return returns, 100 * float(np.sum(nearer != occluded) / max(np.sum(occluded), 1))
