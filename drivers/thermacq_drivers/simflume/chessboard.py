"""The heated chessboard: where a person would hold it, where its corners are, and how it looks.

Board coordinates: origin at the first inner corner, x along a row of corners, y along a column, z away
from the cameras; metres. A bent board is a parabolic cylinder about its y axis. Poses are relative to the pair of cameras as it was meant to be mounted, so that
both cameras of a rig see the same board wherever the rig stands.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from thermacq_drivers.simflume.board_settings import ChessboardSettings
from thermacq_drivers.simflume.optics import PinholeCamera
from thermacq_drivers.simflume.projection import PixelGrid
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.surfaces import Floats

_OVERSAMPLE = 4
_MARGIN_SQUARES = 0.35
# Part of the outer squares that must be inside both pictures, so that the outer corners can be found.
_FRAME_SQUARES = 0.6
# Width of the coated rim around the squares.
_DIRECTIONS = ((0, 0), (-1, -1), (1, 1), (-1, 1), (1, -1), (0, -1), (0, 1), (-1, 0), (1, 0))
_ATTEMPTS = 200
_FRONTAL_TILT_DEG = 4.0
_BENDING_STEPS = 6
# Each step shrinks the error by the slope of the bent board times that of the ray, below 0.2.
_RADIANCE_EXPONENT = 4.8
# In-band radiance grows like this power of the temperature: c2 / (lambda T) at 10 µm and 300 K.


@dataclass(frozen=True, eq=False)
class BoardPose:
    """Pose of the board in the flume: X = rotation @ board + origin_m."""

    rotation: Floats
    origin_m: Floats


def corner_grid(settings: ChessboardSettings) -> Floats:
    """Inner corners as they really are, in board coordinates, row by row: (corners, 3) metres."""
    rows, columns = np.mgrid[: settings.rows, : settings.columns]
    flat = np.stack([columns, rows, np.zeros_like(rows)], axis=-1).reshape(-1, 3) * settings.real_square_m
    flat[:, 2] = bending(settings, flat[:, 0])
    return flat


def bending(settings: ChessboardSettings, x_m: Floats) -> Floats:
    """Board coordinate z of a bent board at x, metres: 0 at its outer squares' ends, -bow in the middle."""
    middle = (settings.columns - 1) / 2 * settings.real_square_m
    half = (settings.columns + 1) / 2 * settings.real_square_m
    depth: Floats = -settings.bow_m * (1 - ((x_m - middle) / half) ** 2)
    return depth


def true_corners(settings: ChessboardSettings, pose: BoardPose, camera: PinholeCamera) -> Floats:
    """Pictures of the inner corners: (corners, 2) pixels (column, row), in the order of `corner_grid`."""
    return camera.project(corner_grid(settings) @ pose.rotation.T + pose.origin_m)


def board_pose(
    settings: ChessboardSettings, seed: int, view: int, cameras: Sequence[PinholeCamera]
) -> BoardPose:
    """Pose of one view: in a good set, tilted, turned and held towards another part of the picture each time.

    Parameters
    ----------
    settings
        Size of the board, and the range of distances and tilts.
    seed
        Seed of the scene.
    view
        Number of the view.
    cameras
        The pair as it was meant to be mounted, left first; the board lies within both pictures.

    Raises
    ------
    ValueError
        No pose in this range shows the whole board to both cameras.
    """
    if settings.views:
        view %= settings.views
    random = generator(seed, "board pose", view)
    if settings.place_m is not None:
        return _lying_pose(settings, random, np.array(settings.place_m))
    frontal, corner = settings.poses == "frontal", settings.poses == "corner"
    direction = np.array(_DIRECTIONS[1 if corner else view % len(_DIRECTIONS)], float)
    for _ in range(_ATTEMPTS):
        turn = _held_rotation(random, _FRONTAL_TILT_DEG if frontal else settings.largest_tilt_deg)
        distance_m = (
            settings.farthest_m if frontal else random.uniform(settings.nearest_m, settings.farthest_m)
        )
        reach = random.uniform(0.0, 0.1) if frontal else random.uniform(0.7, 1.0)
        # As far towards that part of the picture as the board stays visible to both cameras.
        for fraction in np.linspace(1.0, 0.0, 21):
            offset = reach * fraction * direction * distance_m * _half_field(cameras[0])
            pose = _pose_before(cameras, settings, turn, np.append(offset, distance_m))
            if _visible(settings, pose, cameras):
                return pose
    raise ValueError("the chessboard does not fit into both pictures at any distance allowed")


def hand_shake(settings: ChessboardSettings, seed: int, view: int, time_s: Floats | float) -> Floats:
    """Movement (..., 3) of the board in flume coordinates by an unsteady hand, metres: a swing along a line."""
    random = generator(seed, "hand", view)
    direction = random.standard_normal(3)
    direction *= settings.shake_m / np.linalg.norm(direction)
    swing = np.sin(2 * np.pi * (settings.shake_hz * np.asarray(time_s) + random.uniform()))
    moved: Floats = swing[..., None] * direction
    return moved


def apparent_kelvin(emissivity: float, surface_k: float, ambient_k: float) -> float:
    """Apparent temperature of a grey surface that reflects its surroundings, kelvin."""
    power = _RADIANCE_EXPONENT
    return float((emissivity * surface_k**power + (1 - emissivity) * ambient_k**power) ** (1 / power))


def _lying_pose(settings: ChessboardSettings, random: np.random.Generator, middle_m: Floats) -> BoardPose:
    """Face up, its rows along +X and its columns along -Y, tilted at random; whoever looks at it."""
    axis_deg, tilt_deg = random.uniform(0, 360), settings.largest_tilt_deg * np.sqrt(random.uniform())
    axis = np.array([np.cos(np.radians(axis_deg)), np.sin(np.radians(axis_deg)), 0.0])
    rotation = Rotation.from_rotvec(tilt_deg * axis, degrees=True).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    return BoardPose(rotation, middle_m - rotation @ corner_grid(settings).mean(axis=0))


def _held_rotation(random: np.random.Generator, largest_tilt_deg: float) -> Floats:
    """Rotation board to left camera: a tilt about any axis in the picture, then a turn in hand."""
    axis_deg = random.uniform(0, 360)
    tilt = largest_tilt_deg * np.sqrt(random.uniform(0, 1))
    roll = float(np.clip(random.normal(0, 12), -30, 30))
    axis = np.array([np.cos(np.radians(axis_deg)), np.sin(np.radians(axis_deg)), 0.0])
    turned: Floats = (
        Rotation.from_rotvec(tilt * axis, degrees=True) * Rotation.from_euler("z", roll, degrees=True)
    ).as_matrix()
    return turned


def _half_field(camera: PinholeCamera) -> Floats:
    """Half the field of view at unit distance: (2,) across and down."""
    return np.array([camera.columns / camera.matrix[0, 0], camera.rows / camera.matrix[1, 1]]) / 2


def _pose_before(
    cameras: Sequence[PinholeCamera], settings: ChessboardSettings, turn: Floats, middle_m: Floats
) -> BoardPose:
    """Pose in the flume from the middle of the board, given relative to a point between the cameras."""
    axes = cameras[0].rotation
    between = np.mean([camera.centre_m for camera in cameras], axis=0)
    middle_of_board = corner_grid(settings).mean(axis=0)
    origin: Floats = between + axes.T @ (middle_m - turn @ middle_of_board)
    return BoardPose(axes.T @ turn, origin)


def _visible(settings: ChessboardSettings, pose: BoardPose, cameras: Sequence[PinholeCamera]) -> bool:
    wide = (-_MARGIN_SQUARES, settings.columns - 1 + _MARGIN_SQUARES)
    tall = (-_MARGIN_SQUARES, settings.rows - 1 + _MARGIN_SQUARES)
    outline = np.array([[x, y, 0.0] for x in wide for y in tall]) * settings.real_square_m
    points = outline @ pose.rotation.T + pose.origin_m
    for camera in cameras:
        if ((points - camera.centre_m) @ camera.rotation[2]).min() <= 0:
            return False
        pixels = camera.project(points)
        if pixels.min() < 0 or np.any(pixels > (camera.columns - 1, camera.rows - 1)):
            return False
    return True


class ChessboardPictures:
    """Temperature of the board and what is behind it, for one camera; keeps the picture of one pose.

    Parameters
    ----------
    settings
        The board.
    camera
        The camera that looks at it.
    ambient_k
        Temperature of the surroundings, which are also the background, kelvin.
    """

    def __init__(self, settings: ChessboardSettings, camera: PinholeCamera, ambient_k: float) -> None:
        self._settings = settings
        self._camera = camera
        self._ambient_k = ambient_k
        self._metal_k = ambient_k
        self._coating_k = ambient_k + settings.contrast_k
        if settings.board_temperature_k is not None:
            self._coating_k, self._metal_k = (
                apparent_kelvin(emissivity, settings.board_temperature_k, ambient_k)
                for emissivity in settings.emissivities
            )
        self.grid = PixelGrid(camera.rows, camera.columns, oversample=_OVERSAMPLE)
        self._rays = camera.rays(self.grid.nodes_px)

    def temperature(self, pose: BoardPose, moved_m: Floats | None = None) -> NDArray[np.float32]:
        """Apparent temperature; edges are averaged over each pixel.

        Parameters
        ----------
        pose
            Pose of the board.
        moved_m
            (3,) or (node rows, 1, 3) metres, by which it is moved when each row is read out; None: at rest.

        Returns
        -------
        numpy.ndarray
            (rows, columns) float32, kelvin.
        """
        board = self._places(pose, np.zeros(3) if moved_m is None else moved_m)
        picture = np.empty((self._camera.rows, self._camera.columns), np.float32)
        # One band of the oversampled picture at a time keeps it in the processor's cache.
        for first, x, y in self._bands(board):
            height = len(x) // _OVERSAMPLE
            seen = self._seen(x, y).reshape(height, _OVERSAMPLE, -1, _OVERSAMPLE)
            picture[first : first + height] = seen.mean(axis=(1, 3), dtype=np.float32)
        picture += np.float32(self._ambient_k)
        return picture

    def _places(self, pose: BoardPose, moved_m: Floats) -> Floats:
        """Board coordinates (x, y) that each node sees, in squares."""
        origin, normal = pose.origin_m + moved_m, pose.rotation[:, 2]
        along = self._rays @ normal
        plane = ((origin - self._camera.centre_m) @ normal) / along
        depth = np.broadcast_to(plane, along.shape)
        for _ in range(_BENDING_STEPS if self._settings.bow_m else 1):
            points = self._camera.centre_m + depth[..., None] * self._rays
            board: Floats = (points - origin) @ pose.rotation
            depth = plane + bending(self._settings, board[..., 0]) / along
        return board / self._settings.real_square_m

    def _bands(self, board: Floats) -> Iterator[tuple[int, Floats, Floats]]:
        step = 32
        for first in range(0, self._camera.rows, step):
            rows = slice(first * _OVERSAMPLE, (first + step) * _OVERSAMPLE)
            yield first, self.grid.spread(board[..., 0], rows), self.grid.spread(board[..., 1], rows)

    def _seen(self, x: Floats, y: Floats) -> NDArray[np.float32]:
        """Apparent temperature above the surroundings at places in squares."""
        columns, rows = self._settings.columns, self._settings.rows
        column, row = np.floor(x).astype(np.int32), np.floor(y).astype(np.int32)
        on_squares = (column >= -1) & (column < columns) & (row >= -1) & (row < rows)
        edge = 1 + _FRAME_SQUARES
        on_board = (x >= -edge) & (x < columns - 1 + edge) & (y >= -edge) & (y < rows - 1 + edge)
        metal = on_squares & ((column + row) % 2 == 1)
        coating_k, metal_k = (
            np.float32(kelvin - self._ambient_k) for kelvin in (self._coating_k, self._metal_k)
        )
        # The coating of high emissivity covers every other square and the rim.
        return np.where(metal, metal_k, np.where(on_board, coating_k, np.float32(0)))
