"""Standard uncertainties of a calibration: bootstrap over views, and the covariance of the fit beside it.

The bootstrap draws views with replacement (poses that repeat each other are drawn together, as they are no
independent evidence), fits again from the solution, and takes the spread of what matters: parameters, depth at
the working distance over the picture, elevation of the water. It needs no assumption about the errors of single
corners. The covariance of the least-squares fit, which assumes that they are independent and alike, is a check:
on simulated views, where that is true, both agree.

Depth of a point is judged in each replicate's own rectified frame, as the program reports it. Elevation is judged
as it is used: a flat, tilted water surface is triangulated with the replicate, a plane fitted to it, and points
at a crest's height are measured from that plane, so that a common shift of depth cancels as it does at the tank.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.bundle import PARAMETERS, Corners, Fit, Geometry, covariance, fit, project
from thermacq_calibration.geometry.record import StereoCalibration
from thermacq_calibration.geometry.rectification import rectify_points, rectifying_rotations
from thermacq_calibration.models import Float

WORKING_DISTANCE_M = 0.65
REPLICATES = 200
CREST_M = 0.05
"""Height above still water at which the uncertainty of elevation is stated."""
# The paper's cameras look at the water 22.8 degrees from the vertical.
_WATER_TILT_RAD = np.radians(22.8)
GRID = (16, 12)
"""Columns and rows of the map of depth uncertainty."""
# Gauss-Newton steps of a replicate: the sum of squares is close to a parabola about the solution.
_STEPS = 3
_LEAST_POINTS = 12
# Three tilted poses determine two cameras; one more keeps a replicate away from the brink.
_LEAST_POSES = 4
# Steps of the numerical derivatives for the covariance, in standard uncertainties of each parameter.
_DERIVATIVE_STEP = 0.1


@dataclass(frozen=True, eq=False)
class Scene:
    """Points at which depth and elevation are judged, as the reference geometry sees them.

    Parameters
    ----------
    flat, water, crest
        Pixels (left, right), (n, 2) each, of points at the working distance; on the tilted water; at a crest's
        height above it.
    columns, rows
        (n,) pixels of the map in the rectified left picture.
    seen
        (n,) bool: whether both cameras see the point at the working distance.
    """

    flat: tuple[Float, Float]
    water: tuple[Float, Float]
    crest: tuple[Float, Float]
    columns: Float
    rows: Float
    seen: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Frame:
    """The rectified frame of a geometry, as far as triangulation needs it."""

    calibration: StereoCalibration
    left: Float
    right: Float
    focal_px: float

    @classmethod
    def of(cls, geometry: Geometry, image_size: tuple[int, int]) -> _Frame:
        calibration = geometry.calibration(image_size)
        matrices = (calibration.left.matrix, calibration.right.matrix)
        focal = float(np.mean([(matrix[0, 0], matrix[1, 1]) for matrix in matrices]))
        return cls(calibration, *rectifying_rotations(calibration), focal)

    def points(self, pixels: tuple[Float, Float]) -> Float:
        """(n, 3) metres in the rectified left frame, of pixels in both camera pictures."""
        eye = np.eye(3)
        left = rectify_points(self.calibration.left, pixels[0], self.left, eye)
        right = rectify_points(self.calibration.right, pixels[1], self.right, eye)
        depth = self.calibration.baseline_m / (left[:, 0] - right[:, 0])
        return np.column_stack([left * depth[:, None], depth])


def bootstrap(
    found: Fit,
    corners: Corners,
    image_size: tuple[int, int],
    groups: NDArray[np.intp],
    working_distance_m: float = WORKING_DISTANCE_M,
    replicates: int = REPLICATES,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Standard uncertainties of a calibration.

    Parameters
    ----------
    found, corners
        The solution and what it was fitted to.
    image_size
        (columns, rows).
    groups
        (views,) which views show the same pose of the board; these are drawn together.
    working_distance_m
        Distance at which depth is judged.
    replicates
        How many times views are drawn.
    progress
        Told in words what happens.

    Returns
    -------
    dict
        Plain values: ``standard`` (bootstrap) and ``from_covariance``, both by quantity; ``depth_map_m`` with its
        ``columns_px`` and ``rows_px``; and how all this was found. Entries of ``depth_map_m`` are None where not
        both cameras see the point.
    """
    scene = look(found.geometry, image_size, working_distance_m)
    random = np.random.default_rng(0)
    names = np.unique(groups)
    quantities, depths, crests = [], [], []
    for index in range(replicates):
        if index % 20 == 0:
            progress(f"bootstrapping, {index} of {replicates}")
        drawn = _draw(random, names.size)
        weights = drawn[np.searchsorted(names, groups)]
        chosen = np.flatnonzero(weights)
        replicate = fit(
            found.geometry,
            found.poses.select(chosen),
            corners.select(chosen),
            found.free,
            weights[chosen].astype(float),
            _STEPS,
        )
        values, depth, crest = judge(replicate.geometry, scene, image_size)
        quantities.append(values)
        depths.append(depth)
        crests.append(crest)
    # The variance of drawing from n poses is that of n poses times (n - 1) / n.
    scale = float(np.sqrt(names.size / (names.size - 1)))
    standard = {key: scale * float(np.std([one[key] for one in quantities], ddof=1)) for key in quantities[0]}
    spread = scale * np.std(depths, axis=0, ddof=1)
    standard["depth_point_m"] = _rms(spread[scene.seen])
    standard["elevation_m"] = scale * _rms(np.std(crests, axis=0, ddof=1)[scene.seen])
    cells = [float(f"{value:.3g}") if seen else None for value, seen in zip(spread, scene.seen, strict=True)]
    columns, rows = GRID
    return {
        "method": "bootstrap over poses of the board",
        "replicates": replicates,
        "poses": int(names.size),
        "working_distance_m": working_distance_m,
        "crest_m": CREST_M,
        "standard": standard,
        "from_covariance": from_covariance(found, corners, scene, image_size),
        "columns_px": [round(float(value), 1) for value in scene.columns[:columns]],
        "rows_px": [round(float(value), 1) for value in scene.rows[::columns]],
        "depth_map_m": [cells[row * columns : (row + 1) * columns] for row in range(rows)],
    }


def from_covariance(
    found: Fit, corners: Corners, scene: Scene, image_size: tuple[int, int]
) -> dict[str, float] | None:
    """Standard uncertainties by linear propagation of the covariance of the fit; None when it has none."""
    matrix = covariance(found, corners)
    if matrix is None:
        return None
    sigma = np.sqrt(np.diag(matrix))
    places = np.flatnonzero(found.free)
    gradients: dict[str, list[float]] = {}
    for place, one in zip(places, sigma, strict=True):
        step = np.zeros(PARAMETERS)
        step[place] = _DERIVATIVE_STEP * one
        above, below = (judge(found.geometry.moved(way * step), scene, image_size)[0] for way in (1, -1))
        for key in above:
            gradients.setdefault(key, []).append((above[key] - below[key]) / (2 * step[place]))
    return {key: float(np.sqrt(np.array(by) @ matrix @ np.array(by))) for key, by in gradients.items()}


def look(geometry: Geometry, image_size: tuple[int, int], working_distance_m: float) -> Scene:
    """The points at which a geometry is judged: a grid over its rectified left picture."""
    frame = _Frame.of(geometry, image_size)
    columns, rows = (np.linspace(0, size - 1, count) for size, count in zip(image_size, GRID, strict=True))
    u, v = (axis.ravel() for axis in np.meshgrid(columns, rows))
    centre = (np.array(image_size) - 1) / 2
    rays = np.column_stack(
        [(u - centre[0]) / frame.focal_px, (v - centre[1]) / frame.focal_px, np.ones(u.size)]
    )
    # The middle of the rectified picture is about where both cameras look.
    up = np.array([0.0, np.sin(_WATER_TILT_RAD), -np.cos(_WATER_TILT_RAD)])
    water = rays * (working_distance_m * up[2] / (rays @ up))[:, None]
    flat = rays * working_distance_m
    pixels = [project(geometry, points @ frame.left) for points in (flat, water, water + CREST_M * up)]
    limits = np.array(image_size) - 1
    seen = np.all([((side >= 0) & (side <= limits)).all(axis=1) for side in pixels[0]], axis=0)
    if np.count_nonzero(seen) < _LEAST_POINTS:
        raise CalibrationError(
            f"the cameras see next to nothing in common at the working distance of {working_distance_m:g} m",
            remedy="Give the distance from the cameras to the water with --working-distance-m.",
        )
    return Scene(pixels[0], pixels[1], pixels[2], u, v, seen)


def judge(
    geometry: Geometry, scene: Scene, image_size: tuple[int, int]
) -> tuple[dict[str, float], Float, Float]:
    """What a geometry makes of the scene.

    Returns
    -------
    values : dict
        Parameters in plain units, and the mean depth of the points at the working distance.
    depth_m : numpy.ndarray
        (n,) depth of these points.
    elevation_m : numpy.ndarray
        (n,) elevation of the crest's points above the fitted water.
    """
    from scipy.spatial.transform import Rotation

    frame = _Frame.of(geometry, image_size)
    depth = frame.points(scene.flat)[:, 2]
    angles = np.degrees(Rotation.from_matrix(geometry.rotation).as_rotvec())
    values = {"baseline_m": float(np.linalg.norm(geometry.translation_m))}
    for side, camera in (("left", geometry.left), ("right", geometry.right)):
        for name, value in zip(("fx_px", "fy_px", "cx_px", "cy_px"), camera[:4], strict=True):
            values[f"{side}_{name}"] = float(value)
    values |= {f"rotation_{axis}_deg": float(angle) for axis, angle in zip("xyz", angles, strict=True)}
    values["depth_m"] = float(depth[scene.seen].mean())
    water, crest = frame.points(scene.water), frame.points(scene.crest)
    middle = water[scene.seen].mean(axis=0)
    normal = np.linalg.eigh(np.cov(water[scene.seen].T))[1][:, 0]
    return values, depth, (crest - middle) @ (normal if normal[2] < 0 else -normal)


def _draw(random: np.random.Generator, poses: int) -> NDArray[np.intp]:
    """(poses,) how often each pose is drawn; too few different ones, which determine nothing, are drawn again."""
    while True:
        drawn = np.bincount(random.integers(poses, size=poses), minlength=poses)
        if np.count_nonzero(drawn) >= _LEAST_POSES:
            return drawn


def _rms(values: Sequence[float] | Float) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
