"""From counts to the 8-bit pictures that detectors take, and what makes a picture unusable."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

# A picture with so many pixels at one end of its range is called saturated when no board is found in it.
_SATURATED_PART = 0.2

Bytes: TypeAlias = NDArray[np.uint8]


def unusable(picture: NDArray[Any]) -> str:
    """Why a picture cannot hold a board at all; empty when it may."""
    if picture.ndim != 2 or min(picture.shape) < 32:
        return f"no picture: its shape is {picture.shape}"
    if not np.isfinite(picture).all():
        return f"{np.mean(~np.isfinite(picture)):.1%} of the pixels are not numbers"
    low, high = np.percentile(picture, (1, 99))
    if low == high:
        same = np.mean(picture == low)
        return f"the picture is constant: {same:.1%} of the pixels have the count {low:g}"
    return ""


def saturation(picture: NDArray[Any]) -> str:
    """What is to be said about counts at the ends of their range; empty when nothing is."""
    for name, end in (("largest", picture.max()), ("smallest", picture.min())):
        part = np.mean(picture == end)
        if part > _SATURATED_PART:
            return f"saturated: {part:.0%} of the pixels have the {name} count, {end:g}"
    return ""


def stretch(picture: NDArray[Any]) -> Bytes:
    """Percentiles 1 and 99 to 0 and 255. Dividing 16 bit by 256 would leave a thermal board 2 grey levels."""
    values = np.asarray(picture, np.float32)
    low, high = np.percentile(values, (1, 99))
    stretched: Bytes = np.rint(np.clip((values - low) / (high - low), 0, 1) * 255).astype(np.uint8)
    return stretched
