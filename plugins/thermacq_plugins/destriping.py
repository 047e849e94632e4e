"""Destriping: fixed column (or row) noise taken away as offsets, at high spatial frequency only.

The profile of a picture is the mean of each column. A one-dimensional guided filter (the profile is its own
guide: He, Sun and Tang, PAMI 35:1397, 2013; used for stripes in Appl. Sci. 13:3890, 2023) keeps what is broad
or steep in it; what remains is narrow and weak, as stripes are. Narrow things of the scene look the same in one
picture, but they move and stripes do not. So profiles are averaged over the pictures of a short time, and only
of those in which the scene has moved since the last one that was counted; while nothing moves nothing is
taken away.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

_FEWEST_PROFILES = 2
_MAD_TO_SIGMA = 1.4826
_SPARSE = 8
"""Motion is looked for in every so-many-th row and column."""


class DestripingSettings(BaseModel):
    """Settings of stage ``destriping``."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    direction: Literal["columns", "rows"] = "columns"
    radius_px: int = Field(6, ge=1, le=100, description="reach of the filter: wider structure is kept")
    strength_counts: float = Field(
        3.0, gt=0, description="regularisation of the filter: stripes are weaker than this, edges stronger"
    )
    memory_pictures: int = Field(
        16,
        ge=0,
        le=200,
        description="pictures before this one whose profiles are averaged; 0: this one alone",
    )
    min_motion: float = Field(
        1.5,
        ge=0,
        description="change of the picture, over its noise, from which the scene counts as moved; 0: no gate",
    )


@dataclass(frozen=True)
class _Seen:
    """What is kept of a picture."""

    profile: NDArray[np.float32]
    sparse: NDArray[np.float32]
    noise: float


class Destriping:
    """The stage for one camera: a pure function of the picture and of the `memory_pictures` before it."""

    def __init__(self, settings: DestripingSettings) -> None:
        self._settings = settings
        self._seen: deque[_Seen] = deque(maxlen=settings.memory_pictures + 1)

    def __call__(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """Take stripes away, in place; see `thermacq.hooks.PictureCorrection`."""
        axis = 0 if self._settings.direction == "columns" else 1
        sparse = picture[::_SPARSE, ::_SPARSE].copy()
        self._seen.append(_Seen(self._profile(picture, axis), sparse, _noise(picture)))
        counted = self._counted()
        if len(counted) >= _FEWEST_PROFILES or self._settings.memory_pictures == 0:
            stripes = np.mean([seen.profile for seen in counted], axis=0, dtype=np.float32)
            picture -= np.expand_dims(stripes, axis)
        return picture

    def _profile(self, picture: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
        means: NDArray[np.float64] = picture.mean(axis=axis, dtype=np.float64)
        kept = guided_filter(means, self._settings.radius_px, self._settings.strength_counts**2)
        return (means - kept).astype(np.float32)

    def _counted(self) -> list[_Seen]:
        """The pictures each of which shows the scene moved since the one counted before it."""
        counted: list[_Seen] = []
        for seen in self._seen:
            if not counted or self._has_moved(counted[-1], seen):
                counted.append(seen)
        return counted

    def _has_moved(self, before: _Seen, now: _Seen) -> bool:
        if self._settings.min_motion == 0:
            return True
        change = _sigma(now.sparse - before.sparse) / np.sqrt(2)
        return bool(change >= self._settings.min_motion * now.noise)


def guided_filter(profile: NDArray[np.float64], radius: int, epsilon: float) -> NDArray[np.float64]:
    """Edge-preserving smoothing of a profile guided by itself.

    Parameters
    ----------
    profile
        (length,) float64.
    radius
        Half width of the window in elements.
    epsilon
        Variance within a window from which structure is kept rather than smoothed, in squared units.

    Returns
    -------
    numpy.ndarray
        (length,) float64: with local mean m and variance v it is mean(a) profile + mean(b), where
        a = v / (v + epsilon) and b = (1 - a) m.
    """
    mean = _box(profile, radius)
    variance = np.maximum(_box(profile**2, radius) - mean**2, 0.0)
    slope = variance / (variance + epsilon)
    smoothed: NDArray[np.float64] = _box(slope, radius) * profile + _box((1 - slope) * mean, radius)
    return smoothed


def _box(values: NDArray[np.float64], radius: int) -> NDArray[np.float64]:
    """Mean over a window that is cut off at the ends."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    place = np.arange(len(values))
    first, last = np.maximum(place - radius, 0), np.minimum(place + radius + 1, len(values))
    means: NDArray[np.float64] = (total[last] - total[first]) / (last - first)
    return means


def _noise(picture: NDArray[np.float32]) -> float:
    """Temporal noise of a pixel, from second differences along rows, which texture hardly has."""
    some = picture[::_SPARSE]
    second = some[:, 2:] - 2 * some[:, 1:-1] + some[:, :-2]
    return _sigma(second) / float(np.sqrt(6))


def _sigma(values: NDArray[np.float32]) -> float:
    """Standard deviation by the median absolute deviation."""
    return _MAD_TO_SIGMA * float(np.median(np.abs(values - np.median(values))))
