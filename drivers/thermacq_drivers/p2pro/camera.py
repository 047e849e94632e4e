"""The P2 Pro: the thermal half of its pictures, gain and emissivity.

Counts are taken to be temperatures in 1/64 K (UNCERTAIN, see the codec). The camera runs at its own
25 frames/s, knows no trigger, no frame counter and no clock: frames that it loses are not noticed, and two of
them cannot be synchronised. It closes its shutter by itself; a picture that equals the one before in every
pixel is flagged as shutter. The command that closes the shutter is not verified by anybody, and not used.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from thermacq.devices import (
    CameraCapabilities,
    Counts,
    DeviceContext,
    DeviceIdentity,
    Frame,
    FrameFlag,
    FrameHost,
    Settings,
    TriggerMode,
)
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout, IncompleteFrame
from thermacq.settings import check_settings
from thermacq.transports import Transports, VideoNode
from thermacq_drivers.p2pro import IDS, codec
from thermacq_drivers.p2pro.codec import Info, Parameter
from thermacq_drivers.p2pro.control import P2ProControl
from thermacq_drivers.transports.video import VideoStream, find_video

_WAIT_S = 0.05
_FIRST_PICTURE_S = 5.0
_RATE_TOLERANCE = 0.02
_GAINS = ("low", "high")


class P2ProSettings(BaseModel):
    """Settings of a P2 Pro or TC001."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    gain: Literal["high", "low"] = Field("high", description="low measures hotter scenes, less finely")
    emissivity: float = Field(0.95, gt=0, le=1, description="of the scene; set in steps of 1/127")
    timeout_s: float = Field(2.0, gt=0, le=60, description="longest wait for a frame")


class P2ProCamera:
    """The camera behind ``driver = "p2pro"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._transports = context.transports
        self._serial = context.serial
        self._settings = P2ProSettings()
        self._node: VideoNode | None = None
        self._stream: VideoStream | None = None
        self._shown: Counts | None = None
        self._good = 0

    @property
    def capabilities(self) -> CameraCapabilities:
        """What it can do."""
        return CameraCapabilities(
            rows=codec.ROWS,
            columns=codec.COLUMNS,
            bit_depth=16,
            max_frame_rate_hz=codec.RATE_HZ,
            trigger_modes=frozenset({TriggerMode.FREE_RUN}),
            has_shutter=True,
        )

    def open(self) -> DeviceIdentity:
        """Find the camera with the rig's serial number, or the only one; it streams while it is asked who it is."""
        self.close()
        nodes = [node for node in self._transports.video_nodes() if (node.vid, node.pid) in IDS]
        nameless = [node for node in nodes if not node.serial]
        if not self._serial or not nameless or self._serial in [node.serial for node in nodes]:
            chosen = next((node for node in nodes if self._serial == node.serial != ""), None)
            node = chosen or find_video(nodes, self._name, serial=self._serial)
            identity = self._identify(node)
        else:
            node, identity = self._ask_round(nameless)
        self._node, self._serial = node, identity.serial
        return identity

    def configure(self, settings: Settings) -> Settings:
        """Check settings; the camera takes them when it streams, with the next `arm`."""
        self.disarm()
        checked = check_settings(P2ProSettings, settings, self._name)
        self._require_open("configure")
        steps = codec.emissivity_steps(checked.emissivity)
        self._settings = checked.model_copy(update={"emissivity": codec.emissivity_of(steps)})
        return self._settings.model_dump()

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Stream, then set gain and emissivity and read them back."""
        self.disarm()
        node = self._require_open("arm")
        if mode is not TriggerMode.FREE_RUN:
            raise self._fault("arm", f"it knows no trigger; mode '{mode}' is not possible")
        if abs(frame_rate_hz / codec.RATE_HZ - 1) > _RATE_TOLERANCE:
            what = f"{frame_rate_hz:g} frames/s asked, it always makes {codec.RATE_HZ:g}"
            remedy = f"Set frame_rate_hz = {codec.RATE_HZ:g} in the rig."
            raise DeviceFault(self._name, "arm", what, remedy=remedy)
        stream = self._streaming(node, "arm")
        try:
            control = P2ProControl(self._name, self._transports, node)
            try:
                control.set_parameter(Parameter.GAIN, _GAINS.index(self._settings.gain), "arm")
                steps = codec.emissivity_steps(self._settings.emissivity)
                control.set_parameter(Parameter.EMISSIVITY, steps, "arm")
            finally:
                control.close()
        except DeviceFault:
            stream.close()
            raise
        self._stream, self._shown, self._good = stream, None, 0

    def trigger(self, index: int) -> None:
        """Not possible with this camera."""
        raise self._fault("trigger", f"it knows no trigger (index {index})")

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Take the thermal half of the pictures as they come."""
        stream = self._require_stream()
        heard_s = time.monotonic()
        while self._stream is stream and not host.stopping():
            shot = stream.take(_WAIT_S)
            if shot is not None:
                heard_s = time.monotonic()
                yield self._frame(shot.picture, shot.host_ns, host)
            elif time.monotonic() - heard_s > self._settings.timeout_s:
                what = f"no frame within {self._settings.timeout_s:g} s"
                raise DeviceTimeout(self._name, "acquire", what, last_frame=self._good - 1)

    def _frame(self, picture: np.ndarray, host_ns: int, host: FrameHost) -> Frame:
        try:
            counts = codec.thermal(picture)
        except ValueError as error:
            what = f"a frame is damaged: {error}"
            raise IncompleteFrame(self._name, "acquire", what, last_frame=self._good - 1) from None
        stands_still = self._shown is not None and np.array_equal(counts, self._shown)
        self._shown = counts
        buffer = host.buffer()
        np.copyto(buffer, counts)
        self._good += 1
        flags = FrameFlag.SHUTTER if stands_still else FrameFlag.NONE
        return Frame(counts=buffer, counter=-1, ticks=-1, host_ns=host_ns, flags=flags)

    def disarm(self) -> None:
        """Stop streaming."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()

    def close(self) -> None:
        """Stop streaming and let go of the camera."""
        self.disarm()
        self._node = None

    def _ask_round(self, nodes: list[VideoNode]) -> tuple[VideoNode, DeviceIdentity]:
        """Cameras without serial number on USB are asked one after another."""
        seen = []
        for node in nodes:
            try:
                identity = self._identify(node)
            except DeviceFault as fault:
                seen.append(fault.what)
                continue
            if identity.serial == self._serial:
                return node, identity
            seen.append(identity.serial)
        what = f"no camera with serial '{self._serial}'; attached: {', '.join(seen)}"
        raise DeviceDisconnected(self._name, "open", what, remedy="Check power and cable.")

    def _identify(self, node: VideoNode) -> DeviceIdentity:
        stream = self._streaming(node, "open")
        try:
            control = P2ProControl(self._name, self._transports, node)
            try:
                part, firmware, serial = (
                    control.text(what, "open") for what in (Info.PART_NUMBER, Info.FIRMWARE_DATE, Info.SERIAL)
                )
            finally:
                control.close()
        finally:
            stream.close()
        return DeviceIdentity("p2pro", part or node.product or "P2 Pro", node.serial or serial, firmware)

    def _streaming(self, node: VideoNode, stage: str) -> VideoStream:
        """Let the camera stream; returns after its first picture."""
        stream = VideoStream(self._name, self._transports, node.path, self._clock, stage)
        try:
            granted = stream.ask_for(codec.COLUMNS, codec.VIDEO_ROWS, codec.FOURCC, codec.RATE_HZ)
            if (granted.columns, granted.rows, granted.fourcc) != (
                codec.COLUMNS,
                codec.VIDEO_ROWS,
                codec.FOURCC,
            ):
                what = f"it offers no picture of {codec.COLUMNS} x {codec.VIDEO_ROWS} {codec.FOURCC}, but {granted}"
                raise self._fault(stage, what)
            deadline_s = time.monotonic() + _FIRST_PICTURE_S
            while stream.take(_WAIT_S, stage) is None:
                if time.monotonic() > deadline_s:
                    what = f"no picture came within {_FIRST_PICTURE_S:g} s"
                    raise DeviceTimeout(self._name, stage, what, remedy="Pull its plug and put it in again.")
        except DeviceFault:
            stream.close()
            raise
        return stream

    def _require_open(self, stage: str) -> VideoNode:
        if self._node is None:
            raise self._fault(stage, "it is not open")
        return self._node

    def _require_stream(self) -> VideoStream:
        if self._stream is None:
            raise self._fault("acquire", "it is not armed")
        return self._stream

    def _fault(self, stage: str, what: str) -> DeviceFault:
        return DeviceFault(self._name, stage, what)


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Video nodes with the USB ids of a P2 Pro; the serial number is that of the USB descriptor."""
    return [
        DeviceIdentity("p2pro", node.product or "P2 Pro", node.serial)
        for node in transports.video_nodes()
        if (node.vid, node.pid) in IDS
    ]
