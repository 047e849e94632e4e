"""Settings of the driver ``labjack_u6``."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from thermacq_drivers.labjack_u6 import codec


class InputSettings(BaseModel):
    """One analogue input."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1, description="name of the channel in the run")
    ain: int = Field(ge=0, le=13, description="terminal AIN0 to AIN13")
    gain: Literal[1, 10, 100, 1000] = Field(1, description="range: 10 V divided by it")
    differential: bool = Field(False, description="against the next terminal; `ain` must be even")

    @model_validator(mode="after")
    def _even(self) -> InputSettings:
        if self.differential and self.ain % 2:
            raise ValueError("a differential input begins at an even terminal")
        return self


class U6Settings(BaseModel):
    """Settings of a LabJack U6."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    inputs: tuple[InputSettings, ...] = Field(
        (InputSettings(name="gauge", ain=0),), min_length=1, max_length=14, description="in this order"
    )
    rate_hz: float = Field(1000.0, gt=0, le=50_000, description="scans per second; the nearest is applied")
    resolution: int = Field(0, ge=0, le=8, description="resolution index; higher is slower and quieter")
    settling: int = Field(0, ge=0, le=9, description="settling factor; 0: automatic")
    line: int = Field(
        -1, ge=-1, le=15, description="input of the trigger pulses: 0-7 FIO, 8-15 EIO; -1: none"
    )
    calibration: Literal["device", "nominal"] = Field("device", description="whose constants make volts")
    timeout_s: float = Field(2.0, gt=0, le=60, description="longest silence")

    @model_validator(mode="after")
    def _fits(self) -> U6Settings:
        names = [item.name for item in self.inputs]
        if len(set(names)) != len(names):
            raise ValueError("each name once")
        if (fastest := self.fastest_hz) < self.rate_hz:
            raise ValueError(f"at most {fastest:g} scans/s with {self.channels} channels")
        codec.scan_clock(self.rate_hz)
        return self

    @property
    def channels(self) -> int:
        """Samples of a scan, that of the line included."""
        return len(self.inputs) + (self.line >= 0)

    @property
    def fastest_hz(self) -> float:
        """Scans per second at the quickest resolution: 50 000 samples/s in all."""
        return 50_000 / self.channels
