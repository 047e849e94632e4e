"""Guidance: what views are worth, and that following its advice pays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thermacq_calibration import Detection, NoBoard, View
from thermacq_calibration.targets.guidance import DIRECTIONS, NextView, guidance
from thermacq_calibration.targets.samples import sample_of

SIZE = (640, 512)
DEPTH_M = {"near": 0.6, "middle": 0.8, "far": 1.1}


def view(pair, pose, name="1"):
    return View(name, *(Detection(corners, 2.0, 500.0) for corners in pair.corners(pose)))


def held(pair, wanted, random):
    """A pose as a person would hold the board who was told so: roughly, and whole in both pictures."""
    away = np.array(DIRECTIONS.get(wanted.away, (0, 0)), float)
    away /= max(1.0, float(np.linalg.norm(away)))
    tilt = np.radians(random.uniform(25, 35)) * np.array([away[1], -away[0], 0.0])
    turn = Rotation.from_euler("z", random.uniform(-10, 10), degrees=True)
    rotation = (Rotation.from_rotvec(tilt) * turn).as_matrix()
    place = np.array([wanted.column, wanted.row]) - 1
    for depth in (DEPTH_M[wanted.distance] * random.uniform(0.9, 1.1), 0.9, 1.1):
        for part in np.linspace(1, 0, 21):
            middle = np.append(part * place * np.array(SIZE) / 2 / 705.9 * depth, depth)
            pose = rotation, middle - rotation @ pair.corner_points().mean(axis=0)
            corners = np.vstack(pair.corners(pose))
            if corners.min() > 20 and (corners < np.array(SIZE) - 20).all():
                return pose
    raise AssertionError("no such pose")


def views_needed(pair, poses, most=60):
    views = []
    judged = guidance(views, SIZE, pair.board)
    while not judged.enough and len(views) < most:
        views.append(view(pair, poses(judged.next_view)))
        judged = guidance(views, SIZE, pair.board)
    return len(views)


@pytest.mark.slow
def test_following_the_advice_needs_fewer_views_than_random_poses(pair):
    seeds = range(2)
    advised, free = [], []
    for seed in seeds:
        random, poses = np.random.default_rng(seed), iter(pair.poses(60, seed=seed))
        advised.append(views_needed(pair, lambda wanted, random=random: held(pair, wanted, random)))
        free.append(views_needed(pair, lambda _, poses=poses: next(poses)))
    assert max(advised) < 50
    assert sum(advised) < 0.8 * sum(free)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_tilt_and_its_direction_are_seen(pair, direction):
    pose = held(pair, NextView(1, 1, direction, "middle"), np.random.default_rng(1))
    sample = sample_of(view(pair, pose).left, pair.board, SIZE)
    truth_deg = np.degrees(np.arccos(abs(pose[0][2, 2])))
    assert sample.tilt_deg == pytest.approx(truth_deg, abs=5)
    wanted = np.array(DIRECTIONS[direction]) / np.linalg.norm(DIRECTIONS[direction])
    assert np.dot(sample.away, wanted) > 0.85


def test_a_part_of_the_board_says_the_same(pair):
    whole = view(pair, pair.poses(1, seed=3)[0]).left
    seen = np.arange(20, 50)
    part = Detection(whole.corners[seen], 2.0, 500.0, seen)
    one, other = (sample_of(found, pair.board, SIZE) for found in (whole, part))
    assert one.distance(other) < 0.02


def test_repeated_poses_count_once(pair):
    pose = pair.poses(1)[0]
    judged = guidance([view(pair, pose, str(index)) for index in range(9)], SIZE, pair.board)
    assert (judged.seen, judged.counted) == (9, 1)
    assert "24 more different views" in judged.missing
    assert not judged.enough


def test_frontal_views_lack_tilt(pair):
    judged = guidance(pair.views(40, tilt_deg=4.0), SIZE, pair.board)
    assert any("tilted views" in words for words in judged.missing)
    assert judged.tilted == 0


def test_without_views_everything_is_missing_and_there_is_advice(pair):
    lost = View("1", NoBoard("blurred"), NoBoard("blurred"))
    judged = guidance([lost], SIZE, pair.board)
    assert (judged.seen, judged.counted, set(judged.bars.values())) == (0, 0, {0.0})
    assert judged.left_cells.shape == (6, 8)
    assert "tilt it away at the upper left" in judged.next_view.words


def test_cells_are_those_with_corners(pair):
    corners = np.array([[10.0, 10.0], [639.0, 511.0]] + [[330.0, 260.0]] * 52)
    found = Detection(corners, 2.0, 500.0)
    judged = guidance([View("1", found, found)], SIZE, pair.board)
    assert np.argwhere(judged.left_cells).tolist() == [[0, 0], [3, 4], [5, 7]]
