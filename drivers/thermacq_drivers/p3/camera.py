"""The P3 camera: its start sequence, its frames found by their markers, its shutter and gain.

Counts are temperatures in 1/64 K as the camera reckons them. The camera runs at its own 25 frames/s and
knows no trigger: two of them cannot be synchronised. It closes its shutter by itself about every 90 s and
cannot be kept from it; meanwhile the picture is taken to stand still, and a picture that equals the one
before in every pixel is flagged as shutter. UNCERTAIN: whether the descriptor of the USB device holds a serial
number; where it does not, the one in the camera's register 7 tells cameras apart.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Literal

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
from thermacq.timing import NS_PER_S
from thermacq.transports import Transports
from thermacq_drivers.p3 import IDS, codec
from thermacq_drivers.p3.codec import FrameFinder, Model, RawFrame
from thermacq_drivers.transports.usb import UsbPort, UsbStalled, find_devices, serial_of

_INTERFACES = (0, 1)
_READY_S = 1.0
_POLL_S = 0.005
_SLICE_S = 0.05
_RATE_TOLERANCE = 0.02


class P3Settings(BaseModel):
    """Settings of a P3 or P1."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    gain: Literal["high", "low"] = Field("high", description="high: -20 to 150 °C; low: 0 to 550 °C")
    shutter_at_arm: bool = Field(True, description="close the shutter once before the first frame")
    settle_s: float = Field(1.0, ge=0, le=10, description="wait between the start command and the stream")
    stream_settle_s: float = Field(2.0, ge=0, le=10, description="wait for the stream to begin")
    timeout_s: float = Field(2.0, gt=0, le=60, description="longest wait for a frame")


class P3Camera:
    """The camera behind ``driver = "p3"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._transports = context.transports
        self._serial = context.serial
        self._settings = P3Settings()
        self._model: Model = codec.MODELS[0x45A2]
        self._port: UsbPort | None = None
        self._streaming = False
        self._forget_stream()

    def _forget_stream(self) -> None:
        self._finder = FrameFinder(self._model)
        self._found: deque[tuple[RawFrame, int]] = deque()
        self._before: tuple[RawFrame, int] | None = None
        self._counter = -1
        self._shown: Counts | None = None

    @property
    def capabilities(self) -> CameraCapabilities:
        """What the model can do."""
        return CameraCapabilities(
            rows=self._model.rows,
            columns=self._model.columns,
            bit_depth=16,
            max_frame_rate_hz=codec.RATE_HZ,
            trigger_modes=frozenset({TriggerMode.FREE_RUN}),
            counter_bits=32,
            has_shutter=True,
        )

    def open(self) -> DeviceIdentity:
        """Find the camera with the rig's serial number, or the only one, and read what it is."""
        self.close()
        port, identity = self._find()
        self._model = codec.MODELS[port.device.idProduct]
        self._port, self._serial = port, identity.serial
        return identity

    def configure(self, settings: Settings) -> Settings:
        """Apply settings: the gain at once, the others with the next `arm`."""
        self.disarm()
        checked = check_settings(P3Settings, settings, self._name)
        self._order(self._require_port("configure"), codec.GAIN[checked.gain], "configure")
        self._settings = checked
        return checked.model_dump()

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Start the stream; takes the seconds that the settings say."""
        self.disarm()
        port = self._require_port("arm")
        if mode is not TriggerMode.FREE_RUN:
            raise self._fault("arm", f"it knows no trigger; mode '{mode}' is not possible")
        if abs(frame_rate_hz / codec.RATE_HZ - 1) > _RATE_TOLERANCE:
            what = f"{frame_rate_hz:g} frames/s asked, it always makes {codec.RATE_HZ:g}"
            raise DeviceFault(
                self._name, "arm", what, remedy=f"Set frame_rate_hz = {codec.RATE_HZ:g} in the rig."
            )
        self._forget_stream()
        self._ask(port, codec.START_STREAM, 1, "arm")
        time.sleep(self._settings.settle_s)
        port.select(1, 1, "arm")
        self._streaming = True
        port.control_out(*codec.START, 0, 1, b"", "arm")
        time.sleep(self._settings.stream_settle_s)
        # Thrown away; the camera may have nothing yet.
        with suppress(DeviceTimeout):
            port.bulk_read(codec.STREAM_ENDPOINT, self._model.read_bytes, _SLICE_S, "arm")
        self._ask(port, codec.START_STREAM, 1, "arm")
        if self._settings.shutter_at_arm:
            self._order(port, codec.SHUTTER, "arm")

    def trigger(self, index: int) -> None:
        """Not possible with this camera."""
        raise self._fault("trigger", f"it knows no trigger (index {index})")

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Read frames as they come, by their markers.

        Raises
        ------
        IncompleteFrame
            Bytes came that are no frame, and a frame is missing in the camera's count.
        DeviceTimeout
            No whole frame came in time.
        """
        port = self._require_stream()
        waiting_since_s = time.monotonic()
        while self._streaming and not host.stopping():
            if self._found:
                raw, counter = self._found.popleft()
                yield self._frame(raw, counter, host.buffer())
                waiting_since_s = time.monotonic()
            elif time.monotonic() - waiting_since_s > self._settings.timeout_s:
                what = f"no whole frame within {self._settings.timeout_s:g} s"
                raise DeviceTimeout(self._name, "acquire", what, last_frame=self._counter)
            else:
                self._read(port)

    def _read(self, port: UsbPort) -> None:
        """Read what there is of a transfer, and keep the frames that it completes."""
        try:
            data = port.bulk_read(codec.STREAM_ENDPOINT, self._model.read_bytes, _SLICE_S, "acquire")
        except DeviceTimeout:
            return
        except UsbStalled:
            port.clear_halt(codec.STREAM_ENDPOINT, "acquire")
            raise self._incomplete("the stream stalled") from None
        damaged = 0
        for raw in self._finder.feed(data):
            damaged += self._keep(raw)
        if damaged:
            raise self._incomplete(f"{damaged} bytes came that are no whole frame")

    def _keep(self, raw: RawFrame) -> int:
        """Number a frame by its markers; returns the bytes of a frame that was damaged before it, else 0."""
        now_ns = self._clock.now_ns()
        lost = 0
        if self._before is not None:
            earlier, earlier_ns = self._before
            if (raw.start.cnt1, raw.start.cnt3) == (earlier.start.cnt1, earlier.start.cnt3):
                return 0  # the same frame twice
            lost = codec.lost_frames(earlier.end.cnt3, raw.start.cnt3, (now_ns - earlier_ns) / NS_PER_S)
        self._before = raw, now_ns
        self._counter += 1 + lost
        self._found.append((raw, self._counter & 0xFFFFFFFF))
        return raw.skipped if lost else 0

    def _frame(self, raw: RawFrame, counter: int, counts: Counts) -> Frame:
        picture = codec.temperatures(raw.pixels, self._model)
        stands_still = self._shown is not None and np.array_equal(picture, self._shown)
        self._shown = picture
        np.copyto(counts, picture)
        return Frame(
            counts=counts,
            counter=counter,
            ticks=-1,
            host_ns=self._clock.now_ns(),
            flags=FrameFlag.SHUTTER if stands_still else FrameFlag.NONE,
        )

    def disarm(self) -> None:
        """Stop the stream."""
        if self._streaming and self._port is not None:
            with suppress(DeviceFault):
                self._port.select(1, 0, "disarm")
        self._streaming = False

    def close(self) -> None:
        """Stop the stream and let go of the camera."""
        self.disarm()
        if self._port is not None:
            self._port.close()
            self._port = None

    def _find(self) -> tuple[UsbPort, DeviceIdentity]:
        """Open the camera that is meant; those without serial number on USB are asked one after another."""
        devices = find_devices(self._transports, IDS)
        nameless = [device for device in devices if not serial_of(device)]
        if not self._serial or not nameless or self._serial in map(serial_of, devices):
            port = self._connect(devices, self._serial)
            return port, self._identify(port)
        seen = [serial for device in devices if (serial := serial_of(device))]
        for device in nameless:
            try:
                port = self._connect([device])
                identity = self._identify(port)
            except DeviceFault as fault:
                seen.append(fault.what)
                continue
            if identity.serial == self._serial:
                return port, identity
            port.close()
            seen.append(identity.serial)
        what = f"no device with serial '{self._serial}'; attached: {', '.join(seen)}"
        raise DeviceDisconnected(self._name, "open", what, remedy="Check power and cable.")

    def _connect(self, among: list[Any], serial: str = "") -> UsbPort:
        return UsbPort(self._name, self._transports, IDS, serial, _INTERFACES, among)

    def _identify(self, port: UsbPort) -> DeviceIdentity:
        """Read name, firmware and serial number; closes the port when that fails."""
        try:
            name, firmware, serial = (
                codec.parse_text(self._ask(port, codec.read_register(*register), register[1], "open"))
                for register in (codec.NAME, codec.FIRMWARE, codec.SERIAL)
            )
        except DeviceFault:
            port.close()
            raise
        model = name or codec.MODELS[port.device.idProduct].name
        return DeviceIdentity("p3", model, port.serial or serial, firmware)

    def _ask(self, port: UsbPort, command: bytes, length: int, stage: str) -> bytes:
        """Send a command and read its answer."""
        self._order(port, command, stage)
        answer = port.control_in(*codec.READ, 0, 0, length, stage)
        self._await_ready(port, stage)
        return answer

    def _order(self, port: UsbPort, command: bytes, stage: str) -> None:
        """Send a command that has no answer."""
        port.control_out(*codec.WRITE, 0, 0, command, stage)
        self._await_ready(port, stage)

    def _await_ready(self, port: UsbPort, stage: str) -> None:
        deadline_s = time.monotonic() + _READY_S
        while not codec.is_ready(status := port.control_in(*codec.STATUS, 0, 0, 1, stage)):
            if time.monotonic() > deadline_s:
                what = (
                    f"it is not done with a command after {_READY_S:g} s (status {status.hex() or 'empty'})"
                )
                raise DeviceTimeout(self._name, stage, what, remedy="Pull its plug and put it in again.")
            time.sleep(_POLL_S)

    def _incomplete(self, what: str) -> IncompleteFrame:
        return IncompleteFrame(self._name, "acquire", f"a frame is damaged: {what}", last_frame=self._counter)

    def _require_port(self, stage: str) -> UsbPort:
        if self._port is None:
            raise self._fault(stage, "it is not open")
        return self._port

    def _require_stream(self) -> UsbPort:
        if not self._streaming:
            raise self._fault("acquire", "it is not armed")
        return self._require_port("acquire")

    def _fault(self, stage: str, what: str) -> DeviceFault:
        return DeviceFault(self._name, stage, what)


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Cameras on USB, none opened; the serial number is that of the USB descriptor."""
    found: list[Any] = find_devices(transports, IDS)
    return [DeviceIdentity("p3", codec.MODELS[one.idProduct].name, serial_of(one)) for one in found]
