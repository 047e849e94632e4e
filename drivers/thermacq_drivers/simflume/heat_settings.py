"""Settings of heat and radiance: lamps, surroundings that the water reflects, and a cylinder in view."""

from __future__ import annotations

from pydantic import Field, model_validator

from thermacq_drivers.simflume.cases import FLUME_WIDTH_M
from thermacq_drivers.simflume.tables import Table


class LampSettings(Table):
    """Tubular heat lamps across the flume, upstream of the measured area."""

    x_m: float = Field(-0.5, description="of all lamps, along the flume")
    y_m: tuple[float, ...] = Field((-0.28, 0.0, 0.28), min_length=1, description="of each lamp's middle")
    height_m: float = Field(0.45, gt=0, description="above still water")
    length_m: float = Field(0.25, gt=0, lt=2, description="of a tube, along y")
    width_m: float = Field(0.012, ge=0.004, lt=0.2, description="of a tube, along x")
    tube_k: float = Field(700.0, gt=250, lt=2000, description="apparent temperature of a tube, 8-14 µm")
    rise_k: float = Field(
        1.5, ge=0, le=20, description="warming of the water's skin at x = 0, in line with a lamp"
    )
    decay_length_m: float = Field(0.8, gt=0.05, description="downstream, to 1/e of the warming")
    unevenness: float = Field(
        0.25, ge=0, lt=1, description="part of the warming that is missing between lamps"
    )


class SurroundingsSettings(Table):
    """What the water emits and reflects; without this table it is black."""

    emissivity: float = Field(
        0.95, gt=0.5, le=1, description="of water at normal incidence; pure water by Fresnel: 0.985"
    )
    ambient_k: float = Field(292.0, gt=200, lt=400, description="of air, walls and ceiling as reflected")


class CylinderSettings(Table):
    """A vertical cylinder that stands in the flume, painted, with strips of foil pasted on it."""

    x_m: float = 0.42
    y_m: float = -0.03
    radius_m: float = Field(0.06, gt=0.002)
    top_m: float = Field(0.3, gt=0, description="height of its top above still water")
    temperature_k: float = Field(295.0, gt=200, lt=400)
    paint_emissivity: float = Field(0.95, gt=0, le=1)
    strips: int = Field(120, ge=0, le=1000, description="strips of foil, pasted at random")
    strip_size_m: tuple[float, float] = Field((0.007, 0.045), description="mean width and length")
    foil_emissivity: tuple[float, float] = Field((0.05, 0.20), description="each strip's, between these")
    meniscus_m: float = Field(0.001, ge=0, le=0.004, description="rise of the water at the wall")

    @model_validator(mode="after")
    def _possible(self) -> CylinderSettings:
        if abs(self.y_m) + self.radius_m >= FLUME_WIDTH_M / 2:
            raise ValueError(
                f"a cylinder of radius {self.radius_m:g} m at y = {self.y_m:g} m does not fit "
                f"between the walls of the flume, {FLUME_WIDTH_M:g} m apart"
            )
        low, high = self.foil_emissivity
        if not 0 < low <= high < 1:
            raise ValueError("foil_emissivity must be two values in order, between 0 and 1")
        if min(self.strip_size_m) < 0.001:
            raise ValueError("strip_size_m must be at least 1 mm")
        return self
