"""A scene and the view that one camera has of it: apparent temperature as a pure function of time."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.chessboard import BoardPose, ChessboardPictures, board_pose
from thermacq_drivers.simflume.mounting import Mounting, build_camera, nominal_pair
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.projection import PixelGrid, check_view, intersect
from thermacq_drivers.simflume.regular_wave import solve_wave
from thermacq_drivers.simflume.settings import RegularSurface, SceneSettings
from thermacq_drivers.simflume.surfaces import Floats, StillWater, Surface
from thermacq_drivers.simflume.texture import ThermalTexture, grid_place


def build_surface(settings: SceneSettings) -> Surface:
    """The water of a scene."""
    if isinstance(settings.surface, RegularSurface):
        period_s, steepness = settings.surface.wave
        return solve_wave(period_s, steepness, settings.depth_m, math.radians(settings.surface.phase_deg))
    return StillWater()


class View(Protocol):
    """What one camera sees."""

    def temperature(self, time_s: float, index: int) -> NDArray[np.float32]:
        """Apparent temperature before optics and sensor.

        Parameters
        ----------
        time_s
            Time of the scene at the exposure.
        index
            Number of the exposure, by which a chessboard is held.

        Returns
        -------
        numpy.ndarray
            (rows, columns) float32, kelvin; a new array.
        """
        ...


class WaterView:
    """The water with its thermal texture, seen by one camera.

    Parameters
    ----------
    settings
        The scene.
    camera
        The camera.

    Raises
    ------
    ValueError
        The camera cannot look at this water (see `projection.check_view`).
    """

    def __init__(self, settings: SceneSettings, camera: PinholeCamera) -> None:
        self._surface = build_surface(settings)
        check_view(camera, self._surface)
        self._camera = camera
        self._grid = PixelGrid(camera.rows, camera.columns)
        self._rays = camera.rays(self._grid.nodes_px)
        self._texture = ThermalTexture(settings.texture, settings.seed)
        self._mean_k = np.float32(settings.water_temperature_k)

    def temperature(self, time_s: float, index: int) -> NDArray[np.float32]:  # noqa: ARG002 (of the protocol)
        """Apparent temperature; see `View.temperature`."""
        points = water_points(self._surface, self._camera, self._rays, time_s)
        label_x, label_y = self._surface.label(points[..., 0], points[..., 1], time_s)
        rows, columns = (self._grid.spread_single(grid_place(label)) for label in (label_x, label_y))
        seen = self._texture.sample(rows, columns, time_s)
        seen += self._mean_k
        return seen


class BoardView:
    """The heated chessboard, held still for some exposures in each pose.

    Parameters
    ----------
    settings
        The scene.
    camera
        The camera.
    mounting
        Its mounting, from which the poses follow.
    """

    def __init__(self, settings: SceneSettings, camera: PinholeCamera, mounting: Mounting) -> None:
        self._settings = settings
        self._pair = nominal_pair(mounting)
        self._pictures = ChessboardPictures(settings.chessboard, camera, settings.water_temperature_k)
        self._view = -1
        self._picture = np.empty((0, 0), np.float32)

    def temperature(self, time_s: float, index: int) -> NDArray[np.float32]:  # noqa: ARG002 (of the protocol)
        """Apparent temperature; see `View.temperature`."""
        view = index // self._settings.chessboard.frames_per_view
        if view != self._view:
            self._picture = self._pictures.temperature(self.pose(view))
            self._view = view
        return self._picture.copy()

    def pose(self, view: int) -> BoardPose:
        """Pose in which the board is held for one view."""
        return board_pose(self._settings.chessboard, self._settings.seed, view, self._pair)


def check_scene(settings: SceneSettings, mounting: Mounting) -> None:
    """Refuse a camera that cannot see the scene from where it stands; raises `ValueError`."""
    if settings.view == "chessboard":
        board_pose(settings.chessboard, settings.seed, 0, nominal_pair(mounting))
    else:
        check_view(build_camera(mounting), build_surface(settings))


def build_view(settings: SceneSettings, mounting: Mounting) -> View:
    """What a camera with this mounting sees of the scene; raises `ValueError` when it cannot see it."""
    camera = build_camera(mounting)
    if settings.view == "chessboard":
        return BoardView(settings, camera, mounting)
    return WaterView(settings, camera)


def water_points(surface: Surface, camera: PinholeCamera, rays: Floats, time_s: float) -> Floats:
    """Points (..., 3) in flume coordinates at which rays (..., 3) meet the water, metres."""
    depth = intersect(surface, camera, rays, time_s)
    points: Floats = camera.centre_m + depth[..., None] * rays
    return points
