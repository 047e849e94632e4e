"""Split a recording of a hand-held board into poses: stretches of frames in which nothing moves."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

_BLOCK = 4
# A change between frames this many times that of the quietest fifth of the recording is motion.
_MOTION_RATIO = 3.0
MIN_STILL_FRAMES = 4


def changes(pictures: Iterable[NDArray[Any]]) -> tuple[NDArray[np.float64], float]:
    """How much each frame differs from the one before it.

    Parameters
    ----------
    pictures
        (rows, columns) counts each, in the order of time; only two are held at once.

    Returns
    -------
    change : numpy.ndarray
        (frames - 1,) float64, counts: RMS difference of means over blocks of 4 x 4 pixels, which keep motion
        and drop pixel noise.
    noise : float
        What `change` can be at most when nothing moves: from the pixel noise of the first frame.
    """
    change: list[float] = []
    before: NDArray[np.float64] | None = None
    noise = 0.0
    for picture in pictures:
        now = _blocks(picture)
        if before is None:
            noise = np.sqrt(2) * pixel_noise(picture) / _BLOCK
        else:
            change.append(float(np.sqrt(np.mean((now - before) ** 2))))
        before = now
    return np.array(change), float(noise)


def still_stretches(change: NDArray[np.float64], noise: float) -> list[range]:
    """Stretches of at least `MIN_STILL_FRAMES` frames without motion, as ranges of frames."""
    if change.size == 0:
        return []
    limit = _MOTION_RATIO * min(float(np.percentile(change, 20)), noise)
    cuts = [-1, *np.flatnonzero(change > limit), change.size]
    stretches = [range(int(before) + 1, int(after) + 1) for before, after in pairwise(cuts)]
    return [stretch for stretch in stretches if len(stretch) >= MIN_STILL_FRAMES]


def pixel_noise(picture: NDArray[Any]) -> float:
    """Standard deviation of pixel noise in counts, from second differences that cancel smooth content."""
    values = np.asarray(picture, np.float64)
    rows = values[:, :-2] - 2 * values[:, 1:-1] + values[:, 2:]
    both = rows[:-2] - 2 * rows[1:-1] + rows[2:]
    # The 3 x 3 operator has a gain of 6 for white noise; 1.4826 turns a median deviation into sigma.
    return float(1.4826 * np.median(np.abs(both)) / 6)


def _blocks(picture: NDArray[Any]) -> NDArray[np.float64]:
    rows, columns = (length // _BLOCK * _BLOCK for length in picture.shape)
    tiles = np.asarray(picture[:rows, :columns]).reshape(rows // _BLOCK, _BLOCK, columns // _BLOCK, _BLOCK)
    means: NDArray[np.float64] = tiles.mean(axis=(1, 3), dtype=np.float64)
    return means
