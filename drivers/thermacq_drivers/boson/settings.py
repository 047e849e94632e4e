"""Settings of a Boson."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

FFC_MODES = ("manual", "auto", "external")
GAIN_MODES = ("high", "low", "auto")
SYNC_MODES = ("disabled", "master", "slave")
"""Each in the order of the camera's numbers, from 0."""


class BosonSettings(BaseModel):
    """Settings of a Boson; what `configure` returns says which telemetry was found."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    telemetry: Literal["auto", "16-bit", "8-bit", "none"] = Field(
        "auto", description="how the telemetry row is packed; auto: look; none: host times and no counter"
    )
    ffc_mode: Literal["manual", "auto", "external"] = Field(
        "manual", description="manual: no flat-field correction but those asked for here"
    )
    ffc_at_arm: bool = Field(True, description="run one flat-field correction before each recording")
    gain: Literal["high", "low", "auto", "leave"] = Field("high", description="leave: as the camera has it")
    sync_in_free_run: Literal["disabled", "master", "slave"] = Field(
        "disabled",
        description="external sync in mode free_run; in mode hardware the camera is always a slave",
    )
    temperature_every_s: float = Field(
        2.0, ge=0.5, le=60, description="how often the temperature of the focal-plane array is read"
    )
    timeout_s: float = Field(5.0, gt=0, le=600, description="longest wait for a frame or trigger pulse")
