"""Real pictures of a near-infrared pair, whose geometry is known from another program."""

from __future__ import annotations

import cv2
import pytest

from thermacq_calibration import Board, View, calibrate_stereo, detect_board, findings


def grey(path):
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return picture


def test_near_infrared_pairs_reach_the_known_geometry(shared_data):
    folder = shared_data / "nir_stereo_chessboard_640x512"
    board = Board(9, 6, 1.0)
    views = [
        View(
            left.stem[4:],
            detect_board(grey(left), board),
            detect_board(grey(left.with_name(left.name.replace("left", "right"))), board),
        )
        for left in sorted(folder.glob("left*.jpg"))
    ]
    made = calibrate_stereo(views, board, (640, 512))
    assert made.rms_px <= 0.20
    assert made.baseline_m == pytest.approx(3.85, rel=0.005)
    assert made.held_out_vertical_rms_px <= 0.20
    # In view 15 all corners of one picture lie 0.6 px lower: the board moved between the exposures.
    left_out = {view.name: view.reason for view in made.views if not view.used}
    assert left_out.keys() == {"15"}
    assert "rows differ" in left_out["15"]
    # The set's "left" camera is the one to the right.
    assert any("exchanged" in sentence for sentence in findings(made))
