"""Boards in rendered pictures: corners against truth, one order for both cameras, reasons for failures."""

from __future__ import annotations

import numpy as np
import pytest

from thermacq_calibration import (
    Board,
    CalibrationError,
    Detection,
    NoBoard,
    average,
    check_board,
    detect_board,
)
from thermacq_calibration.targets.targets import similar_boards


@pytest.fixture(scope="module")
def pose(small_pair):
    return small_pair.poses(1, seed=4)[0]


@pytest.fixture(scope="module")
def picture(small_pair, pose):
    return small_pair.pictures(pose)[0]


def corner_error(found, truth):
    return float(np.median(np.linalg.norm(found.corners - truth, axis=1)))


@pytest.mark.parametrize(
    ("look", "limit_px"),
    [
        ({}, 0.06),
        ({"blur_px": 2.0}, 0.12),
        ({"contrast": 100.0}, 0.12),
        ({"contrast": 40.0, "noise": 1.0}, 0.06),
    ],
    ids=["sharp", "blurred", "weak", "a hundredth of the range"],
)
def test_corners_lie_where_they_are(small_pair, pose, look, limit_px):
    for picture, truth in zip(small_pair.pictures(pose, **look), small_pair.corners(pose), strict=True):
        found = detect_board(picture, small_pair.board)
        assert isinstance(found, Detection)
        assert corner_error(found, truth) < limit_px
        assert found.contrast == pytest.approx(look.get("contrast", 800.0), rel=0.1)


@pytest.mark.parametrize("seed", range(6))
def test_both_cameras_start_at_the_same_corner(small_pair, seed):
    some_pose = small_pair.poses(1, seed=seed)[0]
    for picture, truth in zip(small_pair.pictures(some_pose), small_pair.corners(some_pose), strict=True):
        found = detect_board(picture, small_pair.board)
        assert isinstance(found, Detection)
        assert corner_error(found, truth) < 0.1


def test_an_upside_down_board_starts_at_its_own_corner(small_pair, picture, pose):
    truth = small_pair.corners(pose)[0]
    turned = detect_board(picture[::-1, ::-1], small_pair.board)
    assert isinstance(turned, Detection)
    columns, rows = small_pair.truth.image_size
    assert corner_error(turned, np.array([columns - 1, rows - 1]) - truth) < 0.1


def test_inverted_polarity_is_found_and_starts_at_the_other_end(small_pair, pose):
    picture = small_pair.pictures(pose, inverted=True)[0]
    found = detect_board(picture, small_pair.board)
    assert isinstance(found, Detection)
    assert corner_error(found, small_pair.corners(pose)[0][::-1]) < 0.1


def test_averaging_frames_brings_the_corners_nearer(small_pair, pose):
    noisy = [small_pair.pictures(pose, contrast=100.0, noise=15.0, seed=seed)[0] for seed in range(16)]
    truth = small_pair.corners(pose)[0]
    one, many = (detect_board(picture, small_pair.board) for picture in (noisy[0], average(np.stack(noisy))))
    assert isinstance(many, Detection)
    assert isinstance(one, NoBoard) or corner_error(many, truth) < corner_error(one, truth)


def with_nan(picture):
    changed = picture.astype(float)
    changed[0, 0] = np.nan
    return changed


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda picture: np.full_like(picture, 8000), "constant"),
        (with_nan, "not numbers"),
        (lambda picture: np.where(picture > 8000, 16383, picture), "saturated"),
        (lambda picture: picture[:20, :20], "no picture"),
        (lambda picture: picture[None], "no picture"),
        (lambda _: np.random.default_rng(0).normal(8000, 5, (256, 320)), "no board of 9 x 6"),
        (lambda picture: picture[:, :160], "no board of 9 x 6"),
    ],
    ids=["constant", "nan", "saturated", "tiny", "stack", "noise", "cut"],
)
def test_unusable_pictures_say_why(small_pair, picture, spoil, words):
    if words == "saturated":
        picture = picture.copy()
        picture[60:180, 60:200] = 60000
    found = detect_board(spoil(picture), small_pair.board)
    assert isinstance(found, NoBoard)
    assert words in found.reason


def test_a_blurred_board_is_refused_for_its_blur(small_pair, pose):
    found = detect_board(small_pair.pictures(pose, blur_px=4.0)[0], small_pair.board)
    assert isinstance(found, NoBoard)
    assert "blurred" in found.reason


def test_a_faint_board_is_refused_for_its_contrast(small_pair, pose):
    found = detect_board(small_pair.pictures(pose, contrast=24.0, noise=8.0)[0], small_pair.board)
    assert isinstance(found, NoBoard)
    assert "contrast too small" in found.reason


def test_a_miscount_is_recognised(picture):
    squares_counted = Board(10, 7, 0.05)
    assert isinstance(detect_board(picture, squares_counted), NoBoard)
    assert similar_boards(picture, squares_counted)[0] == (9, 6)
    assert similar_boards(picture, Board(8, 5, 0.05))[0] == (9, 6)
    assert similar_boards(np.full((256, 320), 8000), squares_counted) == []


@pytest.mark.parametrize("board", [Board(8, 6, 0.05), Board(9, 7, 0.05), Board(2, 9, 0.05), Board(9, 6, 0.0)])
def test_ambiguous_and_impossible_boards_are_refused(board):
    with pytest.raises(CalibrationError):
        check_board(board)
