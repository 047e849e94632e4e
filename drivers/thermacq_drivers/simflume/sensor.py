"""How a microbolometer sees a scene: lens, noise, response of each pixel, drift, bad pixels, counts.

A pixel at apparent temperature T shows, with x = T - reference in kelvin and t the time of the scene,

    counts = middle + counts_per_k (g x + c x² + offset + d (T_fpa(t) - T_fpa(settled)) + flicker(t))

with its own gain g, curvature c, offset and drift coefficient d. A shutter event takes away what the pixel
then shows of the shutter beyond the shutter's true temperature.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from thermacq_drivers.simflume.bad_pixels import BadPixel, draw_bad_pixels
from thermacq_drivers.simflume.drift import Flicker
from thermacq_drivers.simflume.lens import Lens
from thermacq_drivers.simflume.noise import TemporalNoise
from thermacq_drivers.simflume.seeds import generator
from thermacq_drivers.simflume.sensor_settings import SensorSettings, ShutterSettings, WarmUpSettings
from thermacq_drivers.simflume.shutter import Shutter
from thermacq_drivers.simflume.warm_up import fpa_temperature, housing_temperature, settled_fpa_temperature

SLOW_STEP_S = 0.05
"""Everything that changes slowly (drift, 1/f noise, housing) is brought up to date so often."""

_SHADING_DEGREE = 3


class Sensor:
    """Sensor and lens of one camera; its fixed pattern follows from the seed and the camera's name.

    Parameters
    ----------
    settings
        Levels of noise and pattern.
    rows, columns
        Size of the picture in pixels.
    seed, name
        Seed of the scene and name of the camera.
    lens
        The lens; None: a plain blur, and nothing of the camera's own radiation.
    warm_up
        Temperatures of the camera.
    shutter
        Shutter events.
    """

    def __init__(
        self,
        settings: SensorSettings,
        rows: int,
        columns: int,
        seed: int,
        name: str,
        lens: Lens | None = None,
        warm_up: WarmUpSettings | None = None,
        shutter: ShutterSettings | None = None,
    ) -> None:
        self._settings = settings
        self._shape = rows, columns
        self._key = (seed, name)
        self._lens = lens
        self._warm_up = warm_up or WarmUpSettings()
        self._shutter_settings = shutter or ShutterSettings()
        self._shutter = Shutter(self._shutter_settings, seed, name)
        self._draw_pattern()
        self._flickers = [
            Flicker(level_k, shape, seed, name, purpose)
            for purpose, shape, level_k in (
                ("flicker", (rows, columns), settings.flicker_k),
                ("column flicker", (1, columns), settings.column_flicker_k),
            )
            if level_k > 0
        ]
        self._slow_key: tuple[int, float | None] | None = None
        self._slow_base = self._base
        self._slow_veil_k: NDArray[np.float32] | None = None
        self._corrected_s: float | None = None
        self._correction = self._base

    def _draw_pattern(self) -> None:
        """Response of each pixel, and the bad ones."""
        settings, (rows, columns) = self._settings, self._shape
        random = generator(*self._key, "fixed pattern")
        self._gain = (1 + settings.gain * random.standard_normal(self._shape)).astype(np.float32)
        offset = settings.offset_k * random.standard_normal(self._shape)
        offset += settings.shading_k * _shading(rows, columns, random)
        places = np.flatnonzero(random.uniform(size=rows * columns) < settings.bad_pixel_fraction)
        self.bad = draw_bad_pixels(settings, places, *self._key)
        self._neighbours = _neighbours(places, rows, columns)
        random = generator(*self._key, "more pattern")
        offset += settings.row_offset_k * random.standard_normal((rows, 1))
        offset += settings.column_offset_k * random.standard_normal((1, columns))
        self._drift = np.float32(settings.drift_k_per_k) + np.float32(
            settings.drift_spread_k_per_k
        ) * random.standard_normal(self._shape, dtype=np.float32)
        curvature = settings.curvature_per_k * random.standard_normal(self._shape)
        self._is_raw = settings.bad_pixels == "raw" and len(places) > 0
        noisy = self.bad.of(BadPixel.NOISY) if self._is_raw else places[:0]
        self._noise = TemporalNoise(settings, *self._key, noisy, self.bad.noise_excess[: len(noisy)])
        if self._is_raw:
            self._gain.reshape(-1)[self.bad.of(BadPixel.DEAD)] *= self.bad.dead_gain
            outliers = self.bad.of(BadPixel.OUTLIER)
            offset.reshape(-1)[outliers] += self.bad.outlier_offset_k
            curvature.reshape(-1)[outliers] += self.bad.outlier_curvature_per_k
        # From here on all is in counts.
        per_k = settings.counts_per_k
        self._gain *= np.float32(per_k)
        self._curvature = (per_k * curvature).astype(np.float32) if curvature.any() else None
        self._base = (settings.middle_count + per_k * offset).astype(np.float32)

    @property
    def gain(self) -> NDArray[np.float32]:
        """Responsivity of each pixel, counts per kelvin."""
        return self._gain

    @property
    def offset(self) -> NDArray[np.float32]:
        """Count of each pixel at the reference temperature, without drift and shutter correction."""
        return self._base

    def expose(
        self,
        temperature_k: NDArray[np.float32],
        index: int,
        counts: NDArray[np.uint16],
        time_s: float = 0.0,
    ) -> None:
        """One frame.

        Parameters
        ----------
        temperature_k
            (rows, columns) float32, apparent temperature that a perfect camera would see; overwritten.
        index
            Number of the exposure; picks the noise.
        counts
            (rows, columns) uint16, receives the counts.
        time_s
            Time of the scene, on which everything depends that drifts.
        """
        settings = self._settings
        base, veil_k = self._slowly_changing(time_s)
        seen = self._through_lens(temperature_k)
        seen -= np.float32(settings.reference_k)
        if self._lens is not None and veil_k is not None:
            seen *= self._lens.transmission
            seen += veil_k
        self._noise.add(seen, index)
        shown = self._respond(seen)
        shown += base
        flat = shown.reshape(-1)
        if self._is_raw:
            blinking = self.bad.of(BadPixel.BLINKING)
            flat[blinking] += self.bad.blink_k(time_s) * np.float32(settings.counts_per_k)
            flat[self.bad.of(BadPixel.HOT)] = settings.full_scale
        else:
            flat[self.bad.places] = np.median(flat[self._neighbours], axis=0)
        np.rint(shown, out=shown)
        np.clip(shown, 0, settings.full_scale, out=shown)
        np.copyto(counts, shown, casting="unsafe")

    def _through_lens(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        if self._lens is not None:
            return self._lens.blur(picture)
        if self._settings.blur_px == 0:
            return picture
        blurred = cv2.GaussianBlur(picture, (0, 0), self._settings.blur_px, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(blurred, np.float32)

    def _respond(self, above_k: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts, without offset, of apparent temperatures above the reference; may overwrite them."""
        if self._curvature is None:
            above_k *= self._gain
            return above_k
        # g x + c x² = (c x + g) x
        shown = self._curvature * above_k
        shown += self._gain
        shown *= above_k
        return shown

    def _slowly_changing(self, time_s: float) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Offsets of all pixels in counts, and the camera's own radiation in kelvin, both now."""
        corrected_s = self._shutter.corrected_at(time_s)
        key = int(np.floor(time_s / SLOW_STEP_S)), corrected_s
        if key != self._slow_key:
            step_s = key[0] * SLOW_STEP_S
            self._slow_base = self._offsets(step_s)
            if corrected_s is not None:
                self._slow_base = self._slow_base - self._correction_of(corrected_s)
            self._slow_veil_k = self._veil_k(step_s)
            self._slow_key = key
        return self._slow_base, self._slow_veil_k

    def _offsets(self, time_s: float) -> NDArray[np.float32]:
        """Counts of an object at the reference temperature without any shutter correction."""
        warmer_k = fpa_temperature(self._warm_up, time_s) - settled_fpa_temperature(self._warm_up)
        per_k = np.float32(self._settings.counts_per_k)
        base = self._base + self._drift * (np.float32(warmer_k) * per_k)
        for flicker in self._flickers:
            base += flicker.at(time_s) * per_k
        return base

    def _correction_of(self, corrected_s: float) -> NDArray[np.float32]:
        """What the shutter event that ended at this time takes away, counts."""
        if corrected_s != self._corrected_s:
            settings = self._settings
            shutter_k = housing_temperature(self._warm_up, corrected_s) - settings.reference_k
            shown = self._respond(np.full(self._shape, shutter_k, np.float32)) + self._offsets(corrected_s)
            event = int(np.floor(corrected_s * 1e3)) % 2**32
            left = generator(*self._key, "shutter frames", event).standard_normal(
                self._shape, dtype=np.float32
            )
            mean_noise = settings.netd_k * settings.counts_per_k / self._shutter_settings.frames_averaged**0.5
            shown += left * np.float32(mean_noise)
            shown -= np.float32(settings.middle_count + settings.counts_per_k * shutter_k)
            self._correction, self._corrected_s = shown, corrected_s
        return self._correction

    def _veil_k(self, time_s: float) -> NDArray[np.float32] | None:
        if self._lens is None or not self._lens.has_veil:
            return None
        reference_k = self._settings.reference_k
        return self._lens.veil_k(
            housing_temperature(self._warm_up, time_s) - reference_k,
            fpa_temperature(self._warm_up, time_s) - reference_k,
        )


def _shading(rows: int, columns: int, random: np.random.Generator) -> NDArray[np.float64]:
    """Smooth pattern, a random polynomial in both directions, of peak-to-peak 1 and mean 0."""
    weights = random.standard_normal((_SHADING_DEGREE + 1, _SHADING_DEGREE + 1))
    degree = np.add.outer(np.arange(_SHADING_DEGREE + 1), np.arange(_SHADING_DEGREE + 1))
    weights[(degree == 0) | (degree > _SHADING_DEGREE)] = 0
    pattern = np.polynomial.legendre.leggrid2d(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), weights)
    centred: NDArray[np.float64] = (pattern - pattern.mean()) / np.ptp(pattern)
    return centred


def _neighbours(bad: NDArray[np.intp], rows: int, columns: int) -> NDArray[np.intp]:
    """Flat indices of the eight pixels around each bad one, mirrored at the border: (8, bad)."""
    row, column = np.divmod(bad, columns)
    around = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if (down, right) != (0, 0):
                there = np.abs(row + down), np.abs(column + right)
                there = (
                    np.minimum(there[0], 2 * (rows - 1) - there[0]),
                    np.minimum(there[1], 2 * (columns - 1) - there[1]),
                )
                around.append(there[0] * columns + there[1])
    return np.array(around, np.intp).reshape(8, len(bad))
