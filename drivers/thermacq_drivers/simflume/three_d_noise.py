"""3-D noise of a sequence of pictures: its seven components along time (t), rows (v) and columns (h).

D'Agostino & Webb 1991 with the correction of Haefner, Appl. Opt. 54:4907: each variance is freed of what the
components below it leave in a mean of finitely many values. One pass, in memory of a few pictures.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from thermacq_drivers.simflume.surfaces import Floats


@dataclass(frozen=True)
class NoiseComponents:
    """Variances by component, in squared units of the pictures; sampling may make small ones negative.

    Parameters
    ----------
    t, v, h
        Of whole frames, fixed rows, fixed columns.
    tv, th, vh
        Of rows from frame to frame, of columns from frame to frame, of fixed pixels.
    tvh
        Of pixels from frame to frame; its root over the camera's counts per kelvin is the NETD.
    """

    t: float
    v: float
    h: float
    tv: float
    th: float
    vh: float
    tvh: float

    def deviation(self, component: str) -> float:
        """Standard deviation of one component; 0 where the variance came out negative."""
        variance: float = getattr(self, component)
        return math.sqrt(max(0.0, variance))


def noise_components(pictures: Iterable[ArrayLike]) -> NoiseComponents:
    """Components of the noise of at least two pictures of a uniform view, each (rows, columns)."""
    row_means, column_means, squares, count = [], [], 0.0, 0
    level, total = 0.0, np.zeros(())
    for picture in pictures:
        values = np.asarray(picture, np.float64)
        if not count:
            level, total = float(values.mean()), np.zeros(values.shape)
        values = values - level
        total += values
        squares += float(np.sum(values * values))
        row_means.append(values.mean(axis=1))
        column_means.append(values.mean(axis=0))
        count += 1
    return _components(np.array(row_means), np.array(column_means), total / count, squares)


def _components(tv: Floats, th: Floats, vh: Floats, squares: float) -> NoiseComponents:
    """Components from the means over columns, rows and time, and the total sum of squares."""
    (times, rows), columns = tv.shape, th.shape[1]
    mean = float(vh.mean())
    effect_t, effect_v, effect_h = tv.mean(axis=1) - mean, vh.mean(axis=1) - mean, vh.mean(axis=0) - mean
    effect_tv = tv - mean - effect_t[:, None] - effect_v
    effect_th = th - mean - effect_t[:, None] - effect_h
    effect_vh = vh - mean - effect_v[:, None] - effect_h
    t, v, h = times - 1, rows - 1, columns - 1
    sums = [float(np.sum(e**2)) for e in (effect_t, effect_v, effect_h, effect_tv, effect_th, effect_vh)]
    weights = (rows * columns, times * columns, times * rows, columns, rows, times)
    rest = squares - times * rows * columns * mean**2 - float(np.dot(sums, weights))
    s_t, s_v, s_h = sums[0] / t, sums[1] / v, sums[2] / h
    tvh = rest / (t * v * h)
    var_tv = sums[3] / (t * v) - tvh / columns
    var_th = sums[4] / (t * h) - tvh / rows
    var_vh = sums[5] / (v * h) - tvh / times
    return NoiseComponents(
        t=s_t - var_tv / rows - var_th / columns - tvh / (rows * columns),
        v=s_v - var_tv / times - var_vh / columns - tvh / (times * columns),
        h=s_h - var_th / times - var_vh / rows - tvh / (times * rows),
        tv=var_tv,
        th=var_th,
        vh=var_vh,
        tvh=tvh,
    )
