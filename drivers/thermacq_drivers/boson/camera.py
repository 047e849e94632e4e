"""The camera behind ``driver = "boson"``: found by its serial number, set up over FSLP, read over UVC."""

from __future__ import annotations

import logging
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

from thermacq.devices import (
    CameraCapabilities,
    DeviceContext,
    DeviceIdentity,
    Frame,
    FrameHost,
    Settings,
    TriggerMode,
)
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.settings import check_settings
from thermacq.timing.clock import NS_PER_S
from thermacq.transports import Transports, VideoNode
from thermacq_drivers.boson import IDS
from thermacq_drivers.boson.acquisition import Acquisition, Picture, parse_temperature
from thermacq_drivers.boson.control import BosonControl, CommandRefused
from thermacq_drivers.boson.fslp import NOT_ENABLED, UNKNOWN_COMMAND, Function
from thermacq_drivers.boson.settings import FFC_MODES, GAIN_MODES, SYNC_MODES, BosonSettings
from thermacq_drivers.boson.telemetry import (
    EXTRA_ROWS,
    PACKINGS,
    Packing,
    Place,
    find_telemetry,
    read_telemetry,
)
from thermacq_drivers.transports.serial import SerialPort, find_port
from thermacq_drivers.transports.video import (
    Shot,
    VideoFormat,
    VideoStream,
    as_counts,
    find_video,
    identity_of,
)

_BAUD = 921_600
# (columns, rows) of the sensors, largest first.
_SIZES = ((640, 512), (320, 256))
_LINE_TIME_S = 32e-6
_USUAL_RATE_HZ = 60
_RATE_TOLERANCE = 0.02
_SLAVE = SYNC_MODES.index("slave")
_FFC_COMPLETE = 3
_FFC_S = 8.0
_FFC_BEGINS_NS = 100_000_000
_FFC_POLL_NS = 50_000_000
_FIRST_PICTURE_S = 5.0
_QUIET_S, _LONGEST_DRAIN_S = 0.3, 0.5
_LOOKS = 8

_log = logging.getLogger(__name__)


class BosonCamera:
    """A Boson or Boson+ with 640 x 512 or 320 x 256 pixels on USB."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._transports = context.transports
        self._serial = context.serial
        self._settings = BosonSettings()
        self._node = VideoNode("")
        self._port: SerialPort | None = None
        self._control: BosonControl | None = None
        self._number = 0
        self._picture = Picture(VideoFormat(*_SIZES[0], "Y16 ", _USUAL_RATE_HZ), None, 0)
        self._sync = 0
        self._acquisition: Acquisition | None = None

    @property
    def capabilities(self) -> CameraCapabilities:
        """What the camera delivers with the telemetry that `configure` found."""
        place, format_ = self._picture.place, self._picture.format
        return CameraCapabilities(
            rows=format_.rows - (EXTRA_ROWS if place else 0),
            columns=format_.columns,
            bit_depth=16,
            max_frame_rate_hz=format_.rate_hz,
            trigger_modes=frozenset((TriggerMode.FREE_RUN, TriggerMode.HARDWARE)),
            tick_rate_hz=1000.0 if place else 0.0,
            counter_bits=32 if place else 0,
            has_shutter=True,
            has_temperature=True,
            line_time_s=_LINE_TIME_S,
        )

    def open(self) -> DeviceIdentity:
        """Find the camera's video node and its serial port, by the serial number of both; ask who it is."""
        self.close()
        nodes = [node for node in self._transports.video_nodes() if (node.vid, node.pid) in IDS]
        node = find_video(nodes, self._name, serial=self._serial)
        port = SerialPort(self._name, self._port_of(node), _BAUD)
        control = BosonControl(self._name, port)
        try:
            port.discard("open")
            number = _unsigned(control.call(Function.CAMERA_SERIAL, stage="open"))
            part = control.call(Function.CAMERA_PART, stage="open").split(b"\0")[0].decode("ascii", "replace")
            revision = control.call(Function.SOFTWARE_REVISION, stage="open")
        except DeviceFault:
            port.close()
            raise
        firmware = ".".join(str(_unsigned(revision[place : place + 4])) for place in (0, 4, 8))
        self._node, self._port, self._control, self._number = node, port, control, number
        self._serial = identity_of(node)
        return DeviceIdentity("boson", f"FLIR Boson {part}".strip(), self._serial, firmware)

    def _port_of(self, node: VideoNode) -> str:
        """Path of the serial port of the same USB device."""
        ports = self._transports.serial_ports()
        ours = [port for port in ports if (port.vid, port.pid) in IDS and port.serial == node.serial]
        if not ours:
            raise DeviceDisconnected(
                self._name,
                "open",
                f"the serial port of camera '{identity_of(node)}' was not found, though its picture at "
                f"{node.path} was",
                remedy="Plug the camera in again; on Linux the kernel module cdc_acm makes the port.",
            )
        return find_port(ours, self._name).path

    def configure(self, settings: Settings) -> Settings:
        """Set up the camera and look for its telemetry; returns which one was found."""
        wanted = check_settings(BosonSettings, settings, self._name)
        self.disarm()
        control = self._opened("configure")
        self._set_sync(0, "configure")
        self._set_if_possible(Function.SET_USB_16_BIT_MODE, 0)
        control.set(Function.SET_FFC_MODE, FFC_MODES.index(wanted.ffc_mode), "configure")
        if wanted.gain != "leave":
            control.set(Function.SET_GAIN_MODE, GAIN_MODES.index(wanted.gain), "configure")
        return self._find_picture(wanted)

    def adopt(self) -> Settings:
        """Take over the modes that the camera is in; telemetry and sync are set, for no frame counts without."""
        self.disarm()
        control = self._opened("configure")
        self._set_sync(0, "configure")
        ffc_mode = _unsigned(control.call(Function.FFC_MODE, stage="configure"))
        gain = _unsigned(control.call(Function.GAIN_MODE, stage="configure"))
        found = {"gain": GAIN_MODES[gain] if gain < len(GAIN_MODES) else "leave"}
        if ffc_mode < len(FFC_MODES):
            found["ffc_mode"] = FFC_MODES[ffc_mode]
        return self._find_picture(self._settings.model_copy(update=found))

    def _find_picture(self, wanted: BosonSettings) -> Settings:
        """Agree on the format, and look for the telemetry in it; returns the settings in force."""
        place = self._find_telemetry(wanted)
        self._picture = Picture(self._negotiate(place is not None), place, self._number)
        self._settings = wanted.model_copy(update={"telemetry": place.packing if place else "none"})
        return self._settings.model_dump()

    def _find_telemetry(self, wanted: BosonSettings) -> Place | None:
        """Switch telemetry on and look where and how it comes; None when there is none and none is demanded."""
        if wanted.telemetry == "none":
            self._set_if_possible(Function.SET_TELEMETRY_STATE, 0)
            return None
        packings = PACKINGS if wanted.telemetry == "auto" else (wanted.telemetry,)
        place = self._look_for_telemetry(packings) if self._switch_telemetry_on(packings) else None
        if place is None and wanted.telemetry != "auto":
            what = (
                f"no telemetry row in {wanted.telemetry} packing with serial number {self._number} was found"
            )
            remedy = "Set telemetry = 'auto' to look for others, or 'none' to do without."
            raise DeviceFault(self._name, "configure", what, remedy=remedy)
        if place is None:
            _log.warning(
                "device '%s': no telemetry row was found: its frames have no counter and host times only, so "
                "frames that the camera loses are not noticed",
                self._name,
            )
            self._set_if_possible(Function.SET_TELEMETRY_STATE, 0)
        return place

    def _switch_telemetry_on(self, packings: tuple[Packing, ...]) -> bool:
        self._set_if_possible(Function.SET_TELEMETRY_LOCATION, 0)
        self._set_if_possible(Function.SET_TELEMETRY_PACKING, 2 if packings == ("8-bit",) else 0)
        self._set_if_possible(Function.SET_TELEMETRY_ORDER, 0)
        return self._set_if_possible(Function.SET_TELEMETRY_STATE, 1)

    def _look_for_telemetry(self, packings: tuple[Packing, ...]) -> Place | None:
        """Place of a record with the right serial number, whose counter counts."""
        stream = self._open_stream("configure")
        try:
            granted = self._ask_for_size(stream, EXTRA_ROWS)
            if granted is None:
                return None
            before: tuple[Place, int] | None = None
            # The first pictures may be from before it was switched on.
            for _ in range(_LOOKS):
                shot = self._first_shot(stream, "configure")
                counts = as_counts(shot.picture, granted)
                place = find_telemetry(counts, self._number, packings)
                if place is None:
                    continue
                counter = read_telemetry(counts[place.row], place.packing).counter
                if before is not None and before[0] == place and 0 < (counter - before[1]) % 2**32 < 2**31:
                    return place
                before = place, counter
            return None
        except ValueError:
            return None
        finally:
            stream.close()

    def _negotiate(self, with_telemetry: bool) -> VideoFormat:
        """The format in which pictures will come, at the fastest rate of camera and format."""
        stream = self._open_stream("configure")
        try:
            granted = self._ask_for_size(stream, EXTRA_ROWS if with_telemetry else 0)
            offered = stream.granted()
        finally:
            stream.close()
        if granted is None:
            what = f"it offers no 16-bit pictures of 640 x 512 or 320 x 256, but {offered}"
            raise DeviceFault(self._name, "configure", what, remedy="Is this a Boson with USB video?")
        camera_hz = 0
        with suppress(CommandRefused):
            camera_hz = _unsigned(self._opened("configure").call(Function.FRAME_RATE, stage="configure"))
        rate_hz = min(filter(None, (granted.rate_hz, camera_hz)), default=_USUAL_RATE_HZ)
        return replace(granted, rate_hz=float(rate_hz))

    def _ask_for_size(self, stream: VideoStream, extra_rows: int, rate_hz: float = 0) -> VideoFormat | None:
        for columns, rows in _SIZES:
            granted = stream.ask_for(columns, rows + extra_rows, "Y16 ", rate_hz or _USUAL_RATE_HZ)
            if (granted.columns, granted.rows, granted.fourcc) == (columns, rows + extra_rows, "Y16 "):
                return granted
        return None

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Correct the flat field, then set the external sync; as a slave, stream before the first pulse."""
        self.disarm()
        self._opened("arm")
        declared, settings = self.capabilities, self._settings
        if mode not in declared.trigger_modes:
            raise DeviceFault(self._name, "arm", f"it cannot run in mode '{mode}'")
        if not 0 < frame_rate_hz <= declared.max_frame_rate_hz:
            what = f"{frame_rate_hz:g} frames/s asked, at most {declared.max_frame_rate_hz:g} possible"
            raise DeviceFault(self._name, "arm", what)
        free = mode is TriggerMode.FREE_RUN
        # The flat field is corrected from frames: a slave without pulses makes none.
        self._set_sync(0, "arm")
        if settings.ffc_at_arm:
            self._run_ffc()
        stream = self._open_stream("arm")
        try:
            self._set_rate(stream, frame_rate_hz if free else declared.max_frame_rate_hz, exact=free)
            if free:
                self._set_sync(SYNC_MODES.index(settings.sync_in_free_run), "arm")
            else:
                self._become_slave(stream)
            temperature_k = parse_temperature(self._opened("arm").call(Function.FPA_TEMPERATURE, stage="arm"))
        except DeviceFault:
            stream.close()
            raise
        self._acquisition = Acquisition(
            self._name,
            stream,
            self._opened("arm"),
            self._picture,
            temperature_k=temperature_k,
            temperature_every_s=settings.temperature_every_s,
            timeout_s=settings.timeout_s,
            clock=self._clock,
        )

    def _set_rate(self, stream: VideoStream, rate_hz: float, *, exact: bool) -> None:
        granted = self._ask_for_size(stream, EXTRA_ROWS if self._picture.place else 0, rate_hz)
        if granted is None:
            raise DeviceFault(self._name, "arm", f"it streams {stream.granted()} now, not as configured")
        if exact and granted.rate_hz and abs(granted.rate_hz / rate_hz - 1) > _RATE_TOLERANCE:
            what = f"{rate_hz:g} frames/s asked, by itself it makes {granted.rate_hz:g}"
            remedy = "Ask for a rate of its own (60 or 30 frames/s), or trigger it (mode 'hardware')."
            raise DeviceFault(self._name, "arm", what, remedy=remedy)

    def _become_slave(self, stream: VideoStream) -> None:
        """Stream first, then follow the line; the few pictures from before that wait are thrown away."""
        self._first_shot(stream, "arm")
        self._set_sync(_SLAVE, "arm")
        deadline_s = time.monotonic() + _LONGEST_DRAIN_S
        while time.monotonic() < deadline_s and stream.take(_QUIET_S, "arm") is not None:
            pass
        stream.begin()

    def _run_ffc(self) -> None:
        control = self._opened("arm")
        control.call(Function.RUN_FFC, stage="arm")
        deadline_ns = self._clock.now_ns() + round(_FFC_S * NS_PER_S)
        self._pause(_FFC_BEGINS_NS)
        while _unsigned(control.call(Function.FFC_STATUS, stage="arm")) != _FFC_COMPLETE:
            if self._clock.now_ns() > deadline_ns:
                what = f"its flat-field correction was not complete after {_FFC_S:g} s"
                remedy = "Does its shutter click? A camera without shutter needs ffc_at_arm = false."
                raise DeviceTimeout(self._name, "arm", what, remedy=remedy)
            self._pause(_FFC_POLL_NS)

    def _pause(self, ns: int) -> None:
        self._clock.wait_until_ns(self._clock.now_ns() + ns)

    def trigger(self, index: int) -> None:
        """There are no software triggers."""
        raise DeviceFault(self._name, "trigger", f"it has no software trigger (index {index})")

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Yield pictures in the host's buffers."""
        if self._acquisition is None:
            raise DeviceFault(self._name, "acquire", "it is not armed")
        yield from self._acquisition.frames(host)

    def disarm(self) -> None:
        """Stop streaming."""
        acquisition, self._acquisition = self._acquisition, None
        if acquisition is not None:
            acquisition.end()

    def close(self) -> None:
        """Let go of the camera; a slave runs free again, for whoever looks at it next."""
        self.disarm()
        control, self._control = self._control, None
        if control is not None and self._sync == _SLAVE:
            with suppress(DeviceFault):
                control.tell(Function.SET_EXT_SYNC, 0, "close")
        self._sync = 0
        if self._port is not None:
            self._port.close()
            self._port = None

    def _open_stream(self, stage: str) -> VideoStream:
        return VideoStream(self._name, self._transports, self._node.path, self._clock, stage)

    def _first_shot(self, stream: VideoStream, stage: str) -> Shot:
        deadline_s = time.monotonic() + _FIRST_PICTURE_S
        while time.monotonic() < deadline_s:
            shot = stream.take(_QUIET_S, stage)
            if shot is not None:
                return shot
        what = f"no picture came within {_FIRST_PICTURE_S:g} s"
        raise DeviceTimeout(self._name, stage, what, remedy="Switch the camera off and on.")

    def _set_sync(self, value: int, stage: str) -> None:
        self._opened(stage).set(Function.SET_EXT_SYNC, value, stage)
        self._sync = value

    def _set_if_possible(self, function: Function, value: int) -> bool:
        """Set what older firmware does not have; whether it did."""
        try:
            self._opened("configure").set(function, value, "configure")
        except CommandRefused as refused:
            if refused.status in (UNKNOWN_COMMAND, NOT_ENABLED):
                return False
            raise
        return True

    def _opened(self, stage: str) -> BosonControl:
        if self._control is None:
            raise DeviceFault(self._name, stage, "it is not open")
        return self._control


def _unsigned(data: bytes) -> int:
    return struct.unpack(">I", data)[0] if len(data) == 4 else 0


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Video nodes with the USB ids of a Boson."""
    return [
        DeviceIdentity("boson", node.product or "FLIR Boson", identity_of(node))
        for node in transports.video_nodes()
        if (node.vid, node.pid) in IDS
    ]
