"""Reading pictures between pixels, and places on a flat board through its homography."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Float

_RANSAC_PX = 3.0


def sample(picture: NDArray[Any], pixels: Float) -> Float:
    """Counts at pixels (..., 2), bilinear; outside the picture those of its border."""
    import cv2

    u, v = np.nan_to_num(pixels, nan=-1.0).astype(np.float32).reshape(-1, 2).T
    source = np.asarray(picture, np.float32)
    # OpenCV wants less than 2^15 places in a row.
    parts = [slice(first, first + 30_000) for first in range(0, u.size, 30_000)]
    values = [
        cv2.remap(source, u[None, part], v[None, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in parts
    ]
    return np.concatenate([np.empty((1, 0)), *values], axis=1).astype(np.float64).reshape(pixels.shape[:-1])


def fit_homography(places: Float, pixels: Float) -> Float | None:
    """Homography (3, 3) from places on a board to pixels, without outliers; None when there is none."""
    import cv2

    homography: Any = cv2.findHomography(places, pixels, cv2.RANSAC, _RANSAC_PX)[0]
    return None if homography is None else np.asarray(homography, np.float64)


def project(homography: Float, places: Float) -> Float:
    """Pixels (..., 2) of places (..., 2) on the board."""
    mapped = places @ homography[:, :2].T + homography[:, 2]
    projected: Float = mapped[..., :2] / mapped[..., 2:]
    return projected
