"""Sub-pixel refinement: from a matcher's quantised disparity to hundredths of a pixel.

SGBM interpolates its cost and locks towards whole pixels (about 0.2 px rms on thermal texture, 2 mm of
depth in the paper's geometry). Here the disparity is smoothed over twice the window and then corrected by
Gauss-Newton steps that minimise the variance of the difference between the left picture and the warped
right one under a Gaussian window. Each step runs on the whole picture at once.

- The start is smooth and the window has a positive transfer function, so two steps recover what the
  smoothing took from a wave, while the noise stays near the Cramér-Rao bound
  sigma_d = sqrt(2) sigma_n / sqrt(sum (dI/dx)²) over the window.
- The local level is taken out of the difference, after the warp and over the same window in both
  pictures. Taking it out of each picture beforehand looks the same but is not: beside the edge of the one
  picture the other one has more surroundings, which costs 0.4 px over a width of half a window.
- Means over a Gaussian window are taken at a fraction of the size, which cannot be told from the full
  size and makes them nearly free.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Picture: TypeAlias = NDArray[np.float32]
Mask: TypeAlias = NDArray[np.bool_]

_STEPS = 2
_LARGEST_STEP_PX = 0.5
_START_WIDTH = 2.0
"""Width of the smoothing of the start, in widths of the window."""
_FAR_PX = 1.5
"""A disparity further than this from its smoothed surroundings is no part of a smooth surface."""
_SMOOTH_SHARE = 0.9
_NEAR_PX = 1.0
"""A refined value further than this from the matcher's own is trusted no more than the matcher."""
_REDUCED_SIGMA_PX = 2.5
_TINY = np.float32(1e-6)


def refine(
    left: Picture, right: Picture, disparity: Picture, sigma_px: float = 10.0, min_correlation: float = 0.35
) -> Picture:
    """Refine a disparity to sub-pixel precision on smooth surfaces.

    Parameters
    ----------
    left, right
        (rows, columns) float32, rectified; NaN outside.
    disparity
        (rows, columns) float32, pixels, NaN where unknown; good to about a pixel.
    sigma_px
        Standard deviation of the Gaussian window.
    min_correlation
        Correlation of the two windows below which there is no texture to trust. Pure noise reaches 0.2,
        a texture as weak as the noise 0.57.

    Returns
    -------
    numpy.ndarray
        (rows, columns) float32. NaN where `disparity` is NaN, where the windows do not correlate, and
        where refinement contradicts the matcher on a smooth surface. Beside steps of depth, where a window
        would mix two surfaces, the matcher's own value stays.
    """
    refined, smooth = _smooth_start(disparity, sigma_px)
    known_left, known_right = _well_inside(left), _well_inside(right)
    left = np.where(np.isfinite(left), left, np.float32(0))
    right = _same_contrast(np.where(np.isfinite(right), right, np.float32(0)), left)
    coefficients = _row_spline(right)
    columns = np.arange(left.shape[1], dtype=np.float32)
    for _ in range(_STEPS):
        warped, known_there = _sample_rows(coefficients, known_right, columns - refined)
        trusted = known_left & known_there
        step = _step(left, warped, trusted, sigma_px)
        refined = refined + step.clip(-_LARGEST_STEP_PX, _LARGEST_STEP_PX)
    # The last step is hundredths of a pixel: the pictures before it tell as well whether they correlate.
    correlated = _correlation(left, warped, trusted, sigma_px) >= min_correlation
    agrees = np.abs(refined - disparity) < _NEAR_PX
    chosen = np.where(agrees & smooth, refined, np.where(smooth, np.float32(np.nan), disparity))
    return np.where(correlated, chosen, np.float32(np.nan)).astype(np.float32, copy=False)


def _step(left: Picture, warped: Picture, trusted: Mask, sigma_px: float) -> Picture:
    """One Gauss-Newton step, pixels: shift (linear in x and y) and difference of level of each window."""
    gradient = np.asarray(cv2.filter2D(0.5 * (warped + left), -1, np.array([[-0.5, 0.0, 0.5]])), np.float32)
    gradient *= trusted
    difference = np.where(trusted, warped - left, np.float32(0))
    window = _Window(left.shape, sigma_px)
    one, g, gg, e, ge = (
        window.reduce(field)
        for field in (trusted, gradient, gradient * gradient, difference, gradient * difference)
    )
    moments = window.moments
    normal = _symmetric(moments(gg, 2), moments(g, 1), moments(one, 0))
    return window.enlarge(_first_unknown(normal, [*moments(ge, 1), *moments(e, 0)]))


def _correlation(left: Picture, warped: Picture, trusted: Mask, sigma_px: float) -> Picture:
    """1 - var(left - warped) / (var(left) + var(warped)) under each window: 1 for equal, 0 for unrelated."""
    window = _Window(left.shape, sigma_px)
    (share,) = window.moments(window.reduce(trusted), 0)

    def variance(field: Picture) -> Picture:
        field = np.where(trusted, field, np.float32(0))
        mean, square = (
            window.moments(window.reduce(power), 0)[0] / np.maximum(share, _TINY)
            for power in (field, field * field)
        )
        return np.asarray(square - mean * mean, np.float32)

    energy = variance(left) + variance(warped)
    # Half a thousandth of a count is no texture, however well it agrees.
    unlike = variance(warped - left) / np.maximum(energy, _TINY)
    return window.enlarge(np.where(energy > _TINY, 1.0 - unlike, np.float32(0)))


def _smooth_start(disparity: Picture, sigma_px: float) -> tuple[Picture, Mask]:
    """Smooth disparity without its outliers, and where it belongs to one smooth surface."""
    known = np.isfinite(disparity)
    wide = _Window(disparity.shape, _START_WIDTH * sigma_px)
    first = _local_plane(disparity, known, wide)
    near = known & (np.abs(np.where(known, disparity, np.float32(np.inf)) - first) < _FAR_PX)
    window = _Window(disparity.shape, sigma_px)
    among, of = (window.moments(window.reduce(mask), 0)[0] for mask in (near, known))
    smooth = window.enlarge(np.asarray(among / np.maximum(of, _TINY), np.float32)) > _SMOOTH_SHARE
    return _local_plane(disparity, near, wide), smooth


def _local_plane(values: Picture, mask: Mask, window: _Window) -> Picture:
    """Value of the plane through the masked values under each window; planes do not bend at edges."""
    one, v = window.reduce(mask), window.reduce(np.where(mask, values, np.float32(0)))
    level = v.sum() / max(float(one.sum()), 1.0)
    moments = window.moments
    normal = _symmetric(moments(one, 2))
    return window.enlarge(level + _first_unknown(normal, moments(v - level * one, 1)))


class _Window:
    """Gaussian windows over a picture, worked out at a fraction of its size."""

    def __init__(self, shape: tuple[int, ...], sigma_px: float) -> None:
        self._shape = shape
        reduction = max(1, int(sigma_px / _REDUCED_SIGMA_PX))
        self._size = (max(1, shape[1] // reduction), max(1, shape[0] // reduction))
        half = math.ceil(3.0 * sigma_px / reduction)
        t = np.arange(-half, half + 1) / (sigma_px / reduction)
        gauss = np.exp(-0.5 * t * t)
        self._kernels = [gauss / gauss.sum() * t**power for power in range(3)]

    def reduce(self, field: NDArray[Any]) -> Picture:
        """Mean over the cells of the smaller size."""
        plain = field.astype(np.float32, copy=False)
        return np.asarray(cv2.resize(plain, self._size, interpolation=cv2.INTER_AREA), np.float32)

    def enlarge(self, field: Picture) -> Picture:
        """Linear between the cells of the smaller size."""
        size = (self._shape[1], self._shape[0])
        return np.asarray(cv2.resize(field, size, interpolation=cv2.INTER_LINEAR), np.float32)

    def moments(self, field: Picture, degree: int) -> list[Picture]:
        """Moments of a reduced field about the middle of each window, up to a degree.

        In the order 1, x, y, xx, xy, yy, with x and y in widths of the window.
        """
        powers = [(total - j, j) for total in range(degree + 1) for j in range(total + 1)]
        return [
            np.asarray(
                cv2.sepFilter2D(
                    field, -1, self._kernels[i], self._kernels[j], borderType=cv2.BORDER_CONSTANT
                ),
                np.float32,
            )
            for i, j in powers
        ]


def _symmetric(
    quadratic: list[Picture], linear: list[Picture] | None = None, constant: list[Picture] | None = None
) -> NDArray[np.float64]:
    """Normal matrices (rows, columns, n, n) for 1, x, y and, where given, a level; slightly damped."""
    one, x, y, xx, xy, yy = quadratic
    lines = [[one, x, y], [x, xx, xy], [y, xy, yy]]
    if linear is not None and constant is not None:
        lines = [[*line, last] for line, last in zip(lines, linear, strict=True)] + [[*linear, *constant]]
    matrix = np.moveaxis(np.array(lines, np.float64), (0, 1), (-2, -1))
    count = matrix.shape[-1]
    # Windows with next to nothing in them must not divide by zero; elsewhere this changes nothing.
    trace = np.trace(matrix, axis1=-2, axis2=-1)[..., None]
    matrix[..., np.arange(count), np.arange(count)] += 1e-4 * trace / count + 1e-9
    return matrix


def _first_unknown(normal: NDArray[np.float64], right_side: list[Picture]) -> Picture:
    """Solve every window's equations and keep the value in its middle."""
    solved = np.linalg.solve(normal, np.stack(right_side, axis=-1)[..., None].astype(np.float64))
    return solved[..., 0, 0].astype(np.float32)


def _same_contrast(right: Picture, left: Picture) -> Picture:
    """Give the right picture the contrast of the left one: two cameras differ in gain."""
    fine = [np.std((picture - cv2.blur(picture, (31, 31)))[::2, ::2]) for picture in (left, right)]
    gain = fine[0] / fine[1] if fine[1] > 0 else 1.0
    return right * np.float32(gain)


def _well_inside(picture: Picture) -> Mask:
    """Pixels that a cubic spline reaches without touching what is outside."""
    finite = np.isfinite(picture)
    if not finite.all():
        finite = cv2.erode(finite.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    finite[:, :1] = finite[:, -1:] = False
    return finite


def _row_spline(picture: Picture) -> Picture:
    """Cubic B-spline coefficients along the rows."""
    from scipy.ndimage import spline_filter1d

    return np.asarray(spline_filter1d(picture, order=3, axis=1, output=np.float32, mode="mirror"), np.float32)


def _sample_rows(coefficients: Picture, known: Mask, columns: Picture) -> tuple[Picture, Mask]:
    """Cubic B-spline at fractional columns of each row, and whether the place is known.

    OpenCV's remap is no help: it knows only 1/32 of a pixel.
    """
    rows, width = coefficients.shape
    whole = np.floor(columns)
    t = columns - whole
    s = 1.0 - t
    outer = s * s * s / 6.0, t * t * t / 6.0
    inner = (4.0 + 3.0 * t * t * (t - 2.0)) / 6.0
    weights = (outer[0], inner, 1.0 - outer[0] - inner - outer[1], outer[1])
    first = whole.astype(np.int32) - 1
    row_start = (np.arange(rows, dtype=np.int32) * width)[:, None]
    flat = coefficients.ravel()
    sampled = np.zeros_like(columns)
    for tap, weight in enumerate(weights):
        sampled += weight * flat.take(row_start + np.clip(first + tap, 0, width - 1))
    inside = (first >= 0) & (first <= width - 4)
    there: Mask = inside & known.ravel().take(row_start + np.clip(first + 1, 0, width - 1))
    return sampled, there
