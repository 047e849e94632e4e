"""Settings of the driver ``gige``, and the pixel formats that it understands."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

BIT_DEPTHS = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono14": 14, "Mono16": 16}
"""Significant bits of the pixel formats; all but Mono8 come as two bytes, the low one first."""


class GigeSettings(BaseModel):
    """Settings of a GenICam camera; what `configure` returns is what the camera answered."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    serial: str = Field("", description="serial number of the camera; empty: the rig's, or the only camera")
    address: str = Field("", description="IP address, for a camera that discovery does not reach")
    columns: int = Field(0, ge=0, description="width of the region; 0: the whole sensor")
    rows: int = Field(0, ge=0, description="height of the region; 0: the whole sensor")
    offset_x: int = Field(0, ge=0, description="first column of the region")
    offset_y: int = Field(0, ge=0, description="first row of the region")
    pixel_format: Literal["Mono8", "Mono10", "Mono12", "Mono14", "Mono16"] = "Mono16"
    exposure_us: float = Field(0.0, ge=0, description="exposure time; 0: left as it is")
    features: dict[str, bool | int | float | str] = Field(
        default_factory=dict,
        description="further GenICam features, set in this order before the region; true runs a command",
    )
    trigger_line: str = Field("Line0", description="TriggerSource in mode 'hardware'")
    max_frame_rate_hz: float = Field(
        0.0, ge=0, description="highest rate that camera and network hold; 0: what the camera says"
    )
    ptp: bool = Field(False, description="clock set by PTP; arming waits until the camera follows it")
    ptp_wait_s: float = Field(15.0, ge=0, le=60, description="longest wait for PTP when arming")
    ptp_status: str = Field("", description="answered by the camera; what is given is ignored")
    packet_size: int = Field(
        1400, ge=576, le=16_384, description="bytes; 8000 and more needs jumbo frames on the whole way"
    )
    packet_resend: bool = Field(True, description="ask the camera again for lost packets")
    packet_request_ratio: float = Field(
        0.25, gt=0, le=1, description="a frame that lacks more than this share is not asked for again"
    )
    packet_timeout_ms: float = Field(20.0, gt=0, le=1000, description="a packet this late is asked for again")
    frame_retention_ms: float = Field(
        100.0, gt=0, le=5000, description="a frame that lacks packets is given up after this time"
    )
    socket_buffer_bytes: int = Field(
        4 << 20, ge=1 << 16, le=1 << 30, description="receive buffer; the system may grant less"
    )
    buffers: int = Field(50, ge=4, le=500, description="frames that wait for a late host")
    incomplete_frames: Literal["drop", "keep"] = Field(
        "drop", description="frames that lack packets: counted as lost, or stored and flagged"
    )
    timeout_s: float = Field(
        7.0, gt=0, le=600, description="longest silence; Aravis needs 5 to 6 s to see that a camera is gone"
    )
    trigger_timeout_s: float = Field(
        1.0, gt=0, le=60, description="a frame that comes this long after its software trigger is lost"
    )
