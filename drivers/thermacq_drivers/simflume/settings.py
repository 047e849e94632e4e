"""Settings of the scene (the rig's ``[scene]`` table), checked by pydantic."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, ValidationError, model_validator

from thermacq.devices import DeviceContext, Settings
from thermacq.errors import DeviceFault, RigError
from thermacq.settings import explain
from thermacq_drivers.simflume.board_settings import ChessboardSettings, UniformSettings
from thermacq_drivers.simflume.cases import FLUME_DEPTH_M, TABLE_II
from thermacq_drivers.simflume.heat_settings import CylinderSettings, LampSettings, SurroundingsSettings
from thermacq_drivers.simflume.sensor_settings import CameraCondition
from thermacq_drivers.simflume.tables import Table as Table  # noqa: PLC0414 (others take it from here)
from thermacq_drivers.simflume.water_settings import (
    GroupSurface,
    IrregularSurface,
    RampSettings,
    ReflectionSettings,
    SeicheSettings,
)


class StillSurface(Table):
    """Water at rest."""

    kind: Literal["still"] = "still"


class RegularSurface(Table):
    """A regular nonlinear wave along +x: a case of Table II, or a period and a steepness."""

    kind: Literal["regular"] = "regular"
    case: str = Field("", description="name of a case of Table II, e.g. 'T0.791-H2/25'")
    period_s: float = Field(0.0, ge=0, le=5)
    steepness: float = Field(0.0, ge=0, description="H/lambda")
    phase_deg: float = Field(0.0, description="phase at x = 0, t = 0; 0 puts a crest there")

    @model_validator(mode="after")
    def _one_wave(self) -> RegularSurface:
        given = self.period_s > 0 and self.steepness > 0
        if self.case and (self.period_s or self.steepness):
            raise ValueError("give either a case or period_s and steepness, not both")
        if not self.case and not given:
            raise ValueError("give a case of Table II, or period_s and steepness, both above 0")
        if self.case and self.case not in TABLE_II:
            raise ValueError(f"there is no case '{self.case}' in Table II; known: {', '.join(TABLE_II)}")
        return self

    @property
    def wave(self) -> tuple[float, float]:
        """Period in seconds and steepness."""
        if self.case:
            return TABLE_II[self.case].period_s, TABLE_II[self.case].steepness
        return self.period_s, self.steepness


class TextureSettings(Table):
    """Temperature pattern that floats on the water."""

    rms_k: float = Field(0.3, ge=0, le=10, description="standard deviation, kelvin")
    lengths_m: tuple[float, ...] = Field(
        (0.003, 0.008, 0.024), min_length=1, description="correlation lengths across the flume"
    )
    streakiness: float = Field(2.5, ge=1, le=10, description="correlation along x over that across")
    stirring_m: float = Field(0.0, ge=0, le=0.05, description="reach of the eddies that draw out filaments")
    eddies_m: float = Field(0.02, ge=0.005, le=0.1, description="correlation length of the eddies")
    warm_streaks: float = Field(
        0.0, ge=0, le=1, description="skew towards few warm streaks; 0: as many cool ones"
    )
    lifetime_s: float = Field(4.0, gt=0, description="time in which the pattern is replaced by a new one")

    @model_validator(mode="after")
    def _drawable(self) -> TextureSettings:
        if min(self.lengths_m) < 0.002 or max(self.lengths_m) * self.streakiness > 0.2:
            raise ValueError("lengths_m must lie between 2 mm and 0.2 m / streakiness")
        if self.rms_k == 0:
            raise ValueError(
                "rms_k is 0: water of even temperature has no texture, and nothing in its pictures can be matched"
            )
        return self


class SceneSettings(Table):
    """What the simulated devices look at."""

    simulator: Literal["simflume"] = "simflume"
    view: Literal["water", "chessboard", "uniform"] = "water"
    seed: int = Field(1, ge=0, lt=2**32, description="fixes every random thing of scene and devices")
    depth_m: float = Field(FLUME_DEPTH_M, gt=0.05)
    water_temperature_k: float = Field(295.0, gt=273, lt=373)
    surface: StillSurface | RegularSurface | IrregularSurface | GroupSurface = Field(
        StillSurface(), discriminator="kind"
    )
    reflection: ReflectionSettings | None = None
    ramp: RampSettings | None = None
    seiche: SeicheSettings | None = None
    texture: TextureSettings = TextureSettings()
    lamps: LampSettings | None = None
    surroundings: SurroundingsSettings | None = None
    cylinder: CylinderSettings | None = None
    chessboard: ChessboardSettings = ChessboardSettings()
    uniform: UniformSettings = UniformSettings()
    camera: CameraCondition = CameraCondition()

    @model_validator(mode="after")
    def _possible_water(self) -> SceneSettings:
        from thermacq_drivers.simflume.water import build_water

        if isinstance(self.surface, StillSurface) and (self.reflection or self.ramp):
            raise ValueError("still water has no waves to reflect or to start")
        build_water(self)
        return self


def parse_scene(values: Settings) -> SceneSettings:
    """Check a ``[scene]`` table; an empty one is still water.

    Raises
    ------
    RigError
        Unknown keys, or a scene that physics does not allow.
    """
    try:
        return SceneSettings.model_validate(dict(values))
    except ValidationError as error:
        raise RigError(
            explain(error, SceneSettings, "[scene]"),
            remedy="Mend these settings; defaults hold for what is left out.",
        ) from None


def device_scene(context: DeviceContext) -> SceneSettings:
    """Scene of a device, for use in ``configure``; raises `DeviceFault` like `check_settings`."""
    try:
        return parse_scene(context.scene)
    except RigError as error:
        raise DeviceFault(context.name, "configure", error.what, remedy=error.remedy) from None
