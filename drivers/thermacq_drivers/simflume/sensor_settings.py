"""Settings of what is inside a simulated camera: lens, sensor, bolometers, warm-up and shutter.

The defaults are a camera that has warmed up and corrects its own non-uniformity: what is left is small
enough to match pictures without further correction, and large enough to matter. A scene may put other
conditions in force for all its cameras, see `CameraCondition`.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from thermacq_drivers.simflume.tables import Table


class LensSettings(Table):
    """A lens given by its physics, in place of the plain blur `sensor.blur_px`."""

    f_number: float = Field(1.0, gt=0.5, le=10)
    wavelength_um: float = Field(10.0, gt=2, le=20)
    focus_distance_m: float = Field(0.65, gt=0.05, description="at which the lens is focused")
    aberration_px: float = Field(0.25, ge=0, le=3, description="Gaussian blur of an imperfect lens")
    fill_factor: float = Field(0.9, gt=0, le=1, description="width of a pixel's absorber over the pitch")
    vignetting: float = Field(
        0.0, ge=0, le=1, description="1: light falls off with cos^4 of the field angle; 0: not, or corrected"
    )
    narcissus: float = Field(0.0, ge=0, lt=0.5, description="of the sensor's own radiation, reflected back")


class BadPixelShares(Table):
    """How the bad pixels divide into kinds; only ratios matter."""

    dead: float = Field(0.25, ge=0, description="respond with less than half of what they should")
    hot: float = Field(0.15, ge=0, description="stand at full scale")
    noisy: float = Field(0.25, ge=0, description="noise of 3 to 8 times that of the others")
    blinking: float = Field(0.15, ge=0, description="jump by 0.5 to 2 K, to and fro, every few seconds")
    outlier: float = Field(0.2, ge=0, description="offset and curvature far from those of the others")

    @model_validator(mode="after")
    def _some(self) -> BadPixelShares:
        if sum(self.in_order) <= 0:
            raise ValueError("at least one kind of bad pixel needs a share above 0")
        return self

    @property
    def in_order(self) -> tuple[float, float, float, float, float]:
        """Shares in the order of `bad_pixels.BadPixel`."""
        return self.dead, self.hot, self.noisy, self.blinking, self.outlier


class SensorSettings(Table):
    """What the sensor adds to the scene, in kelvin of apparent temperature."""

    blur_px: float = Field(0.6, ge=0, le=5, description="standard deviation of the optics' point spread")
    netd_k: float = Field(0.035, ge=0, description="temporal noise of a pixel")
    frame_noise_k: float = Field(0.0, ge=0, description="noise common to a frame")
    row_noise_k: float = Field(0.0, ge=0, description="noise common to a row of a frame")
    column_noise_k: float = Field(0.0, ge=0, description="noise common to a column of a frame")
    flicker_k: float = Field(0.0, ge=0, description="1/f noise of a pixel: its deviation in each octave")
    column_flicker_k: float = Field(0.0, ge=0, description="1/f noise of a column, likewise")
    offset_k: float = Field(0.015, ge=0, description="fixed pattern of offsets")
    row_offset_k: float = Field(0.0, ge=0, description="fixed pattern of rows")
    column_offset_k: float = Field(0.0, ge=0, description="fixed pattern of columns")
    gain: float = Field(0.002, ge=0, lt=0.5, description="fixed pattern of relative gains")
    curvature_per_k: float = Field(0.0, ge=0, lt=0.01, description="fixed pattern of curvatures, K per K²")
    shading_k: float = Field(0.2, ge=0, description="smooth non-uniformity, peak to peak")
    drift_k_per_k: float = Field(0.55, description="apparent temperature per kelvin of the focal plane")
    drift_spread_k_per_k: float = Field(0.0, ge=0, description="deviation of that among the pixels")
    bad_pixel_fraction: float = Field(0.0005, ge=0, lt=0.2)
    bad_pixels: Literal["replaced", "raw"] = "replaced"
    bad_pixel_shares: BadPixelShares = BadPixelShares()
    counts_per_k: float = Field(100.0, gt=0)
    reference_k: float = Field(295.0, gt=0, description="temperature at which gains are equal")
    bit_depth: Literal[14, 16] = Field(14, description="16 bits begin four times as high as 14 bits")

    @property
    def full_scale(self) -> int:
        """Highest count."""
        return int(2**self.bit_depth - 1)

    @property
    def middle_count(self) -> int:
        """Count of an object at the reference temperature."""
        return int(6000 * 2 ** (self.bit_depth - 14))


class BolometerSettings(Table):
    """How pixels follow the scene in time; zeros: at once, and all rows together."""

    time_constant_s: float = Field(0.0, ge=0, le=0.1, description="about 0.01 s for microbolometers")
    line_time_s: float = Field(0.0, ge=0, le=2e-4, description="of the rolling read-out; 32e-6 s for a Boson")
    sub_exposures: Literal[2, 3, 4] = Field(
        3, description="pictures drawn for one frame with a time constant"
    )


class WarmUpSettings(Table):
    """Temperatures of the camera since it was switched on."""

    powered_for_s: float = Field(7200.0, ge=0, description="before the scene starts")
    room_k: float = Field(295.0, gt=230, lt=330)
    fpa_rise_k: float = Field(10.0, ge=0, le=40, description="of the focal-plane array, in the end")
    fpa_time_constant_s: float = Field(480.0, gt=0)
    housing_rise_k: float = Field(6.0, ge=0, le=40)
    housing_time_constant_s: float = Field(900.0, gt=0)
    reading_noise_k: float = Field(0.005, ge=0, lt=1, description="of the reported temperature")


class ShutterSettings(Table):
    """Shutter events (flat-field corrections, FFC): the picture is frozen, then offsets are corrected."""

    period_s: float = Field(0.0, ge=0, description="of automatic events; 0: none")
    at_s: tuple[float, ...] = Field((), description="events on command, in time of the scene")
    closed_s: float = Field(0.5, gt=0, le=5, description="for which the picture is frozen")
    frames_averaged: int = Field(8, ge=1)

    @model_validator(mode="after")
    def _opens_again(self) -> ShutterSettings:
        if 0 < self.period_s < 2 * self.closed_s:
            raise ValueError("period_s must be at least twice closed_s, or the shutter hardly opens")
        return self

    @property
    def is_used(self) -> bool:
        """Whether there are any events."""
        return self.period_s > 0 or bool(self.at_s)


class CameraCondition(Table):
    """The scene's table ``[camera]``: each table given here takes the place of that of every camera."""

    lens: LensSettings | None = None
    sensor: SensorSettings | None = None
    bolometer: BolometerSettings | None = None
    warm_up: WarmUpSettings | None = None
    shutter: ShutterSettings | None = None
