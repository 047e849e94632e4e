"""3-D noise of a sequence of pictures: seven components along time (t), rows (v) and columns (h).

D'Agostino & Webb, Proc. SPIE 1488 (1991), with the correction for finite samples of Haefner, Appl. Opt.
54:4907 (2015): each variance is freed of what the components below it leave in a mean of finitely many
values. One pass over the pictures, in memory of a few pictures whatever their number. Intervals are those
of Graybill and Wang (J. Am. Stat. Assoc. 75:869, 1980) for sums and differences of mean squares; for a
single mean square they are those of chi-square.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermacq_calibration.errors import CalibrationError

COMPONENTS = ("t", "v", "h", "tv", "th", "vh", "tvh")
"""Whole frames, fixed rows, fixed columns, rows and columns from frame to frame, fixed pixels, and the rest."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseComponent:
    """One component of 3-D noise, in the unit of the pictures.

    Parameters
    ----------
    variance
        Unbiased estimate; sampling may make it negative when the component is small or absent.
    low, high
        Confidence interval of the standard deviation.
    """

    variance: float
    low: float
    high: float

    @property
    def sigma(self) -> float:
        """Standard deviation; 0 where the variance came out negative."""
        return math.sqrt(max(0.0, self.variance))

    @property
    def is_negative(self) -> bool:
        """Whether the variance came out negative: the component is lost in the others."""
        return self.variance < 0


@dataclass(frozen=True)
class Noise3D:
    """3-D noise of a sequence, in the unit of its pictures.

    Parameters
    ----------
    shape
        (frames, rows, columns).
    bad_pixels
        Number of pixels left out.
    mean
        Mean over all good pixels and frames.
    confidence
        Of the intervals, e.g. 0.95.
    t, v, h, tv, th, vh, tvh
        The components, see `COMPONENTS`; `tvh` over the camera's counts per kelvin is the NETD, `vh` the
        residual non-uniformity.
    high_frequency_tvh
        Standard deviation of pixels from one frame to the next, over sqrt(2), rows and columns taken out:
        equal to that of `tvh` while nothing moves or drifts, and lower otherwise.
    """

    shape: tuple[int, int, int]
    bad_pixels: int
    mean: float
    confidence: float
    t: NoiseComponent
    v: NoiseComponent
    h: NoiseComponent
    tv: NoiseComponent
    th: NoiseComponent
    vh: NoiseComponent
    tvh: NoiseComponent
    high_frequency_tvh: float

    def component(self, name: str) -> NoiseComponent:
        """Component of a name in `COMPONENTS`."""
        found: NoiseComponent = getattr(self, name)
        return found

    @property
    def spatial_sigma(self) -> float:
        """Standard deviation over the picture, freed of temporal noise: fixed rows, columns and pixels."""
        return math.sqrt(max(0.0, self.v.variance + self.h.variance + self.vh.variance))


class NoiseAccumulator:
    """Takes pictures one at a time and keeps only sums of them.

    Parameters
    ----------
    bad_pixels
        (rows, columns) bool, pixels to leave out. In each picture they are given what their row and
        column have in common, which adds nothing to the noise of pixels; degrees of freedom are those of
        the good ones.
    """

    def __init__(self, bad_pixels: NDArray[np.bool_] | None = None) -> None:
        self._bad = bad_pixels if bad_pixels is not None and bad_pixels.any() else None
        self._frames = 0
        self._level = 0.0
        self._previous: Floats | None = None

    @property
    def frames(self) -> int:
        """Number of pictures taken so far."""
        return self._frames

    @property
    def mean_picture(self) -> Floats:
        """Mean over time, (rows, columns) float64."""
        self._require(1)
        mean: Floats = self._level + self._sum / self._frames
        return mean

    def add(self, picture: ArrayLike) -> float:
        """Take a picture (rows, columns) and return the mean of its good pixels.

        Raises
        ------
        CalibrationError
            It has another size than those before, or values that are not finite.
        """
        values = np.array(picture, np.float64)
        if values.ndim != 2 or min(values.shape) < 2:
            raise CalibrationError(f"a picture of at least 2 x 2 pixels is wanted, not {values.shape}")
        if not np.isfinite(values).all():
            raise CalibrationError(
                f"picture {self._frames} holds values that are not finite",
                remedy="Leave such pictures out, or name these pixels as bad and give them any number.",
            )
        if self._frames == 0:
            self._begin(values)
        if values.shape != self._sum.shape:
            raise CalibrationError(
                f"picture {self._frames} is {values.shape}, those before are {self._sum.shape}"
            )
        values -= self._level
        if self._bad is not None:
            _fill(values, self._bad)
        rows, columns = values.mean(axis=1), values.mean(axis=0)
        mean = float(rows.mean())
        self._sum += values
        self._squares += float(np.vdot(values, values))
        self._row_squares += float(rows @ rows)
        self._column_squares += float(columns @ columns)
        self._mean_squares += mean * mean
        self._mean_sum += mean
        if self._previous is not None:
            self._difference_squares += _interaction_squares(values - self._previous)
        self._previous = values
        self._frames += 1
        return self._level + mean

    def noise(self, confidence: float = 0.95) -> Noise3D:
        """Noise of the pictures taken so far.

        Raises
        ------
        CalibrationError
            There are fewer than 2 pictures, or hardly a good pixel.
        """
        self._require(2)
        times, (rows, columns) = self._frames, self._sum.shape
        bad = 0 if self._bad is None else int(self._bad.sum())
        vh_freedom = (rows - 1) * (columns - 1) - bad
        if vh_freedom < 1:
            raise CalibrationError(f"{bad} of {rows * columns} pixels are bad: too few are left")
        squares = self._mean_squares_by_component(vh_freedom)
        good = 1 - bad / (rows * columns)
        found = {
            name: _estimate([(weight, *squares[term]) for term, weight in weights], confidence)
            for name, weights in _weights(times, rows, columns, good).items()
        }
        steps = 2 * (times - 1) * vh_freedom
        return Noise3D(
            shape=(times, rows, columns),
            bad_pixels=bad,
            mean=self._level + self._mean_sum / times,
            confidence=confidence,
            **found,
            high_frequency_tvh=math.sqrt(self._difference_squares / steps),
        )

    def _begin(self, values: Floats) -> None:
        if self._bad is not None and self._bad.shape != values.shape:
            raise CalibrationError(
                f"the map of bad pixels is {self._bad.shape}, the pictures are {values.shape}",
                remedy="Use the map of this camera.",
            )
        good = values if self._bad is None else values[~self._bad]
        # Sums of squares are kept about this level, so that they lose no digits to a large offset.
        self._level = float(good.mean()) if good.size else 0.0
        self._sum = np.zeros_like(values)
        self._squares = self._row_squares = self._column_squares = 0.0
        self._mean_squares = self._mean_sum = self._difference_squares = 0.0

    def _require(self, frames: int) -> None:
        if self._frames < frames:
            raise CalibrationError(f"at least {frames} pictures are needed, there are {self._frames}")

    def _mean_squares_by_component(self, vh_freedom: int) -> dict[str, tuple[float, int]]:
        """Sample variance of the means over the other directions, and its degrees of freedom."""
        times, (rows, columns) = self._frames, self._sum.shape
        picture = self._sum / times
        mean = self._mean_sum / times
        row, column = picture.mean(axis=1) - mean, picture.mean(axis=0) - mean
        vh = float(np.sum((picture - mean - row[:, None] - column) ** 2))
        sum_v, sum_h = float(row @ row), float(column @ column)
        # Sums of squares about the mean of all, for one value per frame, or per row or column of a frame.
        sum_t = self._mean_squares - times * mean**2
        sum_tv = self._row_squares - rows * (times * mean**2 + sum_t) - times * sum_v
        sum_th = self._column_squares - columns * (times * mean**2 + sum_t) - times * sum_h
        rest = self._squares - times * rows * columns * mean**2
        rest -= rows * columns * sum_t + times * (columns * sum_v + rows * sum_h + vh)
        rest -= columns * sum_tv + rows * sum_th
        t, v, h = times - 1, rows - 1, columns - 1
        sums = {"t": sum_t, "v": sum_v, "h": sum_h, "tv": sum_tv, "th": sum_th, "vh": vh, "tvh": rest}
        freedom = {"t": t, "v": v, "h": h, "tv": t * v, "th": t * h, "vh": vh_freedom, "tvh": t * vh_freedom}
        return {name: (max(0.0, sums[name]) / freedom[name], freedom[name]) for name in COMPONENTS}


def noise_3d(
    pictures: Iterable[ArrayLike], bad_pixels: NDArray[np.bool_] | None = None, confidence: float = 0.95
) -> Noise3D:
    """3-D noise of at least two pictures of a uniform view, each (rows, columns).

    Raises
    ------
    CalibrationError
        See `NoiseAccumulator`.
    """
    accumulator = NoiseAccumulator(bad_pixels)
    for picture in pictures:
        accumulator.add(picture)
    return accumulator.noise(confidence)


def _weights(times: int, rows: int, columns: int, good: float) -> dict[str, list[tuple[str, float]]]:
    """Each component as a weighted sum of sample variances; `good` is the share of good pixels."""
    of_row, of_column, of_picture = 1 / (columns * good), 1 / (rows * good), 1 / (rows * columns * good)
    return {
        "t": [("t", 1.0), ("tv", -1 / rows), ("th", -1 / columns), ("tvh", of_picture)],
        "v": [("v", 1.0), ("tv", -1 / times), ("vh", -of_row), ("tvh", of_row / times)],
        "h": [("h", 1.0), ("th", -1 / times), ("vh", -of_column), ("tvh", of_column / times)],
        "tv": [("tv", 1.0), ("tvh", -of_row)],
        "th": [("th", 1.0), ("tvh", -of_column)],
        "vh": [("vh", 1.0), ("tvh", -1 / times)],
        "tvh": [("tvh", 1.0)],
    }


def _estimate(terms: Sequence[tuple[float, float, int]], confidence: float) -> NoiseComponent:
    """Weighted sum of mean squares (weight, mean square, degrees of freedom), with its interval."""
    from scipy.stats import chi2

    tail = (1 - confidence) / 2
    variance = sum(weight * square for weight, square, _ in terms)
    below = above = 0.0
    for weight, square, freedom in terms:
        narrow = 1 - freedom / float(chi2.ppf(1 - tail, freedom))
        wide = freedom / float(chi2.ppf(tail, freedom)) - 1
        down, up = (narrow, wide) if weight > 0 else (wide, narrow)
        below += (down * weight * square) ** 2
        above += (up * weight * square) ** 2
    low, high = variance - math.sqrt(below), variance + math.sqrt(above)
    return NoiseComponent(variance, math.sqrt(max(0.0, low)), math.sqrt(max(0.0, high)))


def _fill(values: Floats, bad: NDArray[np.bool_]) -> None:
    """Give bad pixels the sum of what the good ones of their row and of their column show, in place."""
    values[bad] = 0.0
    good = ~bad
    total = good.sum()
    mean = values.sum() / max(1, total)
    row = _part_mean(values.sum(axis=1), good.sum(axis=1), mean)
    column = _part_mean(values.sum(axis=0), good.sum(axis=0), mean)
    at_row, at_column = np.nonzero(bad)
    values[bad] = row[at_row] + column[at_column] - mean


def _part_mean(sums: Floats, counts: NDArray[np.int_], mean: float) -> Floats:
    """Means of rows or columns; of those without a good pixel the mean of all."""
    return np.where(counts > 0, sums / np.maximum(1, counts), mean)


def _interaction_squares(values: Floats) -> float:
    """Sum of squares once means of rows and columns are taken out."""
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    left: Floats = values - rows[:, None] - (columns - rows.mean())
    return float(np.vdot(left, left))
