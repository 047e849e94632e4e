"""Base of the tables of settings."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Table(BaseModel):
    """Base of all settings of the simulation: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)
