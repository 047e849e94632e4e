"""Search for bad pixels: dead, noisy, blinking, outlying.

The limits follow Budzier and Gerlach, J. Sens. Sens. Syst. 4:187 (2015), and the usual six median absolute
deviations (MAD). Medians over the picture stand for means of good pixels, as bad ones do not move them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.infrared.correction import BadPixel, Picture
from thermacq_calibration.infrared.reference_view import ReferenceView

SMALLEST_RESPONSE = 0.5
SMALLEST_NOISE = 0.2
LARGEST_NOISE = 2.0
LARGEST_DEVIATION_MAD = 6.0
_MAD_OF_NORMAL = 0.6745
_MEAN_DEVIATION_OF_NORMAL = 0.7979
_CLIP_MAD = 6.0
_SURROUNDINGS_PX = 65

Mask = NDArray[np.uint8]


def dead_pixels(response: Picture) -> Mask:
    """Pixels that respond with less than half of what the others do.

    Parameters
    ----------
    response
        (rows, columns), counts between two uniform views.

    Returns
    -------
    numpy.ndarray
        (rows, columns) uint8, `BadPixel.DEAD` or 0. So do all functions here with their own bit.
    """
    return _mask(response < SMALLEST_RESPONSE * np.median(response), BadPixel.DEAD)


def stuck_pixels(view: ReferenceView) -> Mask:
    """Pixels with less than a fifth of the temporal noise of the others: they show next to nothing."""
    return _mask(view.noise < SMALLEST_NOISE * np.median(view.noise), BadPixel.DEAD)


def noisy_pixels(view: ReferenceView) -> Mask:
    """Pixels with more than twice the temporal noise of the others."""
    return _mask(view.noise > LARGEST_NOISE * np.median(view.noise), BadPixel.NOISY)


def blinking_pixels(view: ReferenceView) -> Mask:
    """Pixels whose level steps by more than six MAD of a pixel's temporal noise.

    The step is that between means of blocks of frames, not between frames: for normal noise six MAD of the
    difference of two frames are 4.05 standard deviations, which one pixel in twenty exceeds within 1000
    frames. Between means of 16 frames the limit is more than 11 of their standard deviations.
    """
    limit = LARGEST_DEVIATION_MAD * _MAD_OF_NORMAL * np.median(view.noise)
    return _mask(view.jump > limit, BadPixel.BLINKING)


def outlying_pixels(corrected: Picture, known: Mask) -> Mask:
    """Pixels that differ from the median of the 5 x 5 around by more than six MAD of such differences.

    What a whole row or column has in common is no fault of its pixels and taken out. The MAD is that of the
    wider surroundings, by way of their clipped mean deviation: noise and residual curvature differ between
    the middle and the corners of a picture, where the lens lets less through. Of good pixels with normal
    noise about one in 10000 lies beyond the limit.

    Parameters
    ----------
    corrected
        (rows, columns) float32, a uniform view after correction, with bad pixels found earlier replaced.
    known
        (rows, columns) uint8, those; not judged again.
    """
    import cv2

    difference = corrected - cv2.medianBlur(corrected, 5)
    difference -= np.median(difference, axis=0)
    difference -= np.median(difference, axis=1, keepdims=True)
    deviation = np.abs(difference)
    clipped = np.minimum(deviation, _CLIP_MAD * np.median(deviation[known == 0]))
    width = min(_SURROUNDINGS_PX, *corrected.shape)
    around = cv2.blur(clipped, (width, width), borderType=cv2.BORDER_REFLECT_101)
    is_far = deviation > LARGEST_DEVIATION_MAD * _MAD_OF_NORMAL / _MEAN_DEVIATION_OF_NORMAL * around
    return _mask(is_far & (known == 0), BadPixel.OUTLIER)


def _mask(is_bad: NDArray[np.bool_], reason: BadPixel) -> Mask:
    return np.where(is_bad, np.uint8(reason), np.uint8(0))
