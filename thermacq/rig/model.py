"""The tables of a rig file, with their defaults and limits; units stand in the names."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from thermacq.devices import TriggerMode


def _device_name(name: str) -> str:
    """Names of devices become names of groups in the run file and of processes."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,31}", name):
        raise ValueError("a device name is a letter, then at most 31 letters, digits or '_'")
    return name


DeviceName = Annotated[str, AfterValidator(_device_name)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class ClockTable(_Table):
    """Host clock of a recording. Virtual time is for rigs that are simulated throughout."""

    kind: Literal["real", "virtual"] = "real"
    speed: float = Field(0.0, ge=0, description="virtual seconds per real second; 0: as fast as possible")


class TriggerTable(_Table):
    """Who triggers the cameras, and how often."""

    mode: TriggerMode = Field(TriggerMode.SOFTWARE, strict=False)
    frame_rate_hz: float = Field(50.0, gt=0, le=10_000)
    source: str = Field("", description="trigger source, for mode 'hardware'")
    late_after_us: float = Field(
        1000.0, gt=0, description="a software trigger later than this is skipped and recorded"
    )


class ReconnectTable(_Table):
    """What happens when a device is unplugged, or falls silent, during a recording."""

    policy: Literal["host_wins", "device_wins", "fail"] = Field(
        "host_wins",
        description="back with the rig's settings; back with those that it has; or not at all",
    )
    give_up_after_s: float = Field(
        30.0, gt=0, le=3600, description="a device that is away for longer is lost for good"
    )


class CameraTable(_Table):
    """One camera."""

    driver: str
    serial: str = Field("", description="expected serial number; empty accepts any")
    pin_to_core: int | None = Field(None, ge=0, description="processor core of its device process")
    reconnect: ReconnectTable | None = Field(None, description="for this device, in place of the rig's table")
    settings: dict[str, Any] = Field(default_factory=dict, description="settings of the driver")


class ProbeTable(_Table):
    """One wave probe: where it stands in the world frame, and how its raw values become metres.

    Elevation in metres = coefficient_m_per_unit * (raw - zero_raw).
    """

    driver: str
    serial: str = ""
    pin_to_core: int | None = Field(None, ge=0)
    x_m: float = 0.0
    y_m: float = 0.0
    channel: str = Field("", description="channel that holds the elevation; empty: the first")
    coefficient_m_per_unit: float = 1.0
    coefficient_u_rel: float = Field(0.0, ge=0, description="relative standard uncertainty")
    zero_raw: float | None = Field(None, description="raw value of still water; None: mean of the record")
    reconnect: ReconnectTable | None = None
    settings: dict[str, Any] = Field(default_factory=dict)


class PairTable(_Table):
    """Two cameras that look at the same water; a rig may have several such pairs."""

    left: str
    right: str


class TriggerSourceTable(_Table):
    """One trigger source."""

    driver: str
    serial: str = ""
    pin_to_core: int | None = Field(None, ge=0)
    reconnect: ReconnectTable | None = None
    settings: dict[str, Any] = Field(default_factory=dict)


class BoardTable(_Table):
    """The calibration target: most often a chessboard, its inner corners and the size of a square."""

    kind: Literal["chessboard", "circles", "charuco", "marked"] = Field(
        "chessboard",
        description="asymmetric circles; ChArUco; 'marked': a chessboard with one large marker in its middle",
    )
    columns: int = Field(9, ge=3, description="inner corners along, or circles in a row")
    rows: int = Field(6, ge=3, description="inner corners across, or rows of circles")
    square_m: float = Field(
        0.05, gt=0, lt=1, description="side of a square; of circles: distance of rows; metres"
    )
    marker_m: float = Field(0.0, ge=0, lt=1, description="side of the black border of its markers, metres")
    dictionary: str = Field("", description="of its markers, e.g. DICT_4X4_50; or the bits of the one marker")


class WorldTable(_Table):
    """World frame: origin on the still water, Z up, X along the flume.

    X is the projection on the still water of a direction in the left picture; the point of the still
    water straight below the left camera has the coordinates `left_camera_x_m`, `left_camera_y_m`.
    """

    x_axis: Literal["right", "left", "up", "down"] = "up"
    x_axis_rotation_deg: float = 0.0
    left_camera_x_m: float = 0.0
    left_camera_y_m: float = 0.0


class StoreTable(_Table):
    """How the run file is written."""

    compression: Literal["lz4", "zstd", "none"] = "lz4"
    flush_interval_s: float = Field(0.25, gt=0, le=0.5)
    ring_s: float = Field(2.0, ge=0.5, le=30, description="length of each shared-memory ring")
    reserve_mb: float = Field(1024.0, ge=0, description="disk space that a recording leaves free")


class StageTable(_Table):
    """A correction stage of a plugin, named after the built-in ones."""

    name: str
    settings: dict[str, Any] = Field(default_factory=dict)


class CorrectionTable(_Table):
    """Corrections of the pictures. They are stored with each recording and applied when it is read.

    The three built-in stages are those of a camera's correction file and rest without one.
    """

    files: dict[DeviceName, str] = Field(
        default_factory=dict, description="correction file of each camera; relative to the rig file"
    )
    nonuniformity: bool = True
    bad_pixels: bool = True
    shading: bool = True
    stages: list[StageTable] = Field(default_factory=list, description="further stages, in this order")


class ReconstructionTable(_Table):
    """How elevation is made from pairs."""

    matcher: str = "sgbm"
    matcher_settings: dict[str, Any] = Field(default_factory=dict)
    grid_spacing_m: float = Field(0.005, gt=0)
    min_points_per_cell: int = Field(3, ge=1)
    rim_px: int = Field(
        12, ge=0, description="pixels nearer than this to the border of what both cameras see are left out"
    )


class Rig(_Table):
    """A whole rig."""

    name: str = "rig"
    clock: ClockTable = ClockTable()
    trigger: TriggerTable = TriggerTable()
    reconnect: ReconnectTable = ReconnectTable()
    cameras: dict[DeviceName, CameraTable] = Field(min_length=1)
    pairs: dict[DeviceName, PairTable] = Field(
        default_factory=dict,
        description="stereo pairs of a rig with more than two cameras, the first by default",
    )
    probes: dict[DeviceName, ProbeTable] = Field(default_factory=dict)
    trigger_sources: dict[DeviceName, TriggerSourceTable] = Field(default_factory=dict)
    board: BoardTable = BoardTable()
    world: WorldTable = WorldTable()
    store: StoreTable = StoreTable()
    correction: CorrectionTable = CorrectionTable()
    reconstruction: ReconstructionTable = ReconstructionTable()
    scene: dict[str, Any] = Field(
        default_factory=dict, description="what simulated devices look at; real devices ignore it"
    )
    emulation: dict[DeviceName, dict[str, Any]] = Field(
        default_factory=dict, description="settings of the emulators of devices, for `--emulate`"
    )
