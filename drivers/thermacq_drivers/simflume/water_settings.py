"""Settings of the water: irregular seas, wave groups, reflection, start-up, seiche."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from thermacq_drivers.simflume.cases import FLUME_LENGTH_M
from thermacq_drivers.simflume.tables import Table


class IrregularSurface(Table):
    """A sea of linear waves with random phases."""

    kind: Literal["irregular"] = "irregular"
    spectrum: Literal["jonswap", "pierson-moskowitz", "white"] = "jonswap"
    significant_wave_height_m: float = Field(0.04, gt=0, description="Hm0 = 4 sqrt(m0)")
    peak_period_s: float = Field(0.9, gt=0.2, le=5, description="of a white spectrum: of its middle")
    peak_enhancement: float = Field(3.3, ge=1, le=10, description="gamma of JONSWAP")
    band: tuple[float, float] = Field(
        (0.5, 3.0), description="lowest and highest frequency over the peak's; a white one may be narrower"
    )
    components: int = Field(200, ge=8, le=1000)
    amplitudes: Literal["deterministic", "random"] = "deterministic"
    spreading: float | None = Field(
        None, ge=1, le=200, description="s of cos^2s(theta/2); none: long-crested, along +x"
    )

    @model_validator(mode="after")
    def _a_band(self) -> IrregularSurface:
        if not 0 < self.band[0] < self.band[1] <= 5:
            raise ValueError("band must hold two frequencies in order, above 0 and up to 5 times the peak's")
        return self


class GroupSurface(Table):
    """A group of linear waves along +x, highest at its focus; groups return after minutes."""

    kind: Literal["group"] = "group"
    shape: Literal["gaussian", "bichromatic", "focused"] = "gaussian"
    amplitude_m: float = Field(0.03, gt=0, description="crest at the focus")
    period_s: float = Field(0.9, gt=0.2, le=5, description="of the carrier, or of the spectrum's peak")
    bandwidth: float = Field(
        0.1, gt=0.005, le=0.3, description="over the carrier's frequency; not of focused"
    )
    focus_x_m: float = 0.25
    focus_time_s: float = 10.0


class ReflectionSettings(Table):
    """Waves that the absorber at the end of the flume sends back."""

    coefficient: float = Field(0.05, ge=0, le=1, description="reflected over incident amplitude")
    absorber_x_m: float = Field(10.0, gt=0, description="where the waves are reflected")


class RampSettings(Table):
    """Start of the waves: their front passes the cameras."""

    start_s: float = Field(0.0, description="when the front passes x = 0")
    rise_s: float = Field(3.0, gt=0.1, le=60, description="from no waves to full ones")


class SeicheSettings(Table):
    """Standing wave of the whole flume, its lowest modes."""

    amplitude_m: float = Field(0.001, gt=0, le=0.05, description="at the flume's ends")
    mode: int = Field(1, ge=1, le=5, description="number of nodes along the flume")
    flume_start_x_m: float = Field(-8.0, description="the end of the flume with the wave maker")
    flume_length_m: float = Field(FLUME_LENGTH_M, gt=1)
    phase_deg: float = 0.0
