"""What a lens does to the picture: blur, light fall-off, and the reflected image of the warm sensor.

The blur's transfer function along an axis is the product of diffraction at a circular pupil, the
geometric disc of defocus, a Gaussian for aberrations, and the box of a pixel's absorber. A short, positive,
separable kernel follows it within `MTF_TOLERANCE` up to the Nyquist frequency, where a short kernel errs most. Two
simplifications: off the axes the product of two kernels stands for the round spot, and defocus is that of
one distance, the still water's in the middle of the picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import j1

from thermacq_drivers.simflume.mounting import Mounting, build_camera
from thermacq_drivers.simflume.sensor_settings import LensSettings
from thermacq_drivers.simflume.surfaces import Floats

MTF_TOLERANCE = 0.08
_REACH_PX = 4
# Taps on either side of the middle for a lens in focus.
_SPOT_WIDTH = 0.12
# Standard deviation of the reflected image of the sensor, in picture widths.


@dataclass(frozen=True, eq=False)
class Lens:
    """The lens of one camera; make it with `build_lens`.

    Parameters
    ----------
    kernel
        (taps,) float32, blur along each axis.
    transmission
        (rows, columns) float32, part of a pixel's signal that comes from the scene; the rest comes from
        the housing.
    narcissus
        (rows, columns) float32, part that is the sensor's own radiation in place of the housing's.
    """

    kernel: NDArray[np.float32]
    transmission: NDArray[np.float32]
    narcissus: NDArray[np.float32]

    def blur(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """The blurred picture, a new array."""
        blurred = cv2.sepFilter2D(picture, -1, self.kernel, self.kernel, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(blurred, np.float32)

    @property
    def has_veil(self) -> bool:
        """Whether housing or sensor are seen at all."""
        return bool(self.transmission.min() < 1 or self.narcissus.max() > 0)

    def veil_k(self, housing_k: float, fpa_k: float) -> NDArray[np.float32]:
        """What the camera's own radiation adds to the picture, kelvin; temperatures above the reference."""
        veil: NDArray[np.float32] = (1 - self.transmission) * np.float32(housing_k)
        veil += self.narcissus * np.float32(fpa_k - housing_k)
        return veil


def build_lens(settings: LensSettings, mounting: Mounting, integrated: bool) -> Lens:
    """Lens of a camera.

    Parameters
    ----------
    settings
        The lens.
    mounting
        Pixels and focal length, and height and tilt, from which the distance of the water follows.
    integrated
        Whether the view that it is used on is averaged over each pixel already.
    """
    camera = build_camera(mounting)
    columns = np.arange(camera.columns) - camera.matrix[0, 2]
    rows = np.arange(camera.rows)[:, None] - camera.matrix[1, 2]
    tangent2 = (columns / camera.matrix[0, 0]) ** 2 + (rows / camera.matrix[1, 1]) ** 2
    transmission = 1 - settings.vignetting * (1 - 1 / (1 + tangent2) ** 2)
    spot = np.exp(-0.5 * (columns**2 + rows**2) / (_SPOT_WIDTH * camera.columns) ** 2)
    distance_m = mounting.height_m / math.cos(math.radians(mounting.tilt_deg))
    frequency = np.linspace(0, 0.5, 200)
    wanted = transfer(settings, mounting, distance_m, frequency, integrated)
    reach_px = _REACH_PX + math.ceil(defocus_disc_px(settings, mounting, distance_m) / 2)
    return Lens(
        kernel=short_kernel(frequency, wanted, reach_px).astype(np.float32),
        transmission=transmission.astype(np.float32),
        narcissus=(settings.narcissus * spot).astype(np.float32),
    )


def transfer(
    settings: LensSettings, mounting: Mounting, distance_m: float, frequency: Floats, integrated: bool
) -> Floats:
    """Modulation transfer function along an axis, at frequencies (n,) in cycles per pixel.

    Diffraction: 2/π (acos s - s sqrt(1 - s²)), s = λ F f. Defocus: 2 J1(π d f) / (π d f), with the disc's
    diameter d = (f_lens² / F) |1/z - 1/z_focus|.
    """
    cut = np.clip(frequency * settings.wavelength_um * settings.f_number / mounting.pixel_pitch_um, 0, 1)
    diffraction = 2 / np.pi * (np.arccos(cut) - cut * np.sqrt(1 - cut**2))
    angle = np.maximum(np.pi * defocus_disc_px(settings, mounting, distance_m) * frequency, 1e-9)
    aberration = np.exp(-2 * (np.pi * settings.aberration_px * frequency) ** 2)
    pixel = np.ones_like(frequency) if integrated else np.sinc(settings.fill_factor * frequency)
    product: Floats = diffraction * (2 * j1(angle) / angle) * aberration * pixel
    return product


def defocus_disc_px(settings: LensSettings, mounting: Mounting, distance_m: float) -> float:
    """Diameter of the disc that a point at this distance becomes, pixels."""
    defocus_per_m = abs(1 / distance_m - 1 / settings.focus_distance_m)
    return mounting.focal_length_mm**2 / settings.f_number * defocus_per_m / mounting.pixel_pitch_um


def short_kernel(frequency: Floats, wanted: Floats, reach_px: int) -> Floats:
    """Kernel (taps,) of sum 1 whose transfer function is nearest to the wanted one.

    It is symmetric, positive and falls from its middle, being a sum of boxes.
    """
    orders = np.arange(reach_px + 1)
    boxes = np.cumsum(np.cos(2 * np.pi * np.outer(frequency, orders)) * np.where(orders, 2, 1), axis=1)
    # A heavy first equation keeps the sum at 1, that is uniform views uniform.
    heights, _ = nnls(np.vstack([1e3 * boxes[:1], boxes]), np.concatenate([[1e3], wanted]))
    half = np.cumsum(heights[::-1])[::-1]
    kernel: Floats = np.concatenate([half[:0:-1], half])
    kernel /= kernel.sum()
    return kernel
