"""What looks wrong or weak about a calibration, in sentences for the user.

RMS alone cannot judge a calibration: near-frontal views give the same RMS as diverse ones, and a depth
error nine times larger. The bars are those of docs/reference/calibration.md.
"""

from __future__ import annotations

from collections.abc import Sequence

from thermacq_calibration.models import ViewReport
from thermacq_calibration.record import StereoCalibration

WANTED_VIEWS = 25
MAX_RMS_PX = 0.25
MIN_COVERAGE = 0.8
TILTED_DEG = 20.0
MAX_OUTLIER_PART = 0.03
# Two cameras over a flume stand centimetres apart; metres mean that the square was given in millimetres.
_LARGE_BASELINE_M = 1.0


def findings(calibration: StereoCalibration) -> list[str]:
    """List what a person should know before trusting this calibration; empty when nothing stands out."""
    return _geometry(calibration) + _fit(calibration) + _views(calibration)


def _geometry(calibration: StereoCalibration) -> list[str]:
    found = []
    if calibration.translation_m[0] > 0:
        found.append(
            "Left and right seem to be exchanged: the right camera stands to the left of the left one. "
            "Rectification will refuse this calibration; exchange the two sides and calibrate again."
        )
    if abs(calibration.translation_m[1]) > abs(calibration.translation_m[0]):
        found.append(
            "The cameras stand above each other rather than side by side; rectification will refuse this."
        )
    if calibration.baseline_m > _LARGE_BASELINE_M:
        found.append(
            f"The baseline is {calibration.baseline_m:.4g} m. Was the square given in millimetres? It is wanted "
            "in metres."
        )
    return found


def _fit(calibration: StereoCalibration) -> list[str]:
    found = []
    rms, held_out = calibration.rms_px, calibration.held_out_vertical_rms_px
    if rms is not None and rms > MAX_RMS_PX:
        found.append(f"The stereo RMS of {rms:.3f} px is above {MAX_RMS_PX} px.")
    if held_out is not None and held_out > MAX_RMS_PX:
        found.append(
            f"The held-out rectified vertical error of {held_out:.3f} px is above {MAX_RMS_PX} px: rows of the "
            "two pictures do not correspond well."
        )
    if calibration.coverage is not None and min(calibration.coverage) < MIN_COVERAGE:
        left, right = calibration.coverage
        found.append(
            f"Corners cover {left:.0%} (left) and {right:.0%} (right) of the picture; "
            f"{MIN_COVERAGE:.0%} are wanted."
        )
    return found


def _views(calibration: StereoCalibration) -> list[str]:
    used = [view for view in calibration.views if view.used]
    if not used:
        return []
    found = []
    if len(used) < WANTED_VIEWS:
        found.append(f"Only {len(used)} views were used; {WANTED_VIEWS} or more make depth trustworthy.")
    if _tilted(used) < len(used) / 3:
        found.append(
            f"Fewer than a third of the views are tilted by more than {TILTED_DEG:g} degrees: focal length and "
            "baseline are weakly determined, however small the RMS is."
        )
    outliers = sum(view.reason.startswith("outlier") for view in calibration.views)
    if outliers > MAX_OUTLIER_PART * (len(used) + outliers):
        found.append(f"{outliers} of {len(used) + outliers} views were left out as outliers.")
    return found


def _tilted(views: Sequence[ViewReport]) -> int:
    return sum(view.tilt_deg is not None and view.tilt_deg > TILTED_DEG for view in views)
