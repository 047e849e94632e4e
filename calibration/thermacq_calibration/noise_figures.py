"""Figures around the noise of a camera: signal transfer function (SiTF), NETD, spectra, uniformity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.noise import Noise3D

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
    from_mean = t - t.mean()
    spread = float(from_mean @ from_mean)
    slope = float(from_mean @ s) / spread
    residual = s - s.mean() - slope * from_mean
    error = math.sqrt(float(residual @ residual) / (len(t) - 2) / spread)
    if slope <= 0:
        raise CalibrationError(
            f"the mean level falls by {-slope:.3g} counts per kelvin",
            remedy="Check the temperature that is given with each run, and that each shows the uniform view.",
        )
    worst = float(np.abs(residual).max())
    return Sitf(slope, error, worst, tuple(t.tolist()), tuple(s.tolist()))


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


def large_scale_range(picture: Floats, bad_pixels: NDArray[np.bool_] | None = None) -> float:
    """Peak-to-peak range of a picture after a blur of 20 px (Gaussian), bad pixels left out."""
    import cv2

    sigma_px = 20.0
    good = np.ones(picture.shape, np.float32)
    if bad_pixels is not None:
        good[bad_pixels] = 0
    middle = float(np.median(picture))
    blurred, weight = (
        cv2.GaussianBlur(values, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT)
        for values in ((picture.astype(np.float32) - np.float32(middle)) * good, good)
    )
    return float(np.ptp(blurred / np.maximum(weight, 1e-3)))
