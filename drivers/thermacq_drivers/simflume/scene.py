"""A scene and the view that one camera has of it: apparent temperature as a pure function of time."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.board_settings import UniformSettings
from thermacq_drivers.simflume.chessboard import BoardPose, ChessboardPictures, board_pose, hand_shake
from thermacq_drivers.simflume.mounting import Mounting, build_camera, nominal_pair
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.projection import check_view, row_delay_s
from thermacq_drivers.simflume.settings import SceneSettings
from thermacq_drivers.simflume.sight import Water, build_sight, cylinder_share
from thermacq_drivers.simflume.skin import Skin
from thermacq_drivers.simflume.solids import check_cylinder
from thermacq_drivers.simflume.surfaces import Surface
from thermacq_drivers.simflume.water import build_water


def build_surface(settings: SceneSettings) -> Surface:
    """The water of a scene."""
    return build_water(settings)


class View(Protocol):
    """What one camera sees."""

    def temperature(self, time_s: float, index: int) -> NDArray[np.float32]:
        """Apparent temperature before optics and sensor.

        Parameters
        ----------
        time_s
            Time of the scene when the first row is read out.
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
    line_time_s
        From the read-out of one row to that of the next.

    Raises
    ------
    ValueError
        The camera cannot look at this water (see `projection.check_view`).
    """

    def __init__(self, settings: SceneSettings, camera: PinholeCamera, line_time_s: float = 0.0) -> None:
        surface = build_surface(settings)
        check_view(camera, surface)
        self._sight = build_sight(settings, surface, camera, line_time_s)
        self._skin = Skin(settings, self._sight.surface)
        self._mean_k = np.float32(settings.water_temperature_k)

    def temperature(self, time_s: float, index: int) -> NDArray[np.float32]:  # noqa: ARG002 (of the protocol)
        """Apparent temperature; see `View.temperature`."""
        sight = self._sight
        water, read_s = sight.water(time_s), sight.read_s(time_s)
        labels = sight.surface.label(water.points_m[..., 0], water.points_m[..., 1], read_s)
        seen = self._skin.picture(sight, water, labels, time_s, read_s)
        self._draw_cylinder(seen, water, time_s)
        seen += self._mean_k
        return seen

    def _draw_cylinder(self, seen: NDArray[np.float32], water: Water, time_s: float) -> None:
        """Draw the ring of water around the cylinder, and over it the cylinder where it is nearer."""
        sight, picture, front = self._sight, self._sight.picture, self._sight.front(water, time_s)
        if picture is None or front is None:
            return
        ring, read_s = front.ring_water, front.ring_read_s
        labels = sight.surface.label(ring.points_m[:, 0], ring.points_m[:, 1], read_s)
        part = seen[picture.rows, picture.columns]
        part[front.ring] = self._skin.places(ring, picture.rays[front.ring], labels, time_s, read_s)
        part += cylinder_share(picture, front) * (picture.rise_k - part)


class UniformView:
    """A blackbody that fills the picture of a camera."""

    def __init__(self, settings: UniformSettings, camera: PinholeCamera) -> None:
        self._settings = settings
        self._shape = camera.rows, camera.columns

    def temperature(self, time_s: float, index: int) -> NDArray[np.float32]:  # noqa: ARG002 (of the protocol)
        """Apparent temperature; see `View.temperature`."""
        levels = self._settings.temperatures_k
        level = min(index // self._settings.frames_per_temperature, len(levels) - 1)
        return np.full(self._shape, levels[level], np.float32)


class BoardView:
    """The heated chessboard, held in one pose after the other.

    Parameters
    ----------
    settings
        The scene.
    camera
        The camera.
    mounting
        Its mounting, from which the poses follow.
    line_time_s
        From the read-out of one row to that of the next.
    """

    def __init__(
        self, settings: SceneSettings, camera: PinholeCamera, mounting: Mounting, line_time_s: float = 0.0
    ) -> None:
        self._settings = settings
        self._pair = nominal_pair(mounting)
        self._pictures = ChessboardPictures(settings.chessboard, camera, settings.water_temperature_k)
        self._delay_s = row_delay_s(self._pictures.grid.nodes_px, line_time_s)
        self._view = -1
        self._picture = np.empty((0, 0), np.float32)

    def temperature(self, time_s: float, index: int) -> NDArray[np.float32]:
        """Apparent temperature; see `View.temperature`."""
        board, seed = self._settings.chessboard, self._settings.seed
        view = index // board.frames_per_view
        if board.shake_m > 0:
            moved_m = hand_shake(board, seed, view, time_s + self._delay_s)
            return self._pictures.temperature(self.pose(view), moved_m)
        if view != self._view:
            self._picture = self._pictures.temperature(self.pose(view))
            self._view = view
        return self._picture.copy()

    def pose(self, view: int) -> BoardPose:
        """Pose in which the board is held for one view; a shaking hand moves about it."""
        return board_pose(self._settings.chessboard, self._settings.seed, view, self._pair)


def check_scene(settings: SceneSettings, mounting: Mounting) -> None:
    """Refuse a camera that cannot see the scene from where it stands; raises `ValueError`."""
    if settings.view == "chessboard":
        board_pose(settings.chessboard, settings.seed, 0, nominal_pair(mounting))
    elif settings.view == "water":
        camera = build_camera(mounting)
        check_view(camera, build_surface(settings))
        if settings.cylinder is not None:
            check_cylinder(settings.cylinder, camera)


def build_view(settings: SceneSettings, mounting: Mounting, line_time_s: float = 0.0) -> View:
    """What a camera with this mounting sees of the scene; raises `ValueError` when it cannot see it."""
    camera = build_camera(mounting)
    if settings.view == "uniform":
        return UniformView(settings.uniform, camera)
    if settings.view == "chessboard":
        return BoardView(settings, camera, mounting, line_time_s)
    return WaterView(settings, camera, line_time_s)
