"""Two pairs that see one board: synthetic corners of two calibrated pairs at known places above the water."""

from __future__ import annotations

import dataclasses
import re

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.joining import (
    joined_frame,
    motion_between,
    placing_by_board,
    require_calibration,
    scale_uncertainty,
)
from thermacq.reconstruction.shared_board import BoardCorners, common_corners, triangulate_corners
from thermacq.reconstruction.world import WorldFrame
from thermacq_calibration import rectify

PLACES = (np.array([0.0, 0.0, 0.6]), np.array([0.84, -0.06, 0.61]))
YAWS_DEG = (0.0, 176.0)


def camera_axes(yaw_deg):
    """World to left camera: tilted by 22.8 degrees towards a direction."""
    tilt = np.radians(22.8)
    down = np.array([[0, -1.0, 0], [-np.cos(tilt), 0, -np.sin(tilt)], [np.sin(tilt), 0, -np.cos(tilt)]])
    return down @ Rotation.from_euler("z", -yaw_deg, degrees=True).as_matrix()


def projected(truth, axes, place, points):
    """Pixels of world points in both cameras of a pair."""
    seen = (points - place) @ axes.T
    turn, _ = cv2.Rodrigues(truth.rotation)
    cameras = ((truth.left, np.zeros(3), np.zeros(3)), (truth.right, turn, truth.translation_m))
    return [
        cv2.projectPoints(seen, rvec, tvec, camera.matrix, camera.distortion)[0].reshape(-1, 2)
        for camera, rvec, tvec in cameras
    ]


def own_frame(truth, which):
    """World frame that still water gives: right height and tilt, X up the picture, camera above (0, 0)."""
    rotation = Rotation.from_euler("z", -YAWS_DEG[which], degrees=True).as_matrix()
    axes = rectify(truth).rotation_left @ camera_axes(YAWS_DEG[which])
    return WorldFrame(
        rotation=rotation @ axes.T,
        translation_m=np.array([*(PLACES[which][:2] if which == 0 else (0.0, 0.0)), PLACES[which][2]]),
        sigma_m=4e-4,
        sigma_mean_m=2e-4,
        covariance=np.diag([3e-5, 1e-4, 1e-4]) ** 2,
        points=1000,
        frames=10,
        source={"calibration_sha256": truth.sha256},
    )


def shared_views(truth, seed, views=10, noise_px=0.1):
    """Views of a board of 9 x 6 corners below both pairs, with noisy corners."""
    rng = np.random.default_rng(seed)
    flat = np.stack([*np.meshgrid(np.arange(9), np.arange(6)), np.zeros((6, 9))], axis=-1).reshape(-1, 3)
    flat = (flat - flat.mean(axis=0)) * 0.02
    found = ([], [])
    for view in range(views):
        turn = Rotation.from_rotvec(rng.uniform(-0.25, 0.25, 3)).as_matrix()
        board = flat @ turn.T + rng.uniform([0.36, -0.1, -0.2], [0.48, 0.04, -0.05])
        for which in (0, 1):
            pixels = projected(truth, camera_axes(YAWS_DEG[which]), PLACES[which], board)
            noisy = [one + noise_px * rng.standard_normal(one.shape) for one in pixels]
            points, covariance = triangulate_corners(*noisy, truth)
            frames = range(10 * view + which, 10 * view + 8)
            found[which].append(BoardCorners(frames, np.arange(54), points, covariance))
    return found


def test_corners_are_triangulated_exactly_and_their_covariance_holds(pair):
    pose = pair.poses(1, seed=4)[0]
    points = pair.corner_points() @ pose[0].T + pose[1]
    exact, covariance = triangulate_corners(*pair.corners(pose), pair.truth)
    np.testing.assert_allclose(exact, points @ rectify(pair.truth).rotation_left.T, atol=1e-7)
    drawn = [triangulate_corners(*pair.corners(pose, 0.1, seed), pair.truth)[0] for seed in range(150)]
    errors = np.stack(drawn) - exact
    measured = np.einsum("sni,snj->nij", errors, errors) / len(errors)
    scale = np.sqrt(np.einsum("nii->ni", covariance))
    ratio = measured / (scale[:, :, None] * scale[:, None, :])
    expected = covariance / (scale[:, :, None] * scale[:, None, :])
    assert np.abs(ratio.mean(axis=0) - expected.mean(axis=0)).max() < 0.07


def test_the_second_pair_is_placed_within_its_stated_uncertainty(pair):
    first, second = own_frame(pair.truth, 0), own_frame(pair.truth, 1)
    scores = []
    for seed in range(16):
        motion, left_out = motion_between(*shared_views(pair.truth, seed))
        placing, doubts = placing_by_board(first, second, motion)
        assert not left_out
        assert not doubts
        error = [placing.x_m - 0.84, placing.y_m + 0.06, placing.yaw_rad + np.radians(176.0)]
        error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
        scores.append(error / np.sqrt(np.diag(placing.covariance)))
    # Ten views give nine degrees of freedom; 48 such numbers.
    assert 0.7 < np.std(scores) < 1.4
    joined = joined_frame(first, second, placing)
    true = camera_axes(176.0).T @ rectify(pair.truth).rotation_left.T
    assert np.degrees(np.arccos((np.trace(joined.rotation @ true.T) - 1) / 2)) < 0.1
    np.testing.assert_allclose(joined.translation_m, PLACES[1], atol=2e-3)
    assert joined.translation_m[2] == 0.61
    assert joined.source["joined"]["to_calibration_sha256"] == pair.truth.sha256
    assert joined.x_axis_u_deg > 0
    back = WorldFrame.from_dict(joined.to_dict())
    assert back.x_axis_u_deg == joined.x_axis_u_deg


def test_scales_of_the_calibrations_count_in_the_place(pair):
    first, second = own_frame(pair.truth, 0), own_frame(pair.truth, 1)
    rng = np.random.default_rng(5)
    scores = {True: [], False: []}
    for seed in range(16):
        views = [
            [dataclasses.replace(view, points_m=view.points_m * scale) for view in seen]
            for seen, scale in zip(shared_views(pair.truth, seed), 1 + rng.normal(0, 0.01, 2), strict=True)
        ]
        for stated, found in scores.items():
            motion, _ = motion_between(*views, (0.01, 0.01) if stated else (0.0, 0.0))
            placing, _ = placing_by_board(first, second, motion)
            found.append((placing.x_m - 0.84) / np.sqrt(placing.covariance[0, 0]))
    # RMS of 16 normals: 0.5 to 1.57 with 99.8 % probability.
    assert 0.5 < np.sqrt(np.mean(np.square(scores[True]))) < 1.57
    assert np.sqrt(np.mean(np.square(scores[False]))) > 2


def test_the_scale_of_a_calibration_is_as_uncertain_as_its_depth(pair):
    stated = {"standard": {"depth_m": 0.0013}}
    record = dataclasses.replace(pair.truth, uncertainty=stated, working_distance_m=0.65)
    assert scale_uncertainty(record) == pytest.approx(0.002)
    assert scale_uncertainty(pair.truth) == 0


def test_a_view_of_another_board_is_left_out_and_named(pair):
    views = shared_views(pair.truth, 1)
    views[1][4] = dataclasses.replace(views[1][4], points_m=views[1][4].points_m + np.array([0.03, 0, 0]))
    motion, left_out = motion_between(*views)
    assert motion.views == 9
    assert len(left_out) == 1
    assert left_out[0].startswith("view 40-47 left out")


def test_water_that_rose_between_the_records_is_noticed(pair):
    first, second = own_frame(pair.truth, 0), own_frame(pair.truth, 1)
    motion, _ = motion_between(*shared_views(pair.truth, 2))
    risen = dataclasses.replace(second, translation_m=second.translation_m - [0, 0, 0.02])
    _, doubts = placing_by_board(first, risen, motion)
    assert len(doubts) == 1
    assert float(re.search(r"([+-][0-9.]+) mm higher", doubts[0])[1]) == pytest.approx(20, abs=2)
    assert "water level" in doubts[0]


def test_boards_that_are_not_shared_and_foreign_calibrations_are_refused(pair):
    mine, its = shared_views(pair.truth, 0, views=2)
    with pytest.raises(ReconstructionError, match="no view of the board is shared"):
        common_corners(mine[:1], its[1:])
    with pytest.raises(ReconstructionError, match="sees it in 0 views"):
        common_corners([], its)
    cut = dataclasses.replace(
        its[0], indices=its[0].indices[10:], points_m=its[0].points_m[10:], covariance=its[0].covariance[10:]
    )
    ((one, other),) = common_corners(mine[:1], [cut])
    assert one.indices.tolist() == other.indices.tolist() == list(range(10, 54))
    with pytest.raises(ReconstructionError, match="second pair was found with another calibration"):
        require_calibration(own_frame(pair.truth, 1), "other", "second")
