"""Sub-pixel refinement: from a matcher's quantised disparity to hundredths of a pixel.

SGBM interpolates its cost and locks towards whole pixels (about 0.2 px rms on thermal texture, 2 mm of
depth in the paper's geometry). Here the disparity is smoothed over twice the window and then corrected by
Gauss-Newton steps that minimise the squared difference between the left picture and the warped right one
under a Gaussian window. Each step runs on the whole picture at once. Because the start is smooth and the
window has a positive transfer function, two steps recover what the smoothing took from a wave while the
noise stays near the Cramér-Rao bound: sigma_d = sqrt(2) sigma_n / sqrt(sum (dI/dx)²) over the window.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Picture: TypeAlias = NDArray[np.float32]

_STEPS = 2
_LARGEST_STEP_PX = 0.5
_START_WIDTH = 2.0
"""Width of the smoothing of the start, in widths of the window."""
_FAR_PX = 1.5
"""A disparity further than this from its smoothed surroundings is no part of a smooth surface."""
_SMOOTH_SHARE = 0.9
_TINY = np.float32(1e-9)
_NEAR_PX = np.float32(1.0)
"""A refined value further than this from the matcher's own is trusted no more than the matcher."""


def refine(
    left: Picture, right: Picture, disparity: Picture, sigma_px: float = 6.0, min_correlation: float = 0.35
) -> Picture:
    """Refine a disparity to sub-pixel precision on smooth surfaces.

    Parameters
    ----------
    left, right
        (rows, columns) float32, locally normalised (`normalise`): mean 0, standard deviation 1.
    disparity
        (rows, columns) float32, pixels, NaN where unknown; good to about a pixel.
    sigma_px
        Standard deviation of the Gaussian window.
    min_correlation
        Normalised correlation of the two windows below which there is no texture to trust. Pure noise
        reaches 0.2, a texture as weak as the noise 0.57.

    Returns
    -------
    numpy.ndarray
        (rows, columns) float32. NaN where `disparity` is NaN, where the windows do not correlate, and
        where refinement contradicts the matcher on a smooth surface. Beside steps of depth, where a window
        would mix two surfaces, the matcher's own value stays.
    """
    start, smooth = _smooth_start(disparity, sigma_px)
    coefficients = _row_spline(right)
    columns = np.arange(left.shape[1], dtype=np.float32)
    refined: Picture = start
    for _ in range(_STEPS):
        warped = _sample_rows(coefficients, columns - refined)
        gradient = cv2.filter2D(0.5 * (warped + left), -1, np.array([[-0.5, 0.0, 0.5]], np.float32))
        gradient *= _inside(columns - refined)
        slope_square = _window(gradient * gradient, sigma_px)
        step = _window(gradient * (warped - left), sigma_px) / np.maximum(slope_square, _TINY)
        refined = np.asarray(refined + step.clip(-_LARGEST_STEP_PX, _LARGEST_STEP_PX), np.float32)
    inside = _inside(columns - refined)
    warped = _sample_rows(coefficients, columns - refined)
    mismatch = _window(inside * (warped - left) ** 2, sigma_px)
    energy = _window(inside * (left * left + warped * warped), sigma_px)
    correlated = mismatch <= (1.0 - min_correlation) * energy
    agrees = np.abs(refined - disparity) < _NEAR_PX
    chosen = np.where(agrees & smooth, refined, np.where(smooth, np.float32(np.nan), disparity))
    return np.where(correlated, chosen, np.float32(np.nan)).astype(np.float32, copy=False)


def normalise(picture: Picture, window_px: int = 51) -> Picture:
    """Take the local mean out of a picture and divide by the local standard deviation.

    Shading, lamp gradients and different gains of the two cameras vanish; NaN pixels become 0, the mean.
    """
    flat = remove_local_mean(picture, window_px)
    valid = np.isfinite(picture)
    variance = _box(flat * flat, window_px) / np.maximum(_box(valid, window_px), 1e-3)
    deviation = np.sqrt(np.maximum(variance, 0.0))
    floor = max(1e-3 * float(deviation.max(initial=0.0)), 1e-6)
    return np.asarray(flat / np.maximum(deviation, floor), np.float32)


def remove_local_mean(picture: Picture, window_px: int = 51) -> Picture:
    """Take the local mean over valid pixels out of a picture; NaN pixels become 0."""
    valid = np.isfinite(picture)
    level = np.float32(np.median(picture[valid])) if valid.any() else np.float32(0)
    # Sums of large raw counts would cancel; a common level is taken out first.
    centred = np.where(valid, picture - level, np.float32(0))
    mean = _box(centred, window_px) / np.maximum(_box(valid, window_px), 1e-3)
    return np.where(valid, centred - mean, np.float32(0)).astype(np.float32, copy=False)


def _smooth_start(disparity: Picture, sigma_px: float) -> tuple[Picture, NDArray[np.bool_]]:
    """Smooth disparity without its outliers, and where it belongs to one smooth surface."""
    known = np.isfinite(disparity)
    first, _ = _masked_mean(disparity, known, _START_WIDTH * sigma_px)
    near = known & (np.abs(np.where(known, disparity, np.inf) - first) < _FAR_PX)
    second, support = _masked_mean(disparity, near, _START_WIDTH * sigma_px)
    start = np.where(support > 0.05, second, first)
    share = _window(near, sigma_px) / np.maximum(_window(known, sigma_px), 1e-6)
    return start, share > _SMOOTH_SHARE


def _masked_mean(values: Picture, mask: NDArray[np.bool_], sigma_px: float) -> tuple[Picture, Picture]:
    support = _window(mask, sigma_px)
    total = _window(np.where(mask, values, np.float32(0)), sigma_px)
    return np.asarray(total / np.maximum(support, _TINY), np.float32), support


def _window(values: NDArray[Any], sigma_px: float) -> Picture:
    """Gaussian mean; wide windows are taken at half size, which they cannot tell apart and costs a sixth."""
    rows, columns = values.shape
    half = cv2.resize(
        values.astype(np.float32, copy=False), (columns // 2, rows // 2), interpolation=cv2.INTER_AREA
    )
    sigma = sigma_px / 2.0
    size = 2 * round(3.0 * sigma) + 1
    mean = cv2.GaussianBlur(half, (size, size), sigma)
    return np.asarray(cv2.resize(mean, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)


def _box(values: NDArray[Any], window_px: int) -> Picture:
    return np.asarray(cv2.blur(values.astype(np.float32, copy=False), (window_px, window_px)), np.float32)


def _inside(columns: Picture) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (columns >= 1.0) & (columns <= columns.shape[1] - 2.0)
    return inside


def _row_spline(picture: Picture) -> Picture:
    """Cubic B-spline coefficients along the rows."""
    from scipy.ndimage import spline_filter1d

    return np.asarray(spline_filter1d(picture, order=3, axis=1, output=np.float32, mode="mirror"), np.float32)


def _sample_rows(coefficients: Picture, columns: Picture) -> Picture:
    """Cubic B-spline at fractional columns of each row; OpenCV's remap knows only 1/32 of a pixel."""
    rows, width = coefficients.shape
    whole = np.floor(columns)
    t = columns - whole
    s = 1.0 - t
    outer = s**3 / 6.0, t**3 / 6.0
    inner = (4.0 + 3.0 * t * t * (t - 2.0)) / 6.0
    weights = (outer[0], inner, 1.0 - outer[0] - inner - outer[1], outer[1])
    first = whole.astype(np.int32) - 1
    row_start = (np.arange(rows, dtype=np.int32) * width)[:, None]
    flat = coefficients.ravel()
    sampled = np.zeros_like(columns)
    for tap, weight in enumerate(weights):
        sampled += weight * flat.take(row_start + np.clip(first + tap, 0, width - 1))
    return sampled
