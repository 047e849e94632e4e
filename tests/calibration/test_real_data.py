"""Real pictures of a near-infrared pair, whose geometry is known from another program."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from thermacq_calibration import (
    Board,
    CalibrationError,
    View,
    calibrate_stereo,
    detect_board,
    vertical_differences_px,
)
from thermacq_calibration.geometry.acceptance import acceptance, verdict


def grey(path):
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return picture


SQUARE_M = 0.02391
"""The author's baseline, 92.05 mm, over the 3.850 squares that another program's calibration gives."""


@pytest.fixture(scope="module")
def near_infrared(shared_data):
    """Views of the near-infrared set; its "left" camera is the one to the right, so the sides are exchanged."""
    folder = shared_data / "nir_stereo_chessboard_640x512"
    board = Board(9, 6, SQUARE_M)
    return board, [
        View(
            right.stem[5:],
            detect_board(grey(right), board),
            detect_board(grey(right.with_name(right.name.replace("right", "left"))), board),
        )
        for right in sorted(folder.glob("right*.jpg"))
    ]


def test_near_infrared_pairs_reach_the_known_geometry(near_infrared):
    board, views = near_infrared
    made = calibrate_stereo(views, board, (640, 512), replicates=50)
    assert made.rms_px <= 0.18
    assert max(made.left.rms_px, made.right.rms_px) <= 0.18
    assert made.baseline_m / SQUARE_M == pytest.approx(3.85, rel=0.005)
    assert made.held_out_vertical_rms_px <= 0.15
    # In view 15 all corners of one picture lie 0.6 px lower: the board moved between the exposures.
    left_out = {view.name: view.reason for view in made.views if not view.used}
    assert left_out.keys() == {"15"}
    assert "rows differ" in left_out["15"]
    # 16 views from one third of the picture do not make a good calibration, however small the RMS is.
    failed = {row.measure for row in acceptance(made) if row.verdict == "fail"}
    assert {"poses", "coverage of 8 x 6 cells", "depth-bias σ at 0.65 m"} <= failed
    assert verdict(acceptance(made)) == "fail"


def test_views_never_seen_by_the_calibration_agree_in_their_rows(near_infrared):
    board, views = near_infrared
    good = [view for view in views if view.name != "15"]
    rows = []
    for first in range(4):
        held_out = good[first::4]
        rest = [view for view in good if view not in held_out]
        made = calibrate_stereo(rest, board, (640, 512), replicates=0)
        rows += [vertical_differences_px(made, view.left.corners, view.right.corners) for view in held_out]
    assert len(rows) == 16
    assert np.sqrt(np.mean(np.square(rows))) <= 0.15


def test_exchanged_sides_of_real_pictures_are_refused(near_infrared):
    board, views = near_infrared
    exchanged = [View(view.name, view.right, view.left) for view in views]
    with pytest.raises(CalibrationError, match="left and right are exchanged"):
        calibrate_stereo(exchanged, board, (640, 512))
