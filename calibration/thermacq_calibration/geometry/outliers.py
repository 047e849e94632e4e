"""Views that do not belong: they fit far worse than the others, or show another board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.geometry.bundle import Corners, Fit, Geometry, Poses, fit, fit_poses
from thermacq_calibration.geometry.rectification import vertical_differences_px
from thermacq_calibration.models import Float

MIN_VIEWS = 5
# A view is an outlier when its reprojection error, or the difference of its rows after rectification (two
# pictures that were not taken at the same moment), exceeds the median of the views by this many robust
# standard deviations and is more than twice the median. At most a quarter of the views may go.
_OUTLIER_SIGMAS = 5.0
_OUTLIER_RATIO = 2.0
_MAX_OUTLIER_PART = 0.25
# A fit worse than this is no matter of noise: corners are found to 0.2 px on the worst of thermal boards.
MAX_PLAUSIBLE_RMS_PX = 1.0
# A board of other squares fits both cameras when its scale is freed; its scale is known to about 0.1 %.
_OTHER_SCALE = 0.01
_SCALES = (0.1, 10.0)


def without_outliers(
    found: Fit, corners: Corners, names: Sequence[str], image_size: tuple[int, int]
) -> tuple[Fit, NDArray[np.intp], dict[str, str]]:
    """Leave out the view that fits far worse than the others, fit again, and repeat until none does.

    Returns
    -------
    fit : Fit
        The solution of what is left.
    kept : numpy.ndarray
        Indices of the views that are left.
    outliers : dict
        Why the others went, by name.

    Raises
    ------
    CalibrationError
        Views that do not fit show a board of another size, or too many views do not fit.
    """
    outliers: dict[str, str] = {}
    first, kept = found, np.arange(corners.views)
    may_go = min(int(_MAX_OUTLIER_PART * corners.views), corners.views - MIN_VIEWS)
    while True:
        left = corners.select(kept)
        reprojection = view_rms(found.errors_px, left)
        rows = rows_rms(found.geometry, left, image_size)
        excess = np.array([reprojection / _limit(reprojection), rows / _limit(rows)])
        kind, worst = divmod(int(np.argmax(excess)), kept.size)
        if excess[kind, worst] <= 1 or len(outliers) >= may_go:
            break
        outliers[names[kept[worst]]] = _misfit(reprojection, worst) if kind == 0 else _moved(rows, worst)
        rest = np.delete(np.arange(kept.size), worst)
        kept = kept[rest]
        found = fit(found.geometry, found.poses.select(rest), corners.select(kept), found.free)
    gone = np.setdiff1d(np.arange(corners.views), kept)
    others = {
        names[view]: _best_scale(
            found, first.poses.select(np.array([view])), corners.select(np.array([view]))
        )
        for view in gone
    }
    _refuse_other_boards(others, float(np.max(view_rms(found.errors_px, corners.select(kept)))))
    rms = float(np.sqrt(np.mean(view_rms(found.errors_px, corners.select(kept)) ** 2)))
    if rms > MAX_PLAUSIBLE_RMS_PX:
        raise CalibrationError(
            f"the views do not fit together: reprojection error {rms:.2f} px, of which noise explains 0.3 px at most",
            remedy="Check that all views show the same board, that its corner counts and the order of the pictures "
            "are right, and that both pictures of a view were taken at the same moment.",
        )
    return found, kept, outliers


def view_rms(errors: Float, corners: Corners) -> Float:
    """(views,) reprojection error over both pictures, from (n, 4) or (n, 2) errors."""
    sums = np.add.reduceat(np.sum(errors**2, axis=1), corners.starts[:-1])
    return np.asarray(np.sqrt(sums / (errors.shape[1] / 2 * np.diff(corners.starts))))


def rows_rms(geometry: Geometry, corners: Corners, image_size: tuple[int, int]) -> Float:
    """(views,) difference of rows of corresponding corners after rectification."""
    differences = vertical_differences_px(geometry.calibration(image_size), corners.left, corners.right)
    sums = np.add.reduceat(differences**2, corners.starts[:-1])
    return np.asarray(np.sqrt(sums / np.diff(corners.starts)))


def _limit(errors: Float) -> float:
    median = float(np.median(errors))
    sigma = 1.4826 * float(np.median(np.abs(errors - median)))
    return max(median + _OUTLIER_SIGMAS * sigma, _OUTLIER_RATIO * median, 1e-9)


def _misfit(errors: Float, index: int) -> str:
    return (
        f"outlier: reprojection error {errors[index]:.2f} px, median of the views {np.median(errors):.2f} px"
    )


def _moved(rows: Float, index: int) -> str:
    return (
        f"outlier: rows differ by {rows[index]:.2f} px, median of the views {np.median(rows):.2f} px; "
        "perhaps the two pictures were not taken at the same moment"
    )


def _refuse_other_boards(scales: Mapping[str, tuple[float, float]], usual_px: float) -> None:
    """A view whose misfit vanishes with squares of another size shows another board: nothing is trusted."""
    others = [
        f"{name} ({scale:.3g} times as large)"
        for name, (scale, rms) in scales.items()
        if abs(scale - 1) > _OTHER_SCALE and rms < _OUTLIER_RATIO * usual_px
    ]
    if others:
        raise CalibrationError(
            f"views of another board are mixed in, judged by the size of its squares: {', '.join(others)}",
            remedy="Leave these views out; one calibration needs one board.",
        )


def _best_scale(found: Fit, start: Poses, view: Corners) -> tuple[float, float]:
    """Factor on the squares with which a view fits best, and its reprojection error then."""
    from scipy.optimize import minimize_scalar

    def rms(log_scale: float) -> float:
        scale = float(np.exp(log_scale))
        scaled = Corners(view.points_m * scale, view.left, view.right, view.starts)
        pose = Poses(start.rotations, start.translations_m * scale)
        return float(view_rms(fit_poses(found.geometry, pose, scaled)[1], view)[0])

    tried = np.linspace(np.log(_SCALES[0]), np.log(_SCALES[1]), 47)
    best = tried[int(np.argmin([rms(value) for value in tried]))]
    solution = minimize_scalar(
        rms, bounds=(best - 0.1, best + 0.1), method="bounded", options={"xatol": 1e-5}
    )
    return float(np.exp(solution.x)), float(solution.fun)
