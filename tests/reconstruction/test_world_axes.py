from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.shared_board import BoardCorners
from thermacq.reconstruction.world import WorldFrame
from thermacq.reconstruction.world_axes import (
    direction_of_board,
    direction_of_marks,
    direction_of_waves,
    on_water,
    turned_frame,
)
from thermacq_calibration import Board, StereoCalibration, board_points

BOARD = Board(9, 6, 0.03)
DOWN = np.diag([1.0, -1.0, -1.0])


def frame_of(rotation=DOWN):
    return WorldFrame(
        rotation, np.array([0.1, 0.2, 0.6]), 4e-4, 1e-4, np.diag([1.0, 4.0, 9.0]), 100, 10, {"from": "still"}
    )


def waves(angle_deg, frames=60, noise_m=0.0, back=0.0, seed=0, amplitude_m=0.02):
    """A wave of 0.8 s and 1 m over half a metre, travelling in a direction; and one back."""
    x, y, t = np.arange(0, 0.5, 0.01), np.arange(0, 0.4, 0.01), np.arange(frames) * 0.05
    along = np.cos(np.radians(angle_deg)) * x[None, :] + np.sin(np.radians(angle_deg)) * y[:, None]
    phase, cycle = 2 * np.pi * along, 2 * np.pi * t[:, None, None] / 0.8
    eta = amplitude_m * (np.cos(phase - cycle) + back * np.cos(phase + cycle))
    eta = eta + noise_m * np.random.default_rng(seed).standard_normal(eta.shape)
    return xr.Dataset({"eta": (("time", "y", "x"), eta)}, {"time": t, "y": y, "x": x})


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 91.0, 180.0, -120.0])
def test_the_direction_of_waves_is_found_with_its_sign(angle_deg):
    direction = direction_of_waves(waves(angle_deg))
    off = (np.degrees(direction.angle_rad) - angle_deg + 180) % 360 - 180
    assert abs(off) < 0.1


def test_noise_of_the_surface_neither_biases_nor_exceeds_the_uncertainty():
    scores = []
    for seed in range(40):
        direction = direction_of_waves(waves(25.0, noise_m=5e-4, seed=seed))
        scores.append((direction.angle_rad - np.radians(25.0)) / direction.u_rad)
    # Central differences over a hundredth of the wavelength bend the direction by 0.01 degrees.
    assert abs(np.mean(scores)) < 0.8
    assert 0.4 < np.std(scores) < 1.3


def test_a_partial_reflection_leaves_the_direction_and_a_standing_wave_has_none():
    assert np.degrees(direction_of_waves(waves(30.0, back=0.3)).angle_rad) == pytest.approx(30.0, abs=1.0)
    with pytest.raises(ReconstructionError, match="no waves that travel"):
        direction_of_waves(waves(30.0, back=1.0, noise_m=5e-4))
    with pytest.raises(ReconstructionError, match="no waves that travel"):
        direction_of_waves(waves(30.0, amplitude_m=0.0, noise_m=5e-4))
    with pytest.raises(ReconstructionError, match="10 frames"):
        direction_of_waves(waves(30.0, frames=10))
    holes = waves(30.0)
    holes["eta"][:, ::7, ::5] = np.nan
    assert np.degrees(direction_of_waves(holes).angle_rad) == pytest.approx(30.0, abs=2.0)


def lying_board(angle_deg, lean_deg=0.0, noise_m=0.0, seed=0):
    """Corners in the camera of a board that lies on the water, rows in a direction of the world."""
    turn = Rotation.from_euler("ZY", [angle_deg, lean_deg], degrees=True).as_matrix() @ DOWN
    world = board_points(BOARD).astype(float) @ turn.T + [0.3, 0.1, 0.0]
    world = world + noise_m * np.random.default_rng(seed).standard_normal(world.shape)
    camera = (world - frame_of().translation_m) @ frame_of().rotation
    return BoardCorners(range(4), np.arange(54), camera, np.zeros((54, 3, 3)))


@settings(deadline=None, max_examples=20)
@given(angle=st.floats(-179, 179), lean=st.floats(0, 20))
def test_the_rows_of_a_board_give_the_direction(angle, lean):
    direction = direction_of_board(frame_of(), [lying_board(angle, lean)], BOARD)
    assert abs((np.degrees(direction.angle_rad) - angle + 180) % 360 - 180) < 1e-6
    turned = turned_frame(frame_of(), direction)
    rows = turned.to_world(lying_board(angle).points_m)[1] - turned.to_world(lying_board(angle).points_m)[0]
    np.testing.assert_allclose(rows, [0.03, 0, 0], atol=1e-9)


def test_the_uncertainty_of_a_board_holds():
    single, several = [], []
    for seed in range(60):
        views = [lying_board(20.0, noise_m=3e-4, seed=10 * seed + view) for view in range(5)]
        for scores, some in ((single, views[:1]), (several, views)):
            direction = direction_of_board(frame_of(), some, BOARD)
            scores.append((direction.angle_rad - np.radians(20.0)) / direction.u_rad)
    assert 0.75 < np.std(single) < 1.25
    assert 0.6 < np.std(several) < 1.25


def test_boards_that_stand_or_are_missing_are_refused():
    with pytest.raises(ReconstructionError, match="leans by 50"):
        direction_of_board(frame_of(), [lying_board(0.0, 50.0)], BOARD)
    with pytest.raises(ReconstructionError, match="no view"):
        direction_of_board(frame_of(), [], BOARD)


def test_two_marks_give_a_direction_with_its_uncertainty():
    rng, errors = np.random.default_rng(0), []
    direction = direction_of_marks([0.1, 0.1], [0.4, 0.5], 1e-3)
    assert np.tan(direction.angle_rad) == pytest.approx(4 / 3)
    for _ in range(300):
        ends = np.array([[0.1, 0.1], [0.4, 0.5]]) + 1e-3 * rng.standard_normal((2, 2))
        errors.append(direction_of_marks(*ends, 1e-3).angle_rad - direction.angle_rad)
    assert np.std(errors) == pytest.approx(direction.u_rad, rel=0.15)
    for ends in (([0.1, 0.1], [0.1, 0.1]), ([0.0, 0.0], [0.005, 0.0]), ([0.0, np.nan], [1.0, 0.0])):
        with pytest.raises(ReconstructionError, match="give no direction"):
            direction_of_marks(*ends, 1e-3)


def test_pixels_meet_the_water_where_their_rays_do():
    calibration = StereoCalibration.from_rectified((640, 512), 700.0, (319.5, 255.5), 0.06)
    points = on_water(frame_of(), calibration, np.array([[319.5, 255.5], [389.5, 255.5], [319.5, 185.5]]))
    np.testing.assert_allclose(points, [[0.1, 0.2, 0], [0.16, 0.2, 0], [0.1, 0.26, 0]], atol=1e-9)
    with pytest.raises(ReconstructionError, match="outside the picture of 640 x 512"):
        on_water(frame_of(), calibration, np.array([[700.0, 10.0]]))
    level = frame_of(np.array([[0, 0, 1.0], [-1.0, 0, 0], [0, -1.0, 0]]))
    with pytest.raises(ReconstructionError, match="above the horizon"):
        on_water(level, calibration, np.array([[319.5, 10.0]]))


def test_a_turned_frame_keeps_its_height_and_turns_its_covariance():
    direction = direction_of_marks([0.0, 0.0], [0.0, 1.0], 1e-3)
    turned = turned_frame(frame_of(), direction)
    np.testing.assert_allclose(turned.translation_m, frame_of().translation_m)
    np.testing.assert_allclose(np.diag(turned.covariance), [1.0, 9.0, 4.0], atol=1e-12)
    assert turned.x_axis_u_deg == pytest.approx(np.degrees(np.sqrt(2) * 1e-3))
    assert turned.source["x_axis"]["from"] == "two marks"
    assert WorldFrame.from_dict(turned.to_dict()).x_axis_u_deg == turned.x_axis_u_deg
