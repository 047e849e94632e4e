"""Distortion models and the choice between them by cross-validation, not by habit.

Each candidate is fitted to four fifths of the views; in the others only the pose of the board is fitted, and the
reprojection error that remains is the score. Differences of mean squared error are judged by their standard error
between views, as all candidates are tried on the same views. Tangential distortion is left out only where the best
candidate with it is worse than the best one by two standard errors: the principal point takes up what is left out.
Of the candidates that remain the simplest is taken that exceeds the best of them by no more than half a standard error
(a stricter form of the one-standard-error rule of Hastie, Tibshirani and Friedman, "The elements of statistical
learning", section 7.10). A candidate of which the views leave a coefficient open (the rational model of a lens that
distorts little) is not taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.bundle import (
    CAMERA_PARAMETERS,
    PARAMETERS,
    Corners,
    Fit,
    Flags,
    covariance,
    fit,
    fit_poses,
)
from thermacq_calibration.models import Float

# Free coefficients of each candidate, the simplest first; k1 to k3 and p1, p2 are Brown and Conrady's,
# k4 to k6 make the radial factor a ratio of polynomials.
CANDIDATES: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "k1": ("k1",),
    "k1 k2": ("k1", "k2"),
    "k1 k2 p1 p2": ("k1", "k2", "p1", "p2"),
    "k1 k2 p1 p2 k3": ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
FIRST = "k1 k2 p1 p2"
"""The model that views are looked at with before one is chosen."""
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FOLDS = 5
# Fits of four fifths of the views start from the solution and are there after four steps, but for models of which
# the views leave coefficients open.
_FOLD_STEPS = 6
# Half of the usual one standard error: a missing coefficient biases without showing in any stated uncertainty, one
# too many only widens it.
_ALLOWED_SE = 0.5
# Most of all p1 and p2: where they are weak and left out, the principal point errs by up to 4 of its stated sigmas
# (RMS); see docs/explanation/calibration-uncertainty.md for figures.
_REFUTED_SE = 2.0


@dataclass(frozen=True)
class Score:
    """How well a distortion model predicts views that it was not fitted to.

    Parameters
    ----------
    model
        Name of the candidate.
    held_out_rms_px
        Reprojection error on held-out views, over both pictures.
    excess_px2, excess_se_px2
        Mean squared error above that of the best candidate, and the standard error of this difference.
    determined
        Whether the views determine all of its coefficients; if not, it is not taken.
    """

    model: str
    held_out_rms_px: float
    excess_px2: float
    excess_se_px2: float
    determined: bool


def free_parameters(model: str) -> Flags:
    """(30,) bool: which shared parameters a distortion model leaves free."""
    free = np.ones(PARAMETERS, bool)
    coefficients = [name in CANDIDATES[model] for name in _COEFFICIENTS]
    free[4:CAMERA_PARAMETERS] = coefficients
    free[CAMERA_PARAMETERS + 4 : 2 * CAMERA_PARAMETERS] = coefficients
    return free


def refit(found: Fit, corners: Corners, model: str) -> Fit:
    """Fit another distortion model, starting from a solution; coefficients that it has not are 0."""
    free = free_parameters(model)
    start = found.geometry.moved(
        np.where(free, 0.0, -np.concatenate([found.geometry.left, found.geometry.right, np.zeros(6)]))
    )
    return fit(start, found.poses, corners, free)


def choose(found: Fit, corners: Corners) -> tuple[str, tuple[Score, ...]]:
    """Choose a distortion model.

    Parameters
    ----------
    found
        A solution to start from.
    corners
        Corners of all views, five views at least.

    Returns
    -------
    model : str
        Name of the choice.
    scores : tuple of Score
        All candidates, the simplest first.

    Raises
    ------
    CalibrationError
        The views determine no candidate.
    """
    fits = {model: refit(found, corners, model) for model in CANDIDATES}
    determined = {model: covariance(one, corners) is not None for model, one in fits.items()}
    if not any(determined.values()):
        raise CalibrationError(
            "the views do not determine the geometry of the cameras",
            remedy="Tilt the board by 20 to 40 degrees about both axes, and show it all over the picture.",
        )
    squares = {model: _held_out_squares(one, corners) for model, one in fits.items()}
    usable = [model for model in CANDIDATES if determined[model]]
    best = _best(usable, squares)
    scores = tuple(
        Score(model, float(np.sqrt(errors.mean())), *_excess(errors, squares[best]), determined[model])
        for model, errors in squares.items()
    )
    tangential = [model for model in usable if "p1" in CANDIDATES[model]]
    if tangential and _near(squares[_best(tangential, squares)], squares[best], _REFUTED_SE):
        usable, best = tangential, _best(tangential, squares)
    return next(model for model in usable if _near(squares[model], squares[best], _ALLOWED_SE)), scores


def _best(models: Sequence[str], squares: Mapping[str, Float]) -> str:
    return min(models, key=lambda model: float(squares[model].mean()))


def _excess(squares: Float, best: Float) -> tuple[float, float]:
    """How much larger the mean square is, and the standard error of this difference."""
    excess = squares - best
    return float(excess.mean()), float(excess.std(ddof=1) / np.sqrt(excess.size))


def _near(squares: Float, best: Float, allowed_se: float) -> bool:
    excess, error = _excess(squares, best)
    return excess <= allowed_se * error


def _held_out_squares(found: Fit, corners: Corners) -> Float:
    """(views,) mean squared reprojection error of each view under a fit without its fold, px^2."""
    squares = np.empty(corners.views)
    for train, test in folds(corners.views):
        part = fit(
            found.geometry,
            found.poses.select(train),
            corners.select(train),
            found.free,
            iterations=_FOLD_STEPS,
        )
        held_out = corners.select(test)
        _, errors = fit_poses(part.geometry, found.poses.select(test), held_out)
        sums = np.add.reduceat(np.sum(errors**2, axis=1), held_out.starts[:-1])
        squares[test] = sums / (2 * np.diff(held_out.starts))
    return squares


def folds(views: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(train, test) indices of views: every fifth one is held out in turn."""
    count = min(FOLDS, views)
    every = np.arange(views)
    return [(every[every % count != fold], every[every % count == fold]) for fold in range(count)]
