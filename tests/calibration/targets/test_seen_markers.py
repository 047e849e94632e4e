"""Markers are read with their bits, and plain chessboards hold none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from thermacq_calibration import Board, BoardKind
from thermacq_calibration.targets.seen_markers import seen_markers
from thermacq_calibration.targets.targets import other_markers

BITS = "011/110/010"


def board_with_marker(bits, squares=(12, 10), side_px=20):
    """Chessboard whose middle 4 x 4 squares give way to a marker, light around it; uint8."""
    rows, columns = np.mgrid[: squares[1] * side_px, : squares[0] * side_px] // side_px
    picture = np.where((rows + columns) % 2 == 0, 200, 60)
    words = np.array([[int(bit) for bit in row] for row in bits.split("/")])
    marker = np.pad(words, 1).repeat(64 // (len(words) + 2), 0).repeat(64 // (len(words) + 2), 1)
    middle = [slice(side // 2 - 40, side // 2 + 40) for side in picture.shape]
    picture[tuple(middle)] = 200
    start = [(side - len(marker)) // 2 for side in picture.shape]
    picture[start[0] : start[0] + len(marker), start[1] : start[1] + len(marker)] = 60 + 140 * marker
    picture = np.pad(picture, 40, constant_values=60).astype(np.uint8)
    noisy = cv2.GaussianBlur(picture, (0, 0), 1.0) + np.random.default_rng(0).normal(0, 3, picture.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("bits", [BITS, "1011/0110/0001/1110", "10110/01101/11100/00011/10101"])
def test_the_bits_of_a_marker_are_read_whatever_their_number(bits):
    assert bits in seen_markers(board_with_marker(bits))


def test_a_cold_board_shows_the_same_marker():
    assert seen_markers(255 - board_with_marker(BITS)) == [BITS]


def test_a_board_that_was_turned_turns_the_bits():
    turned = np.ascontiguousarray(np.rot90(board_with_marker(BITS)))
    assert seen_markers(turned) == ["100/111/010"]


def test_a_plain_chessboard_holds_none(small_pair):
    for seed, pose in enumerate(small_pair.poses(4, seed=1)):
        counts, _ = small_pair.pictures(pose, seed=seed)
        assert other_markers(counts, small_pair.board) == []


def test_markers_are_sought_only_when_a_plain_board_was_wanted():
    picture = board_with_marker(BITS).astype(np.uint16)
    assert other_markers(picture, Board(9, 6, 0.05)) == [BITS]
    assert other_markers(picture, Board(11, 9, 0.05, BoardKind.MARKED, 0.16, BITS)) == []
    assert other_markers(np.full((64, 64), 7, np.uint16), Board(9, 6, 0.05)) == []


def test_real_pictures_of_a_board_with_a_marker(shared_data):
    files = sorted((shared_data / "mrt_lwir_checkerboard").glob("*.png"))
    pictures = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files]
    assert [other_markers(one, Board(9, 6, 0.05)) for one in pictures] == [[BITS]] * 8
