"""Settings of the views for calibration: the heated chessboard, and a uniform blackbody."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from thermacq_drivers.simflume.tables import Table


class ChessboardSettings(Table):
    """A heated chessboard held in front of the cameras, one pose after the other."""

    columns: int = Field(9, ge=3, description="inner corners along a row")
    rows: int = Field(6, ge=3, description="inner corners along a column")
    square_m: float = Field(0.05, gt=0, lt=0.5, description="side of a square as somebody measured it")
    true_square_m: float | None = Field(
        None, gt=0, lt=0.5, description="side that the squares really have; None: as measured"
    )
    bow_m: float = Field(
        0.0, gt=-0.05, lt=0.05, description="by which the middle of a bent board bulges towards the cameras"
    )
    contrast_k: float = Field(6.0, gt=0, description="apparent difference of the two coatings")
    board_temperature_k: float | None = Field(
        None, gt=273, lt=400, description="of the board; then the contrast follows from the emissivities"
    )
    emissivities: tuple[float, float] = Field((0.95, 0.1), description="of the coating and of bare metal")
    frames_per_view: int = Field(4, ge=1, description="frames for which a pose is held")
    poses: Literal["good", "frontal", "corner"] = Field(
        "good", description="all over picture and tilts; hardly tilted at one distance; in one corner only"
    )
    views: int = Field(0, ge=0, description="number of poses, repeated in turn; 0: always another one")
    nearest_m: float = Field(0.45, gt=0.1)
    farthest_m: float = Field(0.9, lt=5)
    largest_tilt_deg: float = Field(40.0, ge=0, le=50)
    place_m: tuple[float, float, float] | None = Field(
        None,
        description="middle of the board in the flume, lying along it face up, the same for every camera",
    )
    shake_m: float = Field(0.0, ge=0, lt=0.1, description="amplitude of the hand's movement")
    shake_hz: float = Field(2.0, gt=0, le=20, description="its frequency")

    @model_validator(mode="after")
    def _possible(self) -> ChessboardSettings:
        if self.nearest_m >= self.farthest_m:
            raise ValueError("nearest_m must be less than farthest_m")
        coated, bare = self.emissivities
        if not 0 <= bare < coated <= 1:
            raise ValueError("emissivities must be those of coating and metal, 0 <= metal < coating <= 1")
        return self

    @property
    def real_square_m(self) -> float:
        """Side of a square as it really is."""
        return self.square_m if self.true_square_m is None else self.true_square_m


class UniformSettings(Table):
    """A blackbody that fills the view, at one temperature after the other."""

    temperatures_k: tuple[Annotated[float, Field(gt=200, lt=500)], ...] = Field((295.0,), min_length=1)
    frames_per_temperature: int = Field(100, ge=1, description="then the next one; the last one stays")
