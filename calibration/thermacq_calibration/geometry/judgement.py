"""What is refused about a calibration, and what looks weak about one, in sentences for the user.

RMS alone cannot judge a calibration: near-frontal views give the same RMS as diverse ones, and a depth
error nine times larger. The limits are those of `thermacq_calibration.geometry.acceptance`.
"""

from __future__ import annotations

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.acceptance import Verdict, acceptance, outlier_part, tilted_part
from thermacq_calibration.geometry.record import StereoCalibration
from thermacq_calibration.models import Board

# Boards are carried by hand; larger numbers are millimetres or centimetres.
_LARGEST_SQUARE_M = 0.5
# Squares of so many centimetres are no smaller than the largest; fewer may be centimetres.
_MILLIMETRES_FROM = 15.0
# Two cameras over a flume stand centimetres apart.
_LARGE_BASELINE_M = 1.0
# Bootstrap over covariance of the fit: on simulated views with independent errors 0.7 to 1.3.
_CORRELATED = 2.0


def refuse_impossible_square(board: Board) -> None:
    """Refuse a side of a square that is no number of metres.

    Raises
    ------
    CalibrationError
        The square is larger than a board that anybody could hold.
    """
    if board.square_m > _LARGEST_SQUARE_M:
        raise CalibrationError(
            f"squares of {board.square_m:g} m make no board: the side of a square is wanted in metres",
            remedy=f"If it is {board.square_m:g} mm, give {board.square_m / 1000:g}"
            + (
                f"; if {board.square_m:g} cm, {board.square_m / 100:g}."
                if board.square_m < _MILLIMETRES_FROM
                else "."
            ),
        )


def refuse_wrong_sides(calibration: StereoCalibration) -> None:
    """Refuse exchanged sides and cameras above each other, which rectification could not use.

    Raises
    ------
    CalibrationError
        The right camera does not stand to the right of the left one.
    """
    x, y, _ = calibration.translation_m
    if abs(y) > abs(x):
        raise CalibrationError(
            "the cameras stand above each other; thermacq needs them side by side along the columns",
            remedy="Turn both pictures by 90 degrees, or mount the cameras side by side.",
        )
    if x > 0:
        raise CalibrationError(
            f"left and right are exchanged: the right camera stands {100 * x:.3g} cm to the left of the left one",
            remedy="Exchange the two sides (pictures: --left and --right; a rig: the names of its cameras) and "
            "calibrate again.",
        )


def findings(calibration: StereoCalibration) -> list[str]:
    """List what a person should know before trusting this calibration; empty when nothing stands out."""
    failed = {row.measure: row for row in acceptance(calibration) if row.verdict is Verdict.FAIL}
    found = _geometry(calibration)
    for measure, row in failed.items():
        found.append(_sentence(calibration, measure) or f"{measure}: {row.value}, wanted {row.passes}.")
    return found + _correlated(calibration)


def _correlated(calibration: StereoCalibration) -> list[str]:
    """Views scatter more than the scatter of corners within them explains."""
    by_views = calibration.standard_uncertainty("depth_m")
    by_corners = ((calibration.uncertainty or {}).get("from_covariance") or {}).get("depth_m")
    if not by_views or not by_corners or by_views < _CORRELATED * by_corners:
        return []
    sentence = (
        f"Views disagree {by_views / by_corners:.1f} times as much as the scatter of their corners explains: the board "
        "may not be flat, or moved between the pictures of a view."
    )
    return [sentence]


def _geometry(calibration: StereoCalibration) -> list[str]:
    found = []
    if calibration.translation_m[0] > 0:
        found.append(
            "Left and right seem to be exchanged: the right camera stands to the left of the left one. "
            "Rectification will refuse this calibration; exchange the two sides and calibrate again."
        )
    if calibration.baseline_m > _LARGE_BASELINE_M:
        found.append(
            f"The baseline is {calibration.baseline_m:.4g} m. Was the square given in millimetres? It is wanted "
            "in metres."
        )
    return found


def _sentence(calibration: StereoCalibration, measure: str) -> str:
    """What a failed row means, where its numbers do not say it; empty where they do."""
    used = sum(view.used for view in calibration.views)
    if measure == "held-out rectified vertical RMS":
        return (
            f"The held-out rectified vertical error of {calibration.held_out_vertical_rms_px:.3f} px is above "
            "0.25 px: rows of the two pictures do not correspond well."
        )
    if measure == "poses" and (calibration.poses or used) < used:
        return (
            f"The {used} views show only {calibration.poses} different poses of the board; 25 or more make depth "
            "trustworthy."
        )
    if measure == "poses":
        return f"Only {used} views were used; 25 or more make depth trustworthy."
    if measure == "tilt":
        return (
            f"Only {tilted_part(calibration, 20.0):.0%} of the views are tilted by more than 20 degrees, a third is "
            "wanted: focal length and baseline are weakly determined, however small the RMS is."
        )
    if measure == "outlier views":
        outliers = sum(view.reason.startswith("outlier") for view in calibration.views)
        return f"{outliers} of {used + outliers} views ({outlier_part(calibration):.0%}) were left out as outliers."
    return ""
