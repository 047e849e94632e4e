"""Judges a correction by a uniform view: what non-uniformity is left."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.infrared.correction import CameraCorrection, Picture
from thermacq_calibration.infrared.corrector import Corrector
from thermacq_calibration.infrared.reference_view import ReferenceView

LARGE_SCALE_PX = 20.0


@dataclass(frozen=True)
class Uniformity:
    """How uniform a uniform view is after correction; an honest figure if the view did not go into it.

    Parameters
    ----------
    temperature_k
        Of the view; None where it is not known.
    noise_counts
        Median temporal standard deviation of a corrected pixel, the NETD in counts.
    sigma_vh_counts, sigma_v_counts, sigma_h_counts
        Spatial standard deviations of pixels, rows and columns as 3-D noise names them, pixels freed of
        temporal noise: sqrt(s² - sigma_t² / N).
    spatial_counts
        Of all three together, with what is smooth.
    large_scale_counts
        Peak to peak after a Gaussian blur of `LARGE_SCALE_PX` full width at half maximum.
    counts_per_kelvin
        Scale of the record; None where it is not known.
    per_cent
        `spatial_counts` over the mean counts, in per cent; the mean holds the camera's arbitrary offset.
    level_error_k
        Mean temperature by the radiometric scale less the true one; None where either is not known.
    """

    temperature_k: float | None
    noise_counts: float
    sigma_vh_counts: float
    sigma_v_counts: float
    sigma_h_counts: float
    spatial_counts: float
    large_scale_counts: float
    counts_per_kelvin: float | None
    per_cent: float
    level_error_k: float | None

    @property
    def sigma_vh_per_netd(self) -> float:
        """`sigma_vh_counts` over the temporal noise."""
        return self.sigma_vh_counts / self.noise_counts

    def kelvin(self, counts: float) -> float | None:
        """A difference of counts in kelvin; None where the scale is not known."""
        return None if self.counts_per_kelvin is None else counts / self.counts_per_kelvin

    def as_dict(self) -> dict[str, float | None]:
        """Plain values."""
        return asdict(self)


def uniformity(correction: CameraCorrection, view: ReferenceView) -> Uniformity:
    """Judge a correction by a uniform view.

    Raises
    ------
    CalibrationError
        The view has another size than the correction.
    """
    corrected = correct_mean(correction, view)
    good = correction.bad_pixels == 0
    noise = float(np.median((correction.gain * view.noise)[good]))
    # Noise differs between pixels; its mean square is what the spatial variance holds of it.
    left = float(np.mean(np.square((correction.gain * view.noise)[good], dtype=np.float64))) / view.frames
    mean = float(corrected[good].mean(dtype=np.float64))
    rows, columns = (corrected.mean(axis=axis, dtype=np.float64) - mean for axis in (1, 0))
    pixels = (corrected - mean - rows[:, None] - columns)[good]
    per_k, level_error_k = correction.counts_per_kelvin, None
    if view.temperature_k is not None and per_k is not None and correction.kelvin_at_zero is not None:
        level_error_k = correction.kelvin_at_zero + mean / per_k - view.temperature_k
    spatial = _freed(corrected[good], left)
    return Uniformity(
        temperature_k=view.temperature_k,
        noise_counts=noise,
        sigma_vh_counts=_freed(pixels, left),
        sigma_v_counts=float(rows.std()),
        sigma_h_counts=float(columns.std()),
        spatial_counts=spatial,
        large_scale_counts=large_scale(corrected),
        counts_per_kelvin=per_k,
        per_cent=100 * spatial / abs(mean),
        level_error_k=level_error_k,
    )


def correct_mean(correction: CameraCorrection, view: ReferenceView) -> Picture:
    """Temporal mean of a view, corrected with all stages: (rows, columns) float32 counts."""
    temperature_k = math.nan if view.fpa_temperature_k is None else view.fpa_temperature_k
    return Corrector(correction)(view.mean, temperature_k)


def large_scale(corrected: Picture) -> float:
    """Peak to peak of a (rows, columns) float32 picture after a Gaussian blur of `LARGE_SCALE_PX`."""
    import cv2

    sigma_px = LARGE_SCALE_PX / (2 * math.sqrt(2 * math.log(2)))
    return float(np.ptp(cv2.GaussianBlur(corrected, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)))


def _freed(values: NDArray[np.floating], temporal_variance: float) -> float:
    """Standard deviation of values without what temporal noise left in their means."""
    return math.sqrt(max(0.0, float(values.astype(np.float64).var()) - temporal_variance))
