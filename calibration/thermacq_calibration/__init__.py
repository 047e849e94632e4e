"""Pure numerics of calibration: arrays in, frozen records out. Imports nothing of the framework."""

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.judgement import findings
from thermacq_calibration.geometry.record import StereoCalibration, load_calibration
from thermacq_calibration.geometry.rectification import (
    Rectification,
    Resampling,
    apply,
    rectify,
    rectify_points,
    vertical_differences_px,
)
from thermacq_calibration.geometry.stereo import View, calibrate_stereo
from thermacq_calibration.infrared.correction import BadPixel, CameraCorrection, load_correction
from thermacq_calibration.infrared.corrector import Corrector
from thermacq_calibration.infrared.nonuniformity import make_correction, update_offset, with_outliers
from thermacq_calibration.infrared.pattern_growth import PatternGrowth, fit_growth
from thermacq_calibration.infrared.radiometry import RadiometricScale, radiometric_scale
from thermacq_calibration.infrared.reference_view import ReferenceView, observe
from thermacq_calibration.infrared.shading import with_shading
from thermacq_calibration.infrared.uniformity import Uniformity, uniformity
from thermacq_calibration.models import Board, BoardKind, CameraModel, ViewReport
from thermacq_calibration.targets.boards import board_points, check_board
from thermacq_calibration.targets.detection import Detection, NoBoard
from thermacq_calibration.targets.targets import (
    FRAMES_TO_AVERAGE,
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
    "PatternGrowth",
    "RadiometricScale",
    "Rectification",
    "ReferenceView",
    "Resampling",
    "StereoCalibration",
    "Uniformity",
    "View",
    "ViewReport",
    "apply",
    "average",
    "board_points",
    "calibrate_stereo",
    "check_board",
    "detect_board",
    "findings",
    "fit_growth",
    "load_calibration",
    "load_correction",
    "make_correction",
    "observe",
    "radiometric_scale",
    "rectify",
    "rectify_points",
    "uniformity",
    "update_offset",
    "vertical_differences_px",
    "with_outliers",
    "with_shading",
]
