"""A uniform view (blackbody, shutter, cap) as the temporal statistics of its frames, in one pass.

Memory is that of a few pictures however many frames there are.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.infrared.correction import Picture

FEWEST_FRAMES = 16
BLOCK_FRAMES = 16
"""Frames whose mean is compared with the next mean to see a pixel jump."""

_LARGEST_STUCK_SHARE = 0.01
# Noise and pattern spread the pixels of a working sensor over many counts.
_CONSTANT_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class ReferenceView:
    """What a stack of frames of a uniform view says about each pixel; make it with `observe`.

    Parameters
    ----------
    mean
        (rows, columns) float32, temporal mean, counts.
    noise
        (rows, columns) float32, temporal standard deviation, counts; what all pixels do together is taken
        out.
    jump
        (rows, columns) float32, counts: the largest step between means of consecutive blocks of
        `BLOCK_FRAMES` frames, likewise; 0 where there are fewer than two blocks.
    frames
        How many frames went in.
    temperature_k
        Apparent temperature of the view; None where it is not known.
    fpa_temperature_k
        Temperature of the camera meanwhile; None where it is not known.
    name
        Where the frames came from, for messages and for the record.
    """

    mean: Picture
    noise: Picture
    jump: Picture
    frames: int
    temperature_k: float | None = None
    fpa_temperature_k: float | None = None
    name: str = ""

    @property
    def label(self) -> str:
        """How messages call it."""
        temperature = "" if self.temperature_k is None else f" at {self.temperature_k:g} K"
        return f"view {self.name}{temperature}" if self.name else f"the view{temperature}"

    @property
    def facts(self) -> dict[str, Any]:
        """Plain values for the record that is made from it."""
        return {
            "name": self.name,
            "frames": self.frames,
            "temperature_k": self.temperature_k,
            "fpa_temperature_k": self.fpa_temperature_k,
            "mean_counts": float(self.mean.mean(dtype=np.float64)),
            "noise_counts": float(np.median(self.noise)),
        }


def observe(
    frames: Iterable[NDArray[Any]],
    temperature_k: float | None = None,
    fpa_temperature_k: float | None = None,
    name: str = "",
) -> ReferenceView:
    """Statistics of a stack of frames of one uniform view.

    Frames that repeat the one before bit by bit are left out: so do cameras while their shutter is closed.

    Parameters
    ----------
    frames
        (rows, columns) uint16 or float, raw counts, in the order of time.
    temperature_k, fpa_temperature_k, name
        See `ReferenceView`.

    Raises
    ------
    CalibrationError
        Fewer than `FEWEST_FRAMES` different frames, frames of different sizes or not finite, or more than
        1 % of the pixels never change, as saturated ones do.
    """
    what = f"view {name}" if name else "the view"
    for key, value in (("temperature", temperature_k), ("temperature of the camera", fpa_temperature_k)):
        if value is not None and not 100 < value < 5000:
            raise CalibrationError(f"{what} has a {key} of {value:g} K", remedy="Give it in kelvin.")
    statistics: _Statistics | None = None
    repeats = 0
    for number, frame in enumerate(frames):
        picture = np.asarray(frame)
        _check_frame(picture, None if statistics is None else statistics.shape, f"frame {number} of {what}")
        if statistics is None:
            statistics = _Statistics(picture)
        elif np.array_equal(picture, statistics.last):
            repeats += 1
            continue
        statistics.add(picture)
    if statistics is None or statistics.frames < FEWEST_FRAMES:
        count = 0 if statistics is None else statistics.frames
        if statistics is not None:
            _refuse_constant(statistics.last, what)
        raise CalibrationError(
            f"{what} has {count} different frame{'s' * (count != 1)}, fewer than {FEWEST_FRAMES}"
            + (f"; {repeats} more only repeat the one before" if repeats else ""),
            remedy="Record at least a second of it with the shutter open; 64 frames or more are better.",
        )
    stuck = statistics.never_changed
    if stuck.mean() > _LARGEST_STUCK_SHARE:
        raise CalibrationError(
            f"{stuck.mean():.1%} of the pixels of {what} never change; most stand at "
            f"{np.median(statistics.last[stuck]):g} counts: they are saturated, or the noise is below one count",
            remedy="Change the camera's range, or the temperature of the view, and record it again.",
        )
    return ReferenceView(*statistics.result(), statistics.frames, temperature_k, fpa_temperature_k, name)


def _check_frame(picture: NDArray[Any], shape: tuple[int, ...] | None, what: str) -> None:
    if picture.ndim != 2 or not picture.size or picture.dtype.kind not in "uif":
        raise CalibrationError(f"{what} is not a picture of counts")
    if shape is not None and picture.shape != shape:
        raise CalibrationError(
            f"{what} has {picture.shape[0]} x {picture.shape[1]} pixels, those before {shape[0]} x {shape[1]}",
            remedy="Give frames of one camera in one format.",
        )
    if picture.dtype.kind == "f" and not np.isfinite(picture).all():
        raise CalibrationError(
            f"{what} holds values that are not finite", remedy="Give raw counts, without gaps."
        )


def _refuse_constant(picture: NDArray[Any], what: str) -> None:
    level = np.median(picture)
    part = float(np.mean(picture == level))
    if part > _CONSTANT_SHARE:
        raise CalibrationError(
            f"the pictures of {what} are constant: {part:.0%} of the pixels have the count {level:g}",
            remedy="They are saturated, or the sensor does not work: look at the camera's range and cable, and "
            "record the view again.",
        )


class _Statistics:
    """Sums over frames. Each is taken relative to the first frame, so that float32 steps are exact enough."""

    def __init__(self, first: NDArray[Any]) -> None:
        self.shape = first.shape
        self.frames = 0
        self.last = first
        self.never_changed = np.ones(self.shape, bool)
        self._first = first.astype(np.float32)
        self._level = 0.0
        self._stride = max(1, min(self.shape) // 64)
        self._sum = np.zeros(self.shape, np.float64)
        self._squares = np.zeros(self.shape, np.float64)
        self._block = np.zeros(self.shape, np.float32)
        self._last_block: Picture | None = None
        self._jump = np.zeros(self.shape, np.float32)

    def add(self, picture: NDArray[Any]) -> None:
        self.never_changed &= picture == self.last
        above = picture.astype(np.float32)
        above -= self._first
        # What the whole picture does, drift or noise of frames, is no pixel's own. The median: bad pixels
        # do not move it.
        level = float(np.median(above[:: self._stride, :: self._stride]))
        above -= np.float32(level)
        self._level += level
        self._sum += above
        self._block += above
        above *= above
        self._squares += above
        self.frames += 1
        self.last = picture.copy()
        if self.frames % BLOCK_FRAMES == 0:
            self._close_block()

    def _close_block(self) -> None:
        self._block /= BLOCK_FRAMES
        if self._last_block is not None:
            np.maximum(self._jump, np.abs(self._block - self._last_block), out=self._jump)
        self._last_block, self._block = self._block, np.zeros(self.shape, np.float32)

    def result(self) -> tuple[Picture, Picture, Picture]:
        """Mean, noise and jump of each pixel."""
        mean = self._sum / self.frames
        variance = (self._squares - self.frames * mean**2) / (self.frames - 1)
        mean += self._first
        mean += self._level / self.frames
        return mean.astype(np.float32), np.sqrt(np.maximum(variance, 0)).astype(np.float32), self._jump
