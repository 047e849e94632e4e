"""Pure numerics of calibration: arrays in, frozen records out. Imports nothing of the framework."""

from thermacq_calibration.boards import board_points, check_board
from thermacq_calibration.correction import BadPixel, CameraCorrection, load_correction
from thermacq_calibration.corrector import Corrector
from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.judgement import findings
from thermacq_calibration.models import Board, BoardKind, CameraModel, ViewReport
from thermacq_calibration.record import StereoCalibration, load_calibration
from thermacq_calibration.rectification import (
    Rectification,
    Resampling,
    apply,
    rectify,
    rectify_points,
    vertical_differences_px,
)
from thermacq_calibration.stereo import View, calibrate_stereo
from thermacq_calibration.targets import (
    FRAMES_TO_AVERAGE,
    Detection,
    NoBoard,
    average,
    detect_board,
)

__all__ = [
    "FRAMES_TO_AVERAGE",
    "BadPixel",
    "Board",
    "BoardKind",
    "CalibrationError",
    "CameraCorrection",
    "CameraModel",
    "Corrector",
    "Detection",
    "NoBoard",
    "Rectification",
    "Resampling",
    "StereoCalibration",
    "View",
    "ViewReport",
    "apply",
    "average",
    "board_points",
    "calibrate_stereo",
    "check_board",
    "detect_board",
    "findings",
    "load_calibration",
    "load_correction",
    "rectify",
    "rectify_points",
    "vertical_differences_px",
]
