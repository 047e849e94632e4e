"""The camera behind ``driver = "uvc"``: any video node, in the format that the settings name, as it comes."""

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
from thermacq.errors import DeviceFault, DeviceTimeout, IncompleteFrame
from thermacq.settings import check_settings
from thermacq.transports import Transports, VideoNode
from thermacq_drivers.transports.v4l2 import offered_formats
from thermacq_drivers.transports.video import (
    Shot,
    VideoFormat,
    VideoStream,
    as_counts,
    find_video,
    identity_of,
)
from thermacq_drivers.uvc import LEPTON_IDS
from thermacq_drivers.uvc.lepton import EXTRA_ROWS, LeptonTelemetry, WordOrder, read_row, word_order

_LEPTON_ROWS = (60 + EXTRA_ROWS, 120 + EXTRA_ROWS)
_WAIT_S = 0.05
_FIRST_PICTURE_S = 5.0
_LOOKS = 10
# Asked for to get the fastest rate: cameras take the nearest that they have.
_FASTEST_HZ = 1000.0
_RATE_TOLERANCE = 0.02
_TURN = 1 << 32


class UvcSettings(BaseModel):
    """Settings of a video camera; what `configure` returns is what the camera granted."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    node: str = Field("", description="path such as /dev/video0, for a camera without serial number")
    columns: int = Field(0, ge=0, le=8192, description="width; 0: as the camera starts")
    rows: int = Field(0, ge=0, le=8192, description="height, telemetry rows included; 0: as it starts")
    fourcc: Literal["Y16", "GREY", "YUYV", "UYVY"] = Field(
        "Y16", description="pixel format; of YUYV and UYVY the luminance is taken"
    )
    telemetry: Literal["auto", "lepton", "none"] = Field(
        "auto", description="rows of a Lepton below the picture; auto: by USB ids and height"
    )
    word_order: Literal["auto", "low_first", "high_first"] = Field(
        "auto", description="of 32-bit numbers in the telemetry; auto: that in which its time goes on"
    )
    timeout_s: float = Field(5.0, gt=0, le=600, description="longest wait for a frame")


class UvcCamera:
    """A camera that can be read through Video4Linux; it runs free, and has host times only."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._transports = context.transports
        self._serial, self._path = context.serial, str(context.settings.get("node", ""))
        self._settings = UvcSettings()
        self._node = VideoNode("")
        self._format = VideoFormat(1, 1, "Y16 ", 1.0)
        self._order: WordOrder | None = None
        self._stream: VideoStream | None = None
        self._begin_anew()

    @property
    def capabilities(self) -> CameraCapabilities:
        """What the camera granted; valid once it is configured."""
        told = self._order is not None
        return CameraCapabilities(
            rows=self._format.rows - (EXTRA_ROWS if told else 0),
            columns=self._format.columns,
            bit_depth=16 if self._format.fourcc == "Y16 " else 8,
            max_frame_rate_hz=self._format.rate_hz,
            trigger_modes=frozenset((TriggerMode.FREE_RUN,)),
            tick_rate_hz=1000.0 if told else 0.0,
            counter_bits=32 if told else 0,
            has_shutter=told,
            has_temperature=told,
        )

    def open(self) -> DeviceIdentity:
        """Find the node by serial number, else by the settings' path, else the only one."""
        self.close()
        nodes = self._transports.video_nodes()
        # A path leads to the camera the first time; after that it is known by what it is.
        node = find_video(nodes, self._name, serial=self._serial, path="" if self._serial else self._path)
        VideoStream(self._name, self._transports, node.path, self._clock).close()
        self._node, self._serial = node, identity_of(node)
        return DeviceIdentity("uvc", node.product or "video camera", self._serial)

    def configure(self, settings: Settings) -> Settings:
        """Agree on a format and look for telemetry; returns what is in force."""
        self.disarm()
        wanted = check_settings(UvcSettings, settings, self._name)
        if not self._node.path:
            raise DeviceFault(self._name, "configure", "it is not open")
        stream = self._open_stream("configure")
        try:
            granted = stream.ask_for(wanted.columns, wanted.rows, wanted.fourcc.ljust(4), _FASTEST_HZ)
            self._check_granted(wanted, granted)
            order = self._find_telemetry(wanted, stream, granted)
        finally:
            stream.close()
        rate_hz = granted.rate_hz if granted.rate_hz > 0 else _FASTEST_HZ
        self._format = VideoFormat(granted.columns, granted.rows, granted.fourcc, rate_hz)
        self._order = order
        self._settings = wanted.model_copy(
            update={
                "columns": granted.columns,
                "rows": granted.rows,
                "telemetry": "lepton" if order else "none",
                "word_order": order or wanted.word_order,
            }
        )
        return self._settings.model_dump()

    def _check_granted(self, wanted: UvcSettings, granted: VideoFormat) -> None:
        if (
            granted.fourcc == wanted.fourcc.ljust(4)
            and wanted.columns in (0, granted.columns)
            and wanted.rows in (0, granted.rows)
        ):
            return
        size = f"{wanted.columns} x {wanted.rows} " if wanted.columns or wanted.rows else ""
        what = f"{size}'{wanted.fourcc}' was asked for, the camera grants {granted}"
        offered = "; ".join(offered_formats(self._node.path)) or "unknown"
        raise DeviceFault(self._name, "configure", what, remedy=f"Formats that it offers: {offered}.")

    def _find_telemetry(
        self, wanted: UvcSettings, stream: VideoStream, granted: VideoFormat
    ) -> WordOrder | None:
        is_lepton = (self._node.vid, self._node.pid) == LEPTON_IDS
        possible = granted.rows in _LEPTON_ROWS and granted.fourcc == "Y16 "
        if wanted.telemetry == "none" or (wanted.telemetry == "auto" and not (is_lepton and possible)):
            return None
        if wanted.telemetry == "lepton" and not possible:
            what = f"a picture of {granted} has no telemetry rows"
            raise DeviceFault(self._name, "configure", what, remedy="Ask for 122 (or 62) rows of 'Y16'.")
        if wanted.word_order != "auto":
            return wanted.word_order
        order = self._look_for_order(stream, granted)
        if order is None and wanted.telemetry == "lepton":
            what = "its telemetry rows hold no time that goes on"
            raise DeviceFault(self._name, "configure", what, remedy="Give word_order, or telemetry = 'none'.")
        return order

    def _look_for_order(self, stream: VideoStream, granted: VideoFormat) -> WordOrder | None:
        first = as_counts(self._first_shot(stream).picture, granted)[-EXTRA_ROWS]
        for _ in range(_LOOKS):
            row = as_counts(self._first_shot(stream).picture, granted)[-EXTRA_ROWS]
            if order := word_order(first, row):
                return order
        return None

    def _first_shot(self, stream: VideoStream) -> Shot:
        deadline_s = time.monotonic() + _FIRST_PICTURE_S
        while time.monotonic() < deadline_s:
            if shot := stream.take(_WAIT_S, "configure"):
                return shot
        what = f"no picture came within {_FIRST_PICTURE_S:g} s"
        raise DeviceTimeout(self._name, "configure", what, remedy="Plug the camera in again.")

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Agree on the rate; the camera starts with the first frame asked for."""
        self.disarm()
        if not self._node.path:
            raise DeviceFault(self._name, "arm", "it is not open")
        if mode is not TriggerMode.FREE_RUN:
            raise DeviceFault(self._name, "arm", f"it cannot run in mode '{mode}', only free_run")
        fastest_hz = self._format.rate_hz
        if not 0 < frame_rate_hz <= fastest_hz:
            what = f"{frame_rate_hz:g} frames/s asked, at most {fastest_hz:g} possible"
            raise DeviceFault(self._name, "arm", what)
        stream = self._open_stream("arm")
        wanted = self._format
        granted = stream.ask_for(wanted.columns, wanted.rows, wanted.fourcc, frame_rate_hz)
        rate_fits = granted.rate_hz <= 0 or abs(granted.rate_hz / frame_rate_hz - 1) <= _RATE_TOLERANCE
        same = (granted.columns, granted.rows, granted.fourcc) == (wanted.columns, wanted.rows, wanted.fourcc)
        if not (same and rate_fits):
            stream.close()
            what = f"{frame_rate_hz:g} frames/s asked, the camera grants {granted}"
            raise DeviceFault(self._name, "arm", what, remedy="Ask for a rate that the camera has.")
        self._stream = stream
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Forget the frames of an earlier acquisition."""
        self._before: LeptonTelemetry | None = None
        self._previous: Counts | None = None
        self._copies, self._turns, self._good = 0, 0, 0

    def trigger(self, index: int) -> None:
        """There are no software triggers."""
        raise DeviceFault(self._name, "trigger", f"it has no software trigger (index {index})")

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Yield pictures in the host's buffers."""
        stream = self._stream
        if stream is None:
            raise DeviceFault(self._name, "acquire", "it is not armed")
        heard_s = time.monotonic()
        while self._stream is stream and not host.stopping():
            shot = stream.take(_WAIT_S)
            if shot is not None:
                heard_s = time.monotonic()
                frame = self._frame(shot, host)
                if frame is not None:
                    yield frame
            elif time.monotonic() - heard_s > self._settings.timeout_s:
                what = f"no frame came for {self._settings.timeout_s:g} s"
                raise self._fault(DeviceTimeout, what)

    def _frame(self, shot: Shot, host: FrameHost) -> Frame | None:
        """Frame of a picture; None for one that came before."""
        try:
            counts = as_counts(shot.picture, self._format)
        except ValueError as error:
            raise self._fault(IncompleteFrame, str(error)) from None
        counter, ticks, flags, fpa_k = -1, -1, FrameFlag.NONE, float("nan")
        if self._order is not None:
            said = self._note(read_row(counts[-EXTRA_ROWS], self._order))
            if said is None:
                return None
            counts = counts[:-EXTRA_ROWS]
            frozen = self._previous is not None and np.array_equal(counts, self._previous)
            self._previous = counts
            counter, ticks, fpa_k = said.counter, self._turns * _TURN + said.time_ms, said.fpa_k
            flags = FrameFlag.SHUTTER if said.ffc_in_progress or frozen else FrameFlag.NONE
        buffer = host.buffer()
        np.copyto(buffer, counts)
        self._good += 1
        return Frame(buffer, counter, ticks, shot.host_ns, flags=flags, fpa_temperature_k=fpa_k)

    def _note(self, said: LeptonTelemetry) -> LeptonTelemetry | None:
        """Check a telemetry row against the one before; None for that of a frame that came again."""
        before = self._before
        if not said.may_follow(before):
            raise self._fault(IncompleteFrame, "a frame with a damaged telemetry row was thrown away")
        if before is not None and said.counter == before.counter:
            self._copies += 1
            if self._copies == 1:
                what = f"frame {said.counter} came again; its copies are thrown away, no picture is lost"
                raise self._fault(IncompleteFrame, what)
            return None
        if before is not None and said.time_ms < before.time_ms:
            self._turns += 1
        self._before, self._copies = said, 0
        return said

    def disarm(self) -> None:
        """Stop streaming."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()

    def close(self) -> None:
        """Let go of the camera."""
        self.disarm()
        self._node = VideoNode("")

    def _open_stream(self, stage: str) -> VideoStream:
        return VideoStream(self._name, self._transports, self._node.path, self._clock, stage)

    def _fault(self, kind: type[DeviceFault], what: str) -> DeviceFault:
        return kind(self._name, "acquire", what, last_frame=self._good - 1)


def discover(transports: Transports) -> list[DeviceIdentity]:
    """All video nodes, whatever camera is behind them."""
    return [
        DeviceIdentity("uvc", node.product or "video camera", identity_of(node))
        for node in transports.video_nodes()
    ]
