"""The Seek camera: initialisation, one frame for each request, and its own shutter frames.

The camera closes its shutter by itself every few seconds to minutes and cannot be kept from it. Every frame
that shows no scene (its shutter, other calibration) is delivered as it is and flagged as shutter. Scenes are
delivered minus the last shutter frame, plus 0x4000, with dead pixels filled; the setting ``flat = false``
delivers their raw counts instead. The camera knows no trigger and no clock: two of them cannot be
synchronised. Its serial number is that of its factory settings; whether the USB descriptor holds the same is
UNCERTAIN, and where it is empty only one camera at a time can be used.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress

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
from thermacq.timing import NS_PER_S
from thermacq.transports import Transports
from thermacq_drivers.seek import codec
from thermacq_drivers.seek.codec import COMPACT, FrameType, Model, RawFrame, Request
from thermacq_drivers.transports.usb import UsbPort, UsbStalled, find_devices, serial_of

_TRANSFER_S = 0.5
_SLICE_S = 0.05
_INIT_TRIES = 3
# libseek-thermal gives up as soon.
_MOST_FRAMES_TO_FIRST = 40


class SeekSettings(BaseModel):
    """Settings of a Seek camera."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    flat: bool = Field(
        True, description="take off the last shutter frame and fill dead pixels; false: raw counts"
    )
    counter_word: int = Field(
        -1, ge=-1, le=1000, description="word that holds the frame counter; -1: that of the model"
    )
    timeout_s: float = Field(2.0, gt=0, le=60, description="longest wait for a frame")


class SeekCamera:
    """The camera behind ``driver = "seek"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._transports = context.transports
        self._serial = context.serial
        self._settings = SeekSettings()
        self._model: Model = COMPACT
        self._port: UsbPort | None = None
        self._period_ns = 0
        self._last = -1
        self._shutter: Counts | None = None
        self._passes: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    @property
    def capabilities(self) -> CameraCapabilities:
        """What the model can do."""
        return CameraCapabilities(
            rows=self._model.rows,
            columns=self._model.columns,
            bit_depth=16 if self._settings.flat else 14,
            max_frame_rate_hz=self._model.max_frame_rate_hz,
            trigger_modes=frozenset({TriggerMode.FREE_RUN}),
            counter_bits=16,
            has_shutter=True,
        )

    def open(self) -> DeviceIdentity:
        """Find the camera, initialise it and read its serial number."""
        self.close()
        ids = [(codec.VID, pid) for pid in codec.MODELS]
        on_bus = [serial_of(device) for device in find_devices(self._transports, ids)]
        port = UsbPort(self._name, self._transports, ids, self._serial if any(on_bus) else "")
        try:
            self._model = codec.MODELS[port.device.idProduct]
            serial = self._initialise(port)
        except DeviceFault:
            port.close()
            raise
        if self._serial not in ("", serial):
            port.close()
            what = f"the camera has serial number '{serial}', the rig expects '{self._serial}'"
            raise DeviceFault(self._name, "open", what, remedy="Attach the right camera, or correct the rig.")
        self._port, self._serial = port, serial
        return DeviceIdentity("seek", self._model.name, serial)

    def configure(self, settings: Settings) -> Settings:
        """Apply settings."""
        self.disarm()
        checked = check_settings(SeekSettings, settings, self._name)
        if checked.counter_word < 0:
            checked = checked.model_copy(update={"counter_word": self._model.counter_word})
        self._settings = checked
        return checked.model_dump()

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Get the camera's first frame (for dead pixels) and its first shutter frame."""
        self.disarm()
        port = self._require_port("arm")
        if mode is not TriggerMode.FREE_RUN:
            raise self._fault("arm", f"it knows no trigger; mode '{mode}' is not possible")
        fastest_hz = self._model.max_frame_rate_hz
        if not 0 < frame_rate_hz <= fastest_hz:
            raise self._fault("arm", f"{frame_rate_hz:g} frames/s asked, at most {fastest_hz:g} possible")
        self._last = -1
        if self._shutter is None:
            self._find_references(port)
        self._period_ns = round(NS_PER_S / frame_rate_hz)

    def trigger(self, index: int) -> None:
        """Not possible with this camera."""
        raise self._fault("trigger", f"it knows no trigger (index {index})")

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Ask for one frame after another, at the rate that was asked for or as fast as they come."""
        port = self._require_port("acquire")
        if not self._period_ns:
            raise self._fault("acquire", "it is not armed")
        due_ns = self._clock.now_ns()
        while self._period_ns:
            self._clock.wait_until_ns(due_ns, host.stopping)
            if host.stopping():
                return
            # A frame that came late moves the following ones; none is caught up.
            due_ns = max(due_ns + self._period_ns, self._clock.now_ns())
            raw = self._fetch(port, "acquire", host)
            if raw is None:
                return
            yield self._frame(raw, host.buffer())

    def _frame(self, raw: RawFrame, counts: Counts) -> Frame:
        picture = codec.visible(raw.words, self._model)
        is_scene = raw.type == FrameType.SCENE
        if raw.type == FrameType.SHUTTER:
            self._shutter = picture.copy()
        if is_scene and self._settings.flat and self._shutter is not None:
            np.copyto(counts, codec.flatten(picture, self._shutter))
            codec.fill(counts, self._passes)
        else:
            np.copyto(counts, picture)
        self._last = raw.counter
        return Frame(
            counts=counts,
            counter=raw.counter,
            ticks=-1,
            host_ns=self._clock.now_ns(),
            flags=FrameFlag.NONE if is_scene else FrameFlag.SHUTTER,
        )

    def disarm(self) -> None:
        """Ask for no more frames."""
        self._period_ns = 0

    def close(self) -> None:
        """Put the camera to sleep and let go of it."""
        self.disarm()
        self._shutter = None
        if self._port is not None:
            with suppress(DeviceFault):
                self._sleep(self._port, "close")
            self._port.close()
            self._port = None

    def _initialise(self, port: UsbPort) -> str:
        """Bring the camera to run; returns its serial number."""
        try:
            port.control_out(codec.OUT, Request.TARGET_PLATFORM, 0, 0, b"\x01", "open")
        except UsbStalled:
            # It was left running by another program.
            self._sleep(port, "open")
            port.control_out(codec.OUT, Request.TARGET_PLATFORM, 0, 0, b"\x01", "open")
        serial, was_asked = "", codec.factory_read(codec.SERIAL_WORDS, codec.SERIAL_ADDRESS)[0]
        previous: codec.Step | None = None
        for step in codec.init_steps(self._model):
            request, content, length = step
            if length:
                answer = port.control_in(codec.IN, request, 0, 0, length, "open")
                if previous == was_asked:
                    serial = codec.parse_serial(answer)
            else:
                port.control_out(codec.OUT, request, 0, 0, content, "open")
            previous = step
        return serial

    def _sleep(self, port: UsbPort, stage: str) -> None:
        for _ in range(3):
            port.control_out(codec.OUT, Request.SET_OPERATION_MODE, 0, 0, b"\x00\x00", stage)

    def _find_references(self, port: UsbPort) -> None:
        """The frame for dead pixels comes first, a shutter frame soon after; a short first one is tried again."""
        first: Counts | None = None
        damaged = 0
        for _ in range(_MOST_FRAMES_TO_FIRST):
            try:
                raw = self._fetch(port, "arm", None)
            except IncompleteFrame:
                # The camera sometimes drops the first 512 bytes after its start.
                damaged += 1
                if damaged >= _INIT_TRIES:
                    raise
                self._initialise(port)
                continue
            if raw is not None and raw.type == FrameType.FIRST:
                first = codec.visible(raw.words, self._model).copy()
            elif raw is not None and raw.type == FrameType.SHUTTER:
                self._shutter = codec.visible(raw.words, self._model).copy()
            if first is not None and self._shutter is not None:
                self._passes = codec.fill_order(codec.dead_pixels(first))
                return
        raise DeviceTimeout(
            self._name, "arm", f"no first and shutter frame among {_MOST_FRAMES_TO_FIRST} frames"
        )

    def _fetch(self, port: UsbPort, stage: str, host: FrameHost | None) -> RawFrame | None:
        """Ask for a frame and read it whole; None when the host stops.

        Raises
        ------
        IncompleteFrame
            Part of it was lost; the next request begins afresh.
        DeviceTimeout
            Nothing came in time.
        """
        deadline_s = time.monotonic() + self._settings.timeout_s
        data = b""
        try:
            request = codec.image_request(self._model)
            port.control_out(codec.OUT, Request.START_GET_IMAGE_TRANSFER, 0, 0, request, stage)
            while len(data) < 2 * self._model.words:
                if host is not None and host.stopping():
                    return None
                piece = self._read_piece(port, stage, data, deadline_s)
                data += piece
                # A transfer that is not full ends the frame.
                if piece and len(piece) < self._model.chunk_bytes:
                    break
        except UsbStalled:
            port.clear_halt(codec.IMAGE_ENDPOINT, stage)
            raise self._incomplete(stage, "the camera refused it (stall)") from None
        try:
            return codec.parse_frame(data, self._model, self._counter_word())
        except ValueError as error:
            raise self._incomplete(stage, str(error)) from None

    def _read_piece(self, port: UsbPort, stage: str, so_far: bytes, deadline_s: float) -> bytes:
        """One transfer; empty while nothing comes and there is still time."""
        try:
            return port.bulk_read(codec.IMAGE_ENDPOINT, self._model.chunk_bytes, _SLICE_S, stage)
        except DeviceTimeout:
            if so_far and time.monotonic() > deadline_s - self._settings.timeout_s + _TRANSFER_S:
                raise self._incomplete(stage, f"only {len(so_far)} bytes came") from None
            if time.monotonic() > deadline_s:
                what = f"no frame within {self._settings.timeout_s:g} s"
                raise DeviceTimeout(self._name, stage, what, last_frame=self._last) from None
            return b""

    def _counter_word(self) -> int:
        word = self._settings.counter_word
        return self._model.counter_word if word < 0 else word

    def _incomplete(self, stage: str, what: str) -> IncompleteFrame:
        return IncompleteFrame(self._name, stage, f"a frame is damaged: {what}", last_frame=self._last)

    def _require_port(self, stage: str) -> UsbPort:
        if self._port is None:
            raise self._fault(stage, "it is not open")
        return self._port

    def _fault(self, stage: str, what: str) -> DeviceFault:
        return DeviceFault(self._name, stage, what)


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Cameras on USB, none opened; the serial number is that of the USB descriptor."""
    devices = find_devices(transports, [(codec.VID, pid) for pid in codec.MODELS])
    return [
        DeviceIdentity("seek", codec.MODELS[device.idProduct].name, serial_of(device)) for device in devices
    ]
