"""Every kind of target against rendered truth: corner errors, parts of boards, polarity, reasons.

The pictures are those of a pinhole camera: blur, and noise of several kinds.
"""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thermacq_calibration import (
    Board,
    BoardKind,
    CalibrationError,
    Detection,
    NoBoard,
    average,
    board_points,
    check_board,
    detect_board,
)
from thermacq_calibration.fields import Fields
from thermacq_calibration.models import board_dict, board_from
from thermacq_calibration.targets.boards import hidden_by_marker

SIZE = (640, 512)
FOCAL_PX = 705.9
FINE = 3


def poses(board: Board, count: int, seed: int = 0, tilt_deg: float = 35.0, roll_deg: float = 180.0):
    """(homography squares to pixels, true points (n, 2)) of boards that are whole in the picture."""
    random = np.random.default_rng(seed)
    points = board_points(board).astype(float)
    matrix = np.array([[FOCAL_PX, 0, 319.5], [0, FOCAL_PX, 255.5], [0, 0, 1]])
    found = []
    while len(found) < count:
        angles = [*random.uniform(-tilt_deg, tilt_deg, 2), random.uniform(-roll_deg, roll_deg)]
        rotation = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        depth = random.uniform(0.55, 0.8)
        middle = np.append(random.uniform(-0.15, 0.15, 2) * depth, depth)
        shift = middle - rotation @ points.mean(axis=0)
        seen = (points @ rotation.T + shift) @ matrix.T
        pixels = seen[:, :2] / seen[:, 2:]
        if (pixels > 45).all() and (pixels < np.array(SIZE) - 46).all():
            plane = matrix @ np.column_stack([rotation[:, :2], shift])
            found.append((plane @ np.diag([board.square_m, board.square_m, 1]), pixels))
    return found


def render(
    board: Board, homography, blur_px=0.7, contrast=500.0, noise=3.5, inverted=False, seed=0, fixed=0.0
):
    """Counts (512, 640) float; `fixed` adds fixed pattern, column noise and shading in its proportion."""
    columns, rows = SIZE
    v, u = (np.mgrid[: rows * FINE, : columns * FINE] + 0.5) / FINE - 0.5
    x, y, w = np.tensordot(np.linalg.inv(homography), np.stack([u, v, np.ones_like(u)]), axes=1)
    light = _LOOKS[board.kind](board, x / w, y / w)
    light = np.where(inverted, 1 - light, light)
    light = cv2.GaussianBlur(light.reshape(rows, FINE, columns, FINE).mean(axis=(1, 3)), (0, 0), blur_px)
    random = np.random.default_rng(seed)
    counts = 8000 + contrast * light + random.normal(0, noise, light.shape)
    patterns = np.random.default_rng(99)
    counts += fixed * patterns.normal(0, 3.0, light.shape) + fixed * patterns.normal(0, 2.0, columns)
    return counts + fixed * 20 * (
        (u[::FINE, ::FINE] / columns - 0.5) ** 2 + (v[::FINE, ::FINE] / rows - 0.5) ** 2
    )


def _chessboard(board, x, y):
    on_board = (x > -1) & (x < board.columns) & (y > -1) & (y < board.rows)
    return on_board * ((np.floor(x) + np.floor(y)) % 2 == 0).astype(float)


def _marked(board, x, y):
    """White rim and quiet zone; the marker's bits in a black border of one module."""
    light = np.where(_chessboard(board, x, y) > 0, 1.0, 0.0)
    rows, columns = np.nonzero(hidden_by_marker(board))
    block = (x > columns.min()) & (x < columns.max()) & (y > rows.min()) & (y < rows.max())
    bits = np.array([[int(bit) for bit in row] for row in board.dictionary.split("/")])
    modules = np.pad(bits, 1)
    side = board.marker_m / board.square_m
    column, row = (
        (place - (count - 1) / 2) / side + 0.5 for place, count in ((x, board.columns), (y, board.rows))
    )
    inside = (column > 0) & (column < 1) & (row > 0) & (row < 1)
    pick = [(place * len(modules)).astype(int).clip(0, len(modules) - 1) for place in (row, column)]
    return np.where(inside, modules[pick[0], pick[1]], np.where(block, 1.0, light))


def _charuco(board, x, y):
    scale = 60
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    squares = (board.columns + 1, board.rows + 1)
    layout = cv2.aruco.CharucoBoard(squares, board.square_m, board.marker_m, dictionary)
    drawn = layout.generateImage((squares[0] * scale, squares[1] * scale), marginSize=0)
    maps = [((place + 1) * scale - 0.5).astype(np.float32) for place in (x, y)]
    return cv2.remap(drawn, *maps, cv2.INTER_NEAREST, borderValue=255) / 255.0


def _circles(board, x, y, radius=0.4):
    points = board_points(board)[:, :2] / board.square_m
    nearest = np.full(x.shape, np.inf)
    for one, other in points:
        nearest = np.minimum(nearest, (x - one) ** 2 + (y - other) ** 2)
    on_board = (x > -2) & (x < 2 * board.columns + 1) & (y > -2) & (y < board.rows + 1)
    return on_board * (nearest > radius**2)


_LOOKS = {
    BoardKind.CHESSBOARD: _chessboard,
    BoardKind.MARKED: _marked,
    BoardKind.CHARUCO: _charuco,
    BoardKind.CIRCLES: _circles,
}


CHESSBOARD = Board(9, 6, 0.04)
BOARDS = {
    "circles": Board(4, 11, 0.03, BoardKind.CIRCLES),
    "charuco": Board(9, 6, 0.04, BoardKind.CHARUCO, 0.03, "DICT_4X4_50"),
    "marked": Board(11, 9, 0.032, BoardKind.MARKED, 0.1, "011/110/010"),
}
# Rows of the table of docs/reference/calibration.md: NETD 35 mK, fixed pattern 30 mK, columns 20 mK, at 100
# counts per kelvin. The limits are those of the published detectors, with a fifth to spare for few poses.
TABLE = {
    "sharp, 5 K": (0.5, 500.0, False, 0.045),
    "1 px, 1 K": (1.0, 100.0, False, 0.07),
    "1 px, 1 K, inverted": (1.0, 100.0, True, 0.07),
    "2 px, 1 K": (2.0, 100.0, False, 0.07),
    "2 px, 0.3 K, mean of 16": (2.0, 30.0, False, 0.15),
}


def errors(found, truth):
    return np.linalg.norm(found.corners - truth[found.indices], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("row", TABLE)
def test_chessboard_corners_are_as_good_as_the_table(row):
    blur, contrast, inverted, limit = TABLE[row]
    found = []
    for seed, (homography, truth) in enumerate(poses(CHESSBOARD, 4, seed=2, roll_deg=20)):
        noise = 3.5 / 4 if "mean of 16" in row else 3.5
        picture = render(CHESSBOARD, homography, blur, contrast, noise, inverted, seed, fixed=1.0)
        detection = detect_board(picture, CHESSBOARD)
        assert isinstance(detection, Detection)
        found.append(errors(detection, truth[::-1] if inverted else truth))
    assert np.median(np.concatenate(found)) < limit, np.median(np.concatenate(found))


@pytest.mark.parametrize("inverted", [False, True], ids=["plain", "inverted"])
@pytest.mark.parametrize(("kind", "least"), [("circles", 44), ("charuco", 45), ("marked", 70)])
def test_points_lie_where_they_are(kind, least, inverted):
    board = BOARDS[kind]
    check_board(board)
    for seed, (homography, truth) in enumerate(poses(board, 2, seed=5)):
        picture = render(board, homography, 1.0, 300.0, 3.5, inverted, seed)
        found = detect_board(picture, board)
        assert isinstance(found, Detection)
        assert len(found.corners) >= least
        assert np.median(errors(found, truth)) < 0.06
        assert errors(found, truth).max() < 0.5
        # Between a square and the marker in it there are only 4 px here: blur takes a quarter of the contrast.
        assert found.contrast == pytest.approx(300, rel=0.3 if kind == "charuco" else 0.1)
        assert 2 < found.sharpness_px < 4


@pytest.mark.parametrize("kind", ["charuco", "marked"])
def test_a_part_of_a_board_with_markers_is_enough(kind):
    board = BOARDS[kind]
    homography, truth = poses(board, 1, seed=5)[0]
    left = int(np.percentile(truth[:, 0], 20))
    picture = render(board, homography, 1.0)[:, left:]
    found = detect_board(picture, board)
    assert isinstance(found, Detection)
    assert len(found.corners) < 0.9 * len(truth)
    assert np.median(errors(found, truth - [left, 0])) < 0.06


def test_averaging_helps_faint_circles():
    board = BOARDS["circles"]
    homography, truth = poses(board, 1, seed=1)[0]
    clean = render(board, homography, 2.0, 30.0, noise=0.0)
    noisy = clean + np.random.default_rng(3).normal(0, 3.5, (16, *clean.shape))
    one, many = (detect_board(picture, board) for picture in (noisy[0], average(noisy)))
    assert isinstance(one, Detection)
    assert isinstance(many, Detection)
    assert np.median(errors(many, truth)) < 0.6 * np.median(errors(one, truth))


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("circles", "no asymmetric grid of 4 x 11 circles"),
        ("charuco", "corners of the ChArUco board"),
        ("marked", "the marker in the middle of the board"),
    ],
)
def test_another_board_is_no_board(kind, words):
    homography, _ = poses(CHESSBOARD, 1, roll_deg=10)[0]
    found = detect_board(render(CHESSBOARD, homography), BOARDS[kind])
    assert isinstance(found, NoBoard)
    assert words in found.reason


def test_the_marker_hides_the_corners_of_its_block():
    hidden = hidden_by_marker(BOARDS["marked"])
    assert np.argwhere(hidden).min(axis=0).tolist() == [2, 3]
    assert np.argwhere(hidden).max(axis=0).tolist() == [6, 7]
    assert hidden.sum() == 25


def test_rows_of_circles_are_shifted_by_half_a_step():
    points = board_points(Board(4, 11, 0.01, BoardKind.CIRCLES))
    np.testing.assert_allclose(points[[0, 1, 4, 43], :2], [[0, 0], [0.02, 0], [0.01, 0.01], [0.06, 0.1]])


@pytest.mark.parametrize(
    ("board", "words"),
    [
        (Board(4, 10, 0.03, BoardKind.CIRCLES), "half a turn"),
        (Board(9, 6, 0.04, BoardKind.CHARUCO, 0.05, "DICT_4X4_50"), "does not fit"),
        (Board(9, 6, 0.04, BoardKind.CHARUCO, 0.03, "DICT_9X9"), "no dictionary"),
        (Board(11, 9, 0.04, BoardKind.MARKED, 0.1, "101/010/101"), "looks the same after a turn"),
        (Board(11, 9, 0.04, BoardKind.MARKED, 0.1, "10/01/11"), "no dictionary"),
    ],
)
def test_impossible_boards_are_refused(board, words):
    with pytest.raises(CalibrationError, match=words):
        check_board(board)


@pytest.mark.parametrize("kind", BOARDS)
def test_boards_survive_a_record(kind):
    written = json.loads(json.dumps(board_dict(BOARDS[kind])))
    assert board_from(Fields(written, "board")) == BOARDS[kind]


def test_plain_chessboards_are_written_as_ever():
    assert board_dict(CHESSBOARD) == {"columns": 9, "rows": 6, "square_m": 0.04}


def test_real_pictures_of_a_board_with_a_marker_are_used(shared_data):
    board = Board(11, 9, 0.0505, BoardKind.MARKED, 0.1615, "011/110/010")
    files = sorted((shared_data / "mrt_lwir_checkerboard").glob("*.png"))
    found = [detect_board(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), board) for file in files]
    assert len(found) == 8
    assert all(isinstance(one, Detection) and len(one.corners) >= 40 for one in found)
    points = [board_points(board)[one.indices] for one in found]
    corners = [one.corners.astype(np.float32) for one in found]
    guess = cv2.initCameraMatrix2D(points, corners, (382, 288))
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    rms, *_ = cv2.calibrateCamera(points, corners, (382, 288), guess, np.zeros(5), flags=flags)
    assert rms < 0.3
