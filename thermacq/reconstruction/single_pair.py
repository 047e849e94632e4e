"""One pair by itself: its disparity, its point cloud in the left camera, disparity files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError, StoreError
from thermacq.reconstruction.matching import PairReader, make_matcher
from thermacq.reconstruction.mean_surface import points_of
from thermacq.reconstruction.point_cloud import write_ply
from thermacq.reconstruction.source import Source


@dataclass(frozen=True)
class MatchedPair:
    """One matched pair.

    Parameters
    ----------
    left, right
        (rows, columns) float32, rectified pictures in counts, NaN outside.
    disparity
        (rows, columns) float32, pixels, NaN where there is no match.
    points
        (rows, columns, 3) float64, metres, left rectified camera: x right, y down, z forward.
    """

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    disparity: NDArray[np.float32]
    points: NDArray[np.float64]


def match_pair(source: Source, index: int = 0) -> MatchedPair:
    """Rectify and match one pair of a source.

    Raises
    ------
    ReconstructionError
        The matcher found nothing.
    """
    with PairReader(source.run_path, source.calibration, source.pairs, source.corrections) as reader:
        left, right = reader.read(index)
    disparity = make_matcher(source.matcher, source.settings).match(left, right)
    if not np.isfinite(disparity).any():
        raise ReconstructionError(
            f"matcher '{source.matcher}' found nothing in this pair of '{source.run_path}'",
            remedy="Its settings may not suit the picture: look at the range of disparity and the texture.",
        )
    return MatchedPair(left, right, disparity, points_of(disparity, source.rectification))


def write_cloud(pair: MatchedPair, path: Path) -> int:
    """Write the point cloud of a pair as PLY, shaded by the left picture; returns the number of points.

    Raises
    ------
    StoreError
        The file cannot be written.
    """
    low, high = np.nanpercentile(pair.left, (1.0, 99.0))
    grey = np.nan_to_num((pair.left - low) / max(float(high - low), 1e-9)).clip(0.0, 1.0)
    shade = np.repeat((255 * grey).astype(np.uint8)[..., None], 3, axis=2)
    try:
        return write_ply(path, pair.points, shade)
    except OSError as error:
        raise StoreError(f"'{path}' cannot be written: {error.strerror}") from None


def save_disparity(path: Path, disparity: NDArray[np.float32]) -> None:
    """Write a disparity map as compressed NPZ, array ``disparity``.

    Raises
    ------
    StoreError
        The file cannot be written.
    """
    try:
        with path.open("xb") as file:
            np.savez_compressed(file, disparity=disparity)
    except OSError as error:
        raise StoreError(f"'{path}' cannot be written: {error.strerror}") from None


def load_disparity(path: Path) -> NDArray[np.float64]:
    """Known disparity from NPY, or from NPZ with an array ``disparity`` or a single array.

    Returns
    -------
    numpy.ndarray
        (rows, columns) float64, pixels; infinite where unknown stays so.

    Raises
    ------
    StoreError
        The file is missing or holds no such array.
    """
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            array = loaded
        else:
            with loaded:
                names = list(loaded.files)
                if "disparity" not in names and len(names) != 1:
                    raise ValueError(f"it holds {', '.join(names) or 'nothing'}, and no 'disparity'")
                array = loaded["disparity" if "disparity" in names else names[0]]
        if array.ndim != 2 or array.dtype.kind not in "fiu":
            raise ValueError(f"it holds a {array.ndim}-dimensional array of {array.dtype}")
    except FileNotFoundError:
        raise StoreError(f"there is no file '{path}'") from None
    except Exception as error:
        raise StoreError(f"'{path}' holds no disparity map: {error}") from None
    return array.astype(np.float64)
