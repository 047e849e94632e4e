"""Do rows of two rectified pictures correspond? Measured on whatever texture they show.

Features (SIFT) found in both pictures start the search; a small window around each is then moved until it fits
(Lucas and Kanade), which gives hundredths of a pixel where the detector alone gives tenths. Rows of a perfectly
rectified pair agree, whatever the depth, so the difference of rows judges the calibration without any target:
its median shows a turn of the cameras about their x axis since the calibration, its trend over the picture a
turn about the other axes or a changed focal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.models import Float

MIN_MATCHES = 30
# Matches with more difference of rows are mistaken ones: no calibration is off by so much and still of use.
MAX_ROWS_PX = 8.0
# As the held-out rectified vertical RMS of an acceptable calibration.
MAX_SYSTEMATIC_PX = 0.25
_OUTLIER_SIGMAS = 4.0
_RATIO = 0.75
_WINDOW = (21, 21)
# The refinement may not leave the place that the features gave.
_MAX_REFINEMENT_PX = 3.0
_FEATURES = 4000
# Texture coarser than this is taken away; contrast is evened out over that distance.
_FINE_PX, _AROUND_PX = 25.0, 60.0


@dataclass(frozen=True, eq=False)
class RowDifferences:
    """Matches of rectified pictures.

    Parameters
    ----------
    places
        (n, 2) float64 pixels (u, v) in the left picture.
    rows_px
        (n,) row in the left less row in the right picture (as `rectification.vertical_differences_px`).
    disparities_px
        (n,) column in the left less column in the right picture.
    """

    places: Float
    rows_px: Float
    disparities_px: Float


@dataclass(frozen=True)
class RowAgreement:
    """How well rows agree.

    Parameters
    ----------
    matches
        How many matches this rests on.
    median_px
        Median of the row in the left less the row in the right picture.
    mad_px
        Median absolute deviation from it.
    standard_error_px
        Of the median, from the deviation.
    across_px, down_px
        Change of the difference from the left to the right border, and from the upper to the lower one.
    disparities_px
        5th and 95th percentile of disparity.
    """

    matches: int
    median_px: float
    mad_px: float
    standard_error_px: float
    across_px: float
    down_px: float
    disparities_px: tuple[float, float]

    @property
    def systematic_px(self) -> float:
        """RMS over the picture of the difference that median and trend describe."""
        return float(np.sqrt(self.median_px**2 + (self.across_px**2 + self.down_px**2) / 12))

    @property
    def fits(self) -> bool:
        """Whether rows agree as well as those of an acceptable calibration."""
        return self.systematic_px <= MAX_SYSTEMATIC_PX


def match_rows(left: NDArray[Any], right: NDArray[Any]) -> RowDifferences:
    """Match texture of two rectified pictures.

    Parameters
    ----------
    left, right
        (rows, columns) counts; NaN outside.

    Returns
    -------
    RowDifferences
        Perhaps empty.
    """
    import cv2

    pictures = [_local_stretch(picture) for picture in (left, right)]
    inside = [
        np.asarray(cv2.erode(np.isfinite(picture).astype(np.uint8), np.ones(_WINDOW)))
        for picture in (left, right)
    ]
    sift = cv2.SIFT.create(nfeatures=_FEATURES, contrastThreshold=0.02)
    (first, first_words), (second, second_words) = (
        sift.detectAndCompute(picture, mask) for picture, mask in zip(pictures, inside, strict=True)
    )
    if min(len(first), len(second)) < 2:
        return RowDifferences(np.empty((0, 2)), np.empty(0), np.empty(0))
    pairs = _mutual(first_words, second_words)
    begin = np.array([first[one].pt for one, _ in pairs], np.float32).reshape(-1, 2)
    guess = np.array([second[other].pt for _, other in pairs], np.float32).reshape(-1, 2)
    plausible = np.abs(guess[:, 1] - begin[:, 1]) <= MAX_ROWS_PX
    begin, guess = begin[plausible], guess[plausible]
    if len(begin) == 0:
        return RowDifferences(np.empty((0, 2)), np.empty(0), np.empty(0))
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    end, found, _ = cv2.calcOpticalFlowPyrLK(
        pictures[0],
        pictures[1],
        begin,
        guess.copy(),
        winSize=_WINDOW,
        maxLevel=0,
        criteria=stop,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    near = np.hypot(*(end - guess).T) <= _MAX_REFINEMENT_PX
    good = (found.ravel() == 1) & near
    begin, end = begin[good].astype(np.float64), end[good].astype(np.float64)
    return RowDifferences(begin, begin[:, 1] - end[:, 1], begin[:, 0] - end[:, 0])


def row_agreement(differences: Sequence[RowDifferences], image_size: tuple[int, int]) -> RowAgreement:
    """Judge the matches of one or more pairs together.

    Raises
    ------
    CalibrationError
        Fewer than `MIN_MATCHES` matches.
    """
    places = np.vstack([one.places for one in differences])
    rows, disparities = (
        np.concatenate([getattr(one, name) for one in differences]) for name in ("rows_px", "disparities_px")
    )
    if rows.size < MIN_MATCHES:
        raise CalibrationError(
            f"only {rows.size} places of the pictures could be matched, {MIN_MATCHES} are needed",
            remedy="Use pictures with more texture: a wavy water surface, or the board.",
        )
    kept = _plausible(places / image_size, rows)
    places, rows, disparities = places[kept], rows[kept], disparities[kept]
    median = float(np.median(rows))
    mad = float(np.median(np.abs(rows - median)))
    across, down = _trend(places / image_size, rows)[1:]
    return RowAgreement(
        int(rows.size),
        median,
        mad,
        # Median of normal errors: 1.25 standard errors of the mean.
        float(1.2533 * 1.4826 * mad / np.sqrt(rows.size)),
        float(across),
        float(down),
        (float(np.percentile(disparities, 5)), float(np.percentile(disparities, 95))),
    )


def _plausible(places: Float, rows: Float) -> NDArray[np.bool_]:
    """Which matches lie near the trend of all; the others are mistaken."""
    rest = rows - _design(places) @ _trend(places, rows)
    return np.asarray(np.abs(rest) <= _OUTLIER_SIGMAS * 1.4826 * np.median(np.abs(rest)) + 1e-6)


def _trend(places: Float, rows: Float) -> Float:
    """Mean and slopes over the picture by least absolute deviations (reweighted least squares)."""
    design = _design(places)
    weight = np.ones(len(places))
    found: Float = np.zeros(3)
    for _ in range(30):
        solution = np.linalg.lstsq(design * weight[:, None], rows * weight, rcond=None)[0]
        found = np.asarray(solution, np.float64)
        weight = 1 / np.sqrt(np.maximum(np.abs(rows - design @ found), 1e-3))
    return found


def _design(places: Float) -> Float:
    return np.column_stack([np.ones(len(places)), places - 0.5])


def _mutual(first: NDArray[Any], second: NDArray[Any]) -> list[tuple[int, int]]:
    """Indices of features that are each other's best, and clearly so."""
    import cv2

    matcher = cv2.BFMatcher(cv2.NORM_L2)

    def clear(one: NDArray[Any], other: NDArray[Any]) -> dict[int, int]:
        return {
            best.queryIdx: best.trainIdx
            for best, next_best in matcher.knnMatch(one, other, k=2)
            if best.distance < _RATIO * next_best.distance
        }

    back = clear(second, first)
    return [(one, other) for one, other in clear(first, second).items() if back.get(other) == one]


def _local_stretch(picture: NDArray[Any]) -> NDArray[np.uint8]:
    """8 bit with even contrast everywhere: less the mean nearby, over the mean deviation around; holes are grey.

    Smooth weights, unlike the tiles of a local histogram, do not move texture.
    """
    import cv2

    values = np.asarray(picture, np.float32)
    finite = np.isfinite(values)
    if not finite.any():
        raise CalibrationError(
            "a rectified picture is empty", remedy="Check that the calibration is of these cameras."
        )
    filled = np.where(finite, values, np.median(values[finite]))
    fine = filled - cv2.GaussianBlur(filled, (0, 0), _FINE_PX)
    strength = cv2.GaussianBlur(np.abs(fine), (0, 0), _AROUND_PX)
    # Weak places are not raised to the mean: what would show there is noise, and blocks of a compressed picture.
    floor = max(float(strength.mean()), 1e-6)
    return np.rint(np.clip(128 + 40 * fine / np.maximum(strength, floor), 0, 255)).astype(np.uint8)
