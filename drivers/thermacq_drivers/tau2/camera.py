"""The Tau 2 on a TeAx grabber: found by the grabber's serial number, set up through it, streamed over USB.

Counts are the 14 bits of the camera. There is neither a frame counter nor a clock in the stream as far as it is
known: frames that come damaged are counted, frames that the camera or the grabber left out are not noticed,
and times are those of receipt. Two cameras are synchronised by a trigger line (mode ``hardware``): the camera
is set to follow its external sync. UNCERTAIN: the numbers for that (settings ``sync_off`` and ``sync_slave``), the
camera's own frame rate (setting ``own_rate_hz``), and whether the grabber loses nothing between two reads.

Any board with an FT2232H has the same USB ids: with several attached, the rig must name the serial number.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import suppress
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
from thermacq.timing.clock import NS_PER_S
from thermacq.transports import Transports
from thermacq_drivers.tau2 import IDS, packets, teax
from thermacq_drivers.tau2.link import Shot, TauLink
from thermacq_drivers.tau2.packets import FFC_MODES, FFC_RUNNING, Answer, Function, Sensor
from thermacq_drivers.transports.usb import UsbPort, find_devices, serial_of

_FIRST_PICTURE_S = 3.0
_FFC_S = 8.0
_FFC_BEGINS_S = 0.1
_FFC_POLL_NS = 100_000_000
_QUIET_S, _LONGEST_DRAIN_S = 0.2, 1.5
_RATE_TOLERANCE = 0.02

_log = logging.getLogger(__name__)


class Tau2Settings(BaseModel):
    """Settings of a Tau 2."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    ffc_mode: Literal["manual", "auto", "external"] = Field(
        "manual", description="manual: no flat-field correction but those asked for here"
    )
    ffc_at_arm: bool = Field(True, description="run one flat-field correction before each recording")
    own_rate_hz: float = Field(30.0, gt=0, le=120, description="frame rate of the camera running free")
    sync_off: int = Field(0, ge=0, le=0xFFFF, description="number that switches external sync off")
    sync_slave: int = Field(1, ge=0, le=0xFFFF, description="number that makes it follow external sync")
    temperature_every_s: float = Field(
        2.0, ge=0.5, le=60, description="how often the temperature of the focal-plane array is read"
    )
    timeout_s: float = Field(5.0, gt=0, le=600, description="longest wait for a frame or trigger pulse")


class Tau2Camera:
    """The camera behind ``driver = "tau2"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._transports = context.transports
        self._serial = context.serial
        self._given = context.settings
        self._settings = Tau2Settings()
        self._link: TauLink | None = None
        self._size = (512, 640)
        self._sync = -1
        self._armed = False
        self._forget_stream()

    def _forget_stream(self) -> None:
        self._good = self._damaged = 0
        self._shown: Counts | None = None
        self._temperature_k = float("nan")
        self._ffc_runs = False
        self._ask_at_ns = 0
        self._next_question = Sensor.STATUS
        self._asked: Sensor | None = None

    @property
    def capabilities(self) -> CameraCapabilities:
        """What the camera delivers, with the size that was seen when it was opened."""
        rows, columns = self._size
        return CameraCapabilities(
            rows=rows,
            columns=columns,
            bit_depth=teax.BIT_DEPTH,
            max_frame_rate_hz=self._settings.own_rate_hz,
            trigger_modes=frozenset((TriggerMode.FREE_RUN, TriggerMode.HARDWARE)),
            has_shutter=True,
            has_temperature=True,
        )

    def open(self) -> DeviceIdentity:
        """Find the grabber, ask the camera behind it who it is, and look at one picture."""
        self.close()
        self._settings = check_settings(Tau2Settings, self._given, self._name)
        port = UsbPort(self._name, self._transports, IDS, self._serial)
        link = TauLink(self._name, port, self._clock)
        try:
            link.begin("open")
            number = link.serial_number("open")
            revision = link.call(Function.REVISION, b"", "open")
            # As a slave that it may have been left, it would show nothing.
            link.set_word(Function.EXTERNAL_SYNC, self._settings.sync_off, "open")
            self._size = self._first_shot(link, "open").counts.shape
        except DeviceFault:
            link.close()
            raise
        self._link = link
        self._serial = port.serial or str(number)
        firmware = ".".join(
            str(int.from_bytes(revision[place : place + 2], "big")) for place in range(0, len(revision), 2)
        )
        return DeviceIdentity("tau2", f"FLIR Tau 2 no. {number}", self._serial, firmware)

    def configure(self, settings: Settings) -> Settings:
        """Set the mode of the flat-field correction; the rest comes with `arm`."""
        self.disarm()
        checked = check_settings(Tau2Settings, settings, self._name)
        self._opened("configure").set_word(Function.FFC_MODE, FFC_MODES.index(checked.ffc_mode), "configure")
        self._settings = checked
        return checked.model_dump()

    def arm(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        """Correct the flat field, read the temperatures, then set the external sync."""
        self.disarm()
        link = self._opened("arm")
        self._check_order(mode, frame_rate_hz)
        self._forget_stream()
        # The flat field is corrected from frames: a slave without pulses makes none.
        self._set_sync(self._settings.sync_off, "arm")
        if self._settings.ffc_at_arm:
            self._run_ffc(link)
        self._temperature_k = link.temperature_k(Sensor.FPA, "arm")
        housing_k = link.temperature_k(Sensor.HOUSING, "arm")
        _log.info("device '%s': housing at %.2f °C", self._name, housing_k - 273.15)
        if mode is TriggerMode.HARDWARE:
            self._set_sync(self._settings.sync_slave, "arm")
            self._drain(link)
        link.forget("arm")
        self._ask_at_ns = self._clock.now_ns()
        self._armed = True

    def _check_order(self, mode: TriggerMode, frame_rate_hz: float) -> None:
        own_hz = self._settings.own_rate_hz
        if mode not in self.capabilities.trigger_modes:
            raise DeviceFault(self._name, "arm", f"it cannot run in mode '{mode}'")
        if not 0 < frame_rate_hz <= own_hz * (1 + _RATE_TOLERANCE):
            what = f"{frame_rate_hz:g} frames/s asked, at most {own_hz:g} possible"
            raise DeviceFault(self._name, "arm", what)
        if mode is TriggerMode.FREE_RUN and abs(frame_rate_hz / own_hz - 1) > _RATE_TOLERANCE:
            what = f"{frame_rate_hz:g} frames/s asked, by itself it makes {own_hz:g}"
            remedy = f"Set frame_rate_hz = {own_hz:g} in the rig, or trigger it (mode 'hardware')."
            raise DeviceFault(self._name, "arm", what, remedy=remedy)

    def trigger(self, index: int) -> None:
        """There are no software triggers."""
        raise DeviceFault(self._name, "trigger", f"it has no software trigger (index {index})")

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """Read frames as they come, and ask for temperature and shutter between them.

        Raises
        ------
        IncompleteFrame
            A frame came damaged.
        DeviceTimeout
            No frame came in time.
        """
        if not self._armed:
            raise DeviceFault(self._name, "acquire", "it is not armed")
        link = self._opened("acquire")
        heard_s = time.monotonic()
        while self._streams() and not host.stopping():
            if self._damaged:
                self._damaged -= 1
                what = "a frame came damaged and was thrown away"
                raise IncompleteFrame(self._name, "acquire", what, last_frame=self._good - 1)
            if link.shots:
                yield self._frame(link.shots.popleft(), host)
                heard_s = time.monotonic()
                continue
            self._look_after_the_camera(link)
            self._damaged += link.read("acquire")
            if time.monotonic() - heard_s > self._settings.timeout_s and not link.shots:
                what = f"no frame came for {self._settings.timeout_s:g} s"
                remedy = (
                    "Check the trigger line, its level and rate, and the number `sync_slave`; without a trigger, "
                    "whether the camera's digital output is on (CMOS, 14 bits)."
                )
                raise DeviceTimeout(self._name, "acquire", what, last_frame=self._good - 1, remedy=remedy)

    def _streams(self) -> bool:
        return self._armed

    def _frame(self, shot: Shot, host: FrameHost) -> Frame:
        if shot.counts.shape != self._size:
            what = f"a picture of {shot.counts.shape} came, not of {self._size}"
            raise IncompleteFrame(self._name, "acquire", what, last_frame=self._good - 1)
        stands_still = self._shown is not None and np.array_equal(shot.counts, self._shown)
        self._shown = shot.counts
        buffer = host.buffer()
        np.copyto(buffer, shot.counts)
        self._good += 1
        return Frame(
            counts=buffer,
            counter=-1,
            ticks=-1,
            host_ns=shot.host_ns,
            flags=FrameFlag.SHUTTER if stands_still or self._ffc_runs else FrameFlag.NONE,
            fpa_temperature_k=self._temperature_k,
        )

    def _look_after_the_camera(self, link: TauLink) -> None:
        """Take what the camera answered, and ask the next question when it is time; never waits."""
        while link.answers:
            self._note(link.answers.popleft())
        now_ns = self._clock.now_ns()
        if now_ns >= self._ask_at_ns:
            self._asked = self._next_question
            link.tell(packets.ask_sensor(self._asked), "acquire")
            # Each of the two questions once in this time; virtual time may have begun anew.
            every_ns = round(self._settings.temperature_every_s / 2 * NS_PER_S)
            self._ask_at_ns = min(self._ask_at_ns, now_ns) + every_ns
            self._next_question = Sensor.FPA if self._asked is Sensor.STATUS else Sensor.STATUS

    def _note(self, answer: Answer) -> None:
        """Answers do not say which sensor they tell of: it is the one that was asked for last."""
        asked, self._asked = self._asked, None
        if answer.function != Function.READ_SENSOR or answer.status or asked is None:
            return
        with suppress(ValueError):
            if asked is Sensor.STATUS:
                self._ffc_runs = bool(packets.parse_word(answer.data) & FFC_RUNNING)
                if self._ffc_runs:
                    self._next_question = Sensor.STATUS
                    self._ask_at_ns = self._clock.now_ns() + _FFC_POLL_NS
            else:
                self._temperature_k = packets.parse_temperature(answer.data, asked)

    def _run_ffc(self, link: TauLink) -> None:
        link.call(Function.DO_FFC, b"", "arm")
        time.sleep(_FFC_BEGINS_S)
        deadline_s = time.monotonic() + _FFC_S
        status = packets.word(Sensor.STATUS)
        while link.number(link.call(Function.READ_SENSOR, status, "arm"), "arm") & FFC_RUNNING:
            if time.monotonic() > deadline_s:
                what = f"its flat-field correction was not complete after {_FFC_S:g} s"
                remedy = "Does its shutter click? A camera without shutter needs ffc_at_arm = false."
                raise DeviceTimeout(self._name, "arm", what, remedy=remedy)
            # Its frames meanwhile must not pile up; and virtual time passes with frames only.
            link.read("arm")

    def _first_shot(self, link: TauLink, stage: str) -> Shot:
        deadline_s = time.monotonic() + _FIRST_PICTURE_S
        while time.monotonic() < deadline_s:
            link.read(stage)
            if link.shots:
                return link.shots.popleft()
        what = f"the camera answers, but no picture came within {_FIRST_PICTURE_S:g} s"
        remedy = (
            "Switch the camera's digital output on (CMOS, 14 bits) with the maker's program, and save that."
        )
        raise DeviceTimeout(self._name, stage, what, remedy=remedy)

    def _drain(self, link: TauLink) -> None:
        """Wait until the frames from before it became a slave have come."""
        began_s = quiet_since_s = time.monotonic()
        while time.monotonic() - quiet_since_s < _QUIET_S and time.monotonic() - began_s < _LONGEST_DRAIN_S:
            if link.read("arm") or link.shots:
                quiet_since_s = time.monotonic()
                link.shots.clear()

    def disarm(self) -> None:
        """Stop delivering; a slave runs free again."""
        self._armed = False
        if self._link is not None and self._sync == self._settings.sync_slave:
            with suppress(DeviceFault):
                self._link.tell(
                    packets.packet(Function.EXTERNAL_SYNC, packets.word(self._settings.sync_off)), "disarm"
                )
            self._sync = -1

    def close(self) -> None:
        """Let go of the camera."""
        self.disarm()
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _set_sync(self, value: int, stage: str) -> None:
        self._opened(stage).set_word(Function.EXTERNAL_SYNC, value, stage)
        self._sync = value

    def _opened(self, stage: str) -> TauLink:
        if self._link is None:
            raise DeviceFault(self._name, stage, "it is not open")
        return self._link


def discover(transports: Transports) -> list[DeviceIdentity]:
    """USB devices with an FT2232H, none opened: whether a Tau 2 is behind one is seen when it is opened."""
    return [
        DeviceIdentity("tau2", "FT2232H, perhaps a TeAx grabber", serial_of(device))
        for device in find_devices(transports, IDS)
    ]
