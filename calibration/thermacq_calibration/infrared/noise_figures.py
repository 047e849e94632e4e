"""Figures around the noise of a camera: signal transfer function (SiTF), NETD, non-uniformity, spectra."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.infrared.noise import Noise3D
from thermacq_calibration.infrared.radiometry import radiometric_scale

Floats = NDArray[np.float64]
FEWEST_TEMPERATURES = 3
_LEAST_SPAN_K = 1.0


@dataclass(frozen=True)
class Sitf:
    """Signal transfer function: slope of the mean level over the temperature of a uniform view.

    Parameters
    ----------
    counts_per_kelvin
        The slope.
    standard_error
        Of the slope, counts per kelvin; 0 when the slope was given.
    largest_residual_counts
        Of a mean level from the straight line; curvature shows here.
    temperatures_k, levels
        What it was fitted to; empty when the slope was given.
    """

    counts_per_kelvin: float
    standard_error: float = 0.0
    largest_residual_counts: float = 0.0
    temperatures_k: tuple[float, ...] = ()
    levels: tuple[float, ...] = ()


@dataclass(frozen=True)
class Figure:
    """A measured value with its standard error, in the same unit."""

    value: float
    standard_error: float


def fit_sitf(temperatures_k: Sequence[float], levels: Sequence[float]) -> Sitf:
    """Straight line through mean levels (counts) at three temperatures or more.

    Raises
    ------
    CalibrationError
        Fewer than three temperatures, or nearly equal ones; a value that is not finite; a level that does
        not rise with the temperature.
    """
    t, s = np.asarray(temperatures_k, np.float64), np.asarray(levels, np.float64)
    if t.shape != s.shape or t.ndim != 1 or not (np.isfinite(t).all() and np.isfinite(s).all()):
        raise CalibrationError("each temperature needs one mean level, and both must be finite")
    if len(np.unique(t)) < FEWEST_TEMPERATURES:
        raise CalibrationError(
            f"the slope of counts over temperature needs {FEWEST_TEMPERATURES} different temperatures, "
            f"there are {len(np.unique(t))}",
            remedy="Record the uniform view at further temperatures.",
        )
    if np.ptp(t) < _LEAST_SPAN_K:
        raise CalibrationError(
            f"the temperatures span only {np.ptp(t):.3g} K: noise would decide the slope",
            remedy=f"Let them span {_LEAST_SPAN_K:g} K or more.",
        )
    line = radiometric_scale(t.tolist(), s.tolist())
    residual = line.residual_k * line.counts_per_kelvin
    return Sitf(
        line.counts_per_kelvin, line.slope_error or 0.0, residual, tuple(t.tolist()), tuple(s.tolist())
    )


def in_kelvin(counts: float, freedom: float, sitf: Sitf) -> Figure:
    """A standard deviation in counts, of so many degrees of freedom, as kelvin.

    Its relative variance is 1 / (2 freedom) (of a normal sample) and that of the slope together.
    """
    value = counts / sitf.counts_per_kelvin
    relative = math.hypot(1 / math.sqrt(2 * max(1.0, freedom)), sitf.standard_error / sitf.counts_per_kelvin)
    return Figure(value, value * relative)


def netd(noise: Noise3D, sitf: Sitf) -> Figure:
    """Noise-equivalent temperature difference: sigma_tvh over the slope."""
    return in_kelvin(noise.tvh.sigma, _freedom(noise, "tvh"), sitf)


def netd_from_differences(noise: Noise3D, sitf: Sitf) -> Figure:
    """The NETD again, from differences of successive frames over sqrt(2); blind to drift and 1/f noise."""
    return in_kelvin(noise.high_frequency_tvh, _freedom(noise, "tvh"), sitf)


def residual_non_uniformity(noise: Noise3D, sitf: Sitf) -> Figure:
    """Residual non-uniformity: sigma_vh, freed of temporal noise, over the slope."""
    return in_kelvin(noise.vh.sigma, _freedom(noise, "vh"), sitf)


def _freedom(noise: Noise3D, name: str) -> float:
    freedom = {axis: count - 1 for axis, count in zip("tvh", noise.shape, strict=True)}
    return float(math.prod(freedom[axis] for axis in name))


def likeness_of_neighbours(picture: Floats) -> float:
    """Correlation of diagonal neighbours, once rows, columns and what is smooth over 20 px are taken out.

    The fixed pattern of a sensor is new in each pixel: about 0. What a lens has drawn is not: 0.3 and more.
    """
    import cv2

    left = picture - picture.mean(axis=1, keepdims=True) - (picture.mean(axis=0) - picture.mean())
    left = left - cv2.GaussianBlur(left, (0, 0), 8.5, borderType=cv2.BORDER_REFLECT)
    # A few bad pixels shall not decide.
    bound = 5 * float(np.median(np.abs(left)))
    left = np.clip(left, -bound, bound)
    square = float(np.mean(left**2))
    return float(np.mean(left[1:, 1:] * left[:-1, :-1])) / square if square > 0 else 0.0


def line_spectrum(picture: Floats, axis: int) -> tuple[Floats, Floats]:
    """One-sided power spectral density along rows (axis 1) or columns (axis 0), mean over all of them.

    Parameters
    ----------
    picture
        (rows, columns) float64.
    axis
        1: along rows, horizontal frequencies; 0: along columns, vertical ones.

    Returns
    -------
    frequency : numpy.ndarray
        Cycles per pixel, 0 left out.
    density : numpy.ndarray
        Squared unit of the picture per cycle per pixel; its integral is the variance along the line
        (periodogram with a Hann window, the mean of each line taken out).
    """
    lines = np.asarray(picture, np.float64)
    lines = lines if axis == 1 else lines.T
    count = lines.shape[1]
    window = np.hanning(count)
    changed = (lines - lines.mean(axis=1, keepdims=True)) * window
    density = 2 * np.mean(np.abs(np.fft.rfft(changed, axis=1)) ** 2, axis=0) / float(window @ window)
    if count % 2 == 0:
        density[-1] /= 2
    return np.arange(1, len(density)) / count, density[1:]
