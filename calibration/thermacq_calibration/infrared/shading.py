"""Shading: smooth non-uniformity that follows the camera's temperature, as a low-order surface.

It comes from the camera's own radiation (housing seen through the lens, reflections of the sensor) and is
found from a uniform view, never from the scene: lamps make real gradients on water.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.infrared.correction import CameraCorrection, Picture
from thermacq_calibration.infrared.nonuniformity import with_outliers
from thermacq_calibration.infrared.reference_view import ReferenceView
from thermacq_calibration.infrared.uniformity import correct_mean

DEGREE = 4
SMALLEST_WARMING_K = 0.5
"""Over less, what was seen says little about how it grows with the temperature of the camera."""


def with_shading(correction: CameraCorrection, view: ReferenceView) -> CameraCorrection:
    """The correction with its shading replaced by that of a uniform view.

    If the camera was warmer or colder by at least `SMALLEST_WARMING_K` than in the views behind the offsets,
    shading is taken to grow linearly from none there. Otherwise it counts as constant.

    Parameters
    ----------
    correction
        The record so far; its own shading is not used.
    view
        A uniform view before the lens, that did not go into the offsets.

    Raises
    ------
    CalibrationError
        The view has another size, the picture is too small, or too many pixels are bad.
    """
    without = replace(correction, shading=None, shading_temperature_k=None, shading_zero_k=None)
    pattern = low_order_surface(correct_mean(without, view))
    pattern -= pattern.mean(dtype=np.float64)
    zero_k, seen_k = correction.fpa_temperature_k, view.fpa_temperature_k
    grows = zero_k is not None and seen_k is not None and abs(seen_k - zero_k) >= SMALLEST_WARMING_K
    shaded = replace(
        correction,
        shading=pattern,
        shading_temperature_k=seen_k,
        shading_zero_k=zero_k if grows else None,
        made_from={**correction.made_from, "shading_view": view.facts},
    )
    return with_outliers(shaded, view)


def low_order_surface(picture: Picture) -> Picture:
    """Least-squares polynomial through a picture, in both directions together up to degree 4.

    Light fall-off (cos^4) has its slope at the borders, where cosines, the other common choice, have none:
    6 x 6 terms of a discrete cosine transform leave ten times as much of it.

    Parameters
    ----------
    picture
        (rows, columns) float32, bad pixels replaced.

    Returns
    -------
    numpy.ndarray
        (rows, columns) float32.

    Raises
    ------
    CalibrationError
        The picture is too small.
    """
    terms = DEGREE + 1
    if min(picture.shape) < 2 * terms:
        raise CalibrationError("a picture of so few pixels has no shading to speak of")
    down, across = (_polynomials(count, terms) for count in picture.shape)
    weights = down.T @ picture.astype(np.float64) @ across
    weights[np.add.outer(np.arange(terms), np.arange(terms)) > DEGREE] = 0
    fitted: Picture = (down @ weights @ across.T).astype(np.float32)
    return fitted


def _polynomials(count: int, terms: int) -> NDArray[np.float64]:
    """Polynomials orthonormal on evenly spaced points: (count, terms)."""
    powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, count), terms - 1)
    return np.linalg.qr(powers)[0]
