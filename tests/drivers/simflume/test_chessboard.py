from __future__ import annotations

import cv2
import numpy as np
import pytest

from thermacq_drivers.simflume.board_settings import ChessboardSettings
from thermacq_drivers.simflume.chessboard import (
    ChessboardPictures,
    board_pose,
    corner_grid,
    hand_shake,
    true_corners,
)
from thermacq_drivers.simflume.mounting import Mounting, build_camera, nominal_pair
from thermacq_drivers.simflume.scene import BoardView
from thermacq_drivers.simflume.sensor import Sensor
from thermacq_drivers.simflume.sensor_settings import SensorSettings
from thermacq_drivers.simflume.settings import parse_scene

BOARD = ChessboardSettings()
PAIR = nominal_pair(Mounting())


def stretched(picture: np.ndarray) -> np.ndarray:
    low, high = np.percentile(picture, (1, 99))
    return np.clip((picture - low) / (high - low) * 255, 0, 255).astype(np.uint8)


def test_opencv_finds_the_corners_where_they_are() -> None:
    errors = []
    for side in ("left", "right"):
        camera = build_camera(Mounting(side=side))
        sensor = Sensor(SensorSettings(), 512, 640, 1, side)
        pictures = ChessboardPictures(BOARD, camera, ambient_k=295.0)
        for view in range(5):
            pose = board_pose(BOARD, 1, view, PAIR)
            seen = np.empty((512, 640), np.uint16)
            sensor.expose(pictures.temperature(pose), view, seen)
            found, corners = cv2.findChessboardCornersSB(stretched(seen.astype(float)), (9, 6), flags=0)
            assert found, f"view {view} of the {side} camera"
            errors.append(corners.reshape(-1, 2) - true_corners(BOARD, pose, camera))
    distances = np.linalg.norm(np.concatenate(errors), axis=-1)
    assert np.median(distances) < 0.1
    assert np.abs(np.concatenate(errors).mean(axis=0)).max() < 0.03


def test_poses_vary_and_fill_the_pictures_of_both_cameras() -> None:
    cells, tilts, distances = set(), [], []
    for view in range(40):
        pose = board_pose(BOARD, 1, view, PAIR)
        tilts.append(np.degrees(np.arccos(abs(pose.rotation[:, 2] @ PAIR[0].rotation[2]))))
        middle = pose.rotation @ corner_grid(BOARD).mean(axis=0) + pose.origin_m
        distances.append((middle - PAIR[0].centre_m) @ PAIR[0].rotation[2])
        for camera in PAIR:
            corners = true_corners(BOARD, pose, camera)
            assert corners.min() > 0
            assert (corners < (639, 511)).all()
            cells |= {(int(row // (512 / 6)), int(column // 80)) for column, row in corners}
    assert max(tilts) <= 40
    assert sum(tilt > 25 for tilt in tilts) >= 20
    # Nearer than this, a board of half a metre does not fit into both pictures.
    assert 0.45 <= min(distances) < 0.7
    assert 0.8 < max(distances) <= 0.9
    assert len(cells) >= 0.95 * 48


def test_a_pose_depends_on_seed_and_view_only() -> None:
    first = board_pose(BOARD, 1, 3, PAIR)
    np.testing.assert_array_equal(board_pose(BOARD, 1, 3, PAIR).origin_m, first.origin_m)
    assert np.abs(board_pose(BOARD, 1, 4, PAIR).origin_m - first.origin_m).max() > 0.001
    assert np.abs(board_pose(BOARD, 2, 3, PAIR).origin_m - first.origin_m).max() > 0.001


def test_the_board_is_held_still_for_the_frames_of_a_view() -> None:
    mounting = Mounting(rows=128, columns=160, pixel_pitch_um=68)
    scene = parse_scene({"view": "chessboard", "chessboard": {"frames_per_view": 3}})
    view = BoardView(scene, build_camera(mounting), mounting)
    frames = [view.temperature(index * 0.02, index) for index in range(6)]
    np.testing.assert_array_equal(frames[0], frames[2])
    np.testing.assert_array_equal(frames[3], frames[5])
    assert np.abs(frames[2] - frames[3]).max() > 5


def test_contrast_is_as_asked_and_edges_are_soft() -> None:
    mounting = Mounting(rows=128, columns=160, pixel_pitch_um=68)
    pictures = ChessboardPictures(BOARD, build_camera(mounting), ambient_k=290.0)
    seen = pictures.temperature(board_pose(BOARD, 1, 0, nominal_pair(mounting)))
    assert seen.min() == 290.0
    assert seen.max() == 296.0
    assert ((seen > 290.5) & (seen < 295.5)).mean() > 0.01


def test_a_board_that_never_fits_is_an_error() -> None:
    huge = ChessboardSettings(square_m=0.3)
    with pytest.raises(ValueError, match="does not fit"):
        board_pose(huge, 1, 0, PAIR)


@pytest.mark.parametrize(
    "board", [ChessboardSettings(bow_m=0.01), ChessboardSettings(bow_m=-0.006, true_square_m=0.045)]
)
def test_corners_of_a_bent_board_are_found_where_they_are(board: ChessboardSettings) -> None:
    camera = build_camera(Mounting())
    pictures = ChessboardPictures(board, camera, ambient_k=295.0)
    for view in (1, 3):
        pose = board_pose(board, 1, view, PAIR)
        found, corners = cv2.findChessboardCornersSB(stretched(pictures.temperature(pose)), (9, 6), flags=0)
        assert found
        errors = corners.reshape(-1, 2) - true_corners(board, pose, camera)
        assert np.median(np.linalg.norm(errors, axis=-1)) < 0.1
        flat = board.model_copy(update={"bow_m": 0.0})
        moved = true_corners(flat, pose, camera) - true_corners(board, pose, camera)
        assert np.abs(moved).max() > 1.0


def test_bending_and_wrong_squares_are_as_stated() -> None:
    corners = corner_grid(ChessboardSettings(bow_m=0.01, true_square_m=0.051)).reshape(6, 9, 3)
    np.testing.assert_allclose(np.diff(corners[..., 0], axis=1), 0.051)
    np.testing.assert_allclose(corners[:, 4, 2], -0.01)
    # The ends of the squares, one square beyond the outer corners, stay in the plane.
    np.testing.assert_allclose(corners[:, 0, 2], -0.01 * (1 - (4 / 5) ** 2))


def test_bad_sets_of_poses_are_bad_in_their_way() -> None:
    def poses(**changes: object) -> list[np.ndarray]:
        board = ChessboardSettings.model_validate(changes)
        return [true_corners(board, board_pose(board, 1, view, PAIR), PAIR[0]) for view in range(12)]

    frontal = ChessboardSettings(poses="frontal")
    for view in range(12):
        pose = board_pose(frontal, 1, view, PAIR)
        assert pose.rotation[:, 2] @ PAIR[0].rotation[2] > np.cos(np.radians(4.01))
    few = poses(views=3)
    np.testing.assert_array_equal(few[0], few[9])
    assert np.abs(few[0] - few[1]).max() > 5
    middles = np.array(
        [corners.mean(axis=0) for corners in poses(poses="corner", nearest_m=1.1, farthest_m=1.4)]
    )
    assert (middles < (320, 256)).all()


def test_contrast_of_a_heated_board_follows_from_its_emissivities() -> None:
    mounting = Mounting(rows=128, columns=160, pixel_pitch_um=68)
    board = ChessboardSettings(board_temperature_k=310.0, emissivities=(0.9, 0.2))
    seen = ChessboardPictures(board, build_camera(mounting), 295.0).temperature(
        board_pose(board, 1, 0, nominal_pair(mounting))
    )
    levels = np.sort(seen.ravel())
    radiance = (0.9 * 310**4.8 + 0.1 * 295**4.8) ** (1 / 4.8)
    assert levels[-100] == pytest.approx(radiance, abs=1e-3)
    metal = (0.2 * 310**4.8 + 0.8 * 295**4.8) ** (1 / 4.8)
    assert (np.abs(seen - metal) < 1e-3).mean() > 0.1
    assert levels[0] == 295.0


def test_a_shaking_hand_moves_the_board_by_its_amplitude() -> None:
    board = ChessboardSettings(shake_m=0.02, shake_hz=2.0)
    moved = hand_shake(board, 1, 0, np.linspace(0, 1, 401))
    assert np.linalg.norm(moved, axis=-1).max() == pytest.approx(0.02, rel=1e-3)
    np.testing.assert_allclose(moved[0], moved[200], atol=1e-12)
    rest, moving = (
        BoardView(
            parse_scene({"view": "chessboard", "chessboard": table}), build_camera(Mounting()), Mounting()
        )
        for table in ({}, {"shake_m": 0.02})
    )
    np.testing.assert_array_equal(rest.temperature(0.0, 0), rest.temperature(0.1, 0))
    assert np.abs(moving.temperature(0.0, 0) - moving.temperature(0.1, 0)).max() > 5
