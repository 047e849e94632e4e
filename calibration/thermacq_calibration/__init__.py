"""Pure numerics of calibration: arrays in, frozen records out. Imports nothing of the framework."""

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.models import Board, CameraModel, ViewReport
from thermacq_calibration.record import StereoCalibration, load_calibration
from thermacq_calibration.rectification import (
    Rectification,
    Resampling,
    apply,
    rectify,
    rectify_points,
    vertical_differences_px,
)

__all__ = [
    "Board",
    "CalibrationError",
    "CameraModel",
    "Rectification",
    "Resampling",
    "StereoCalibration",
    "ViewReport",
    "apply",
    "load_calibration",
    "rectify",
    "rectify_points",
    "vertical_differences_px",
]
