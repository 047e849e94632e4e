"""One acquisition of a Boson, from arming to disarming: pictures in, telemetry read, temperature asked between."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from thermacq.devices import Counts, Frame, FrameFlag, FrameHost
from thermacq.errors import DeviceFault, DeviceTimeout, IncompleteFrame
from thermacq.timing.clock import NS_PER_S, Clock
from thermacq_drivers.boson.control import BosonControl
from thermacq_drivers.boson.fslp import Function
from thermacq_drivers.boson.telemetry import Place, read_telemetry
from thermacq_drivers.transports.video import Shot, VideoFormat, VideoStream, as_counts

_WAIT_S = 0.05
_TURN = 1 << 32
_FFC_IN_PROGRESS = 2
_ZERO_CELSIUS_K = 273.15


def parse_temperature(data: bytes) -> float:
    """Kelvin, from tenths of a degree Celsius, 16 bits with sign; `ValueError` for anything else."""
    if len(data) != 2:
        raise ValueError(f"a temperature has 2 bytes, not {len(data)}")
    tenths: int = struct.unpack(">h", data)[0]
    return tenths / 10 + _ZERO_CELSIUS_K


@dataclass(frozen=True)
class Picture:
    """How the pictures come: their format, where the telemetry row is (None: nowhere), the camera's number."""

    format: VideoFormat
    place: Place | None
    serial: int


class Acquisition:
    """Frames of an armed camera.

    Parameters
    ----------
    name
        Name of the device in the rig.
    stream, control
        Its picture and its serial side.
    picture
        How the pictures come.
    temperature_k
        Temperature of the focal-plane array at the start.
    temperature_every_s, timeout_s
        As in the settings.
    clock
        Host clock.
    """

    def __init__(
        self,
        name: str,
        stream: VideoStream,
        control: BosonControl,
        picture: Picture,
        *,
        temperature_k: float,
        temperature_every_s: float,
        timeout_s: float,
        clock: Clock,
    ) -> None:
        self._name = name
        self._stream = stream
        self._control = control
        self._picture = picture
        self._temperature_k = temperature_k
        # Temperature and state of the shutter are asked in turn.
        self._ask_every_ns = round(temperature_every_s / 2 * NS_PER_S)
        self._timeout_s = timeout_s
        self._clock = clock
        self._ask_at_ns = clock.now_ns()
        self._next_question = Function.FFC_STATUS
        self._ffc_in_progress = False
        self._previous: Counts | None = None
        self._counter = -1
        self._copies = 0
        self._time_ms, self._turns = 0, 0
        self._good = 0
        self._heard_s = 0.0
        self._over = False

    def end(self) -> None:
        """No frame is yielded from now on."""
        self._over = True
        self._stream.close()

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """See `thermacq.devices.Camera.frames`."""
        self._heard_s = time.monotonic()
        while not self._over and not host.stopping():
            self._look_after_the_camera()
            shot = self._stream.take(_WAIT_S)
            if shot is None:
                self._check_silence()
                continue
            self._heard_s = time.monotonic()
            frame = self._frame(shot, host)
            if frame is not None:
                yield frame

    def _frame(self, shot: Shot, host: FrameHost) -> Frame | None:
        """Frame of a picture; None for one that came before."""
        counts = self._counts(shot)
        counter, ticks, place = -1, -1, self._picture.place
        if place is not None:
            said = read_telemetry(counts[place.row], place.packing)
            if said.serial != self._picture.serial:
                raise self._fault(IncompleteFrame, "a frame with a damaged telemetry row was thrown away")
            if said.counter == self._counter:
                self._note_copy()
                return None
            self._counter = counter = said.counter
            self._copies = 0
            ticks = self._continuous(said.time_ms)
            counts = counts[place.picture]
        frozen = self._previous is not None and np.array_equal(counts, self._previous)
        self._previous = counts
        buffer = host.buffer()
        np.copyto(buffer, counts)
        self._good += 1
        return Frame(
            counts=buffer,
            counter=counter,
            ticks=ticks,
            host_ns=shot.host_ns,
            flags=FrameFlag.SHUTTER if frozen or self._ffc_in_progress else FrameFlag.NONE,
            fpa_temperature_k=self._temperature_k,
        )

    def _counts(self, shot: Shot) -> Counts:
        try:
            return as_counts(shot.picture, self._picture.format)
        except ValueError as error:
            raise self._fault(IncompleteFrame, str(error)) from None

    def _note_copy(self) -> None:
        """A frame that came again is thrown away; one event tells of a series of them."""
        self._copies += 1
        if self._copies == 1:
            what = f"frame {self._counter} came again; its copies are thrown away, no picture is lost"
            raise self._fault(IncompleteFrame, what)

    def _continuous(self, time_ms: int) -> int:
        """Milliseconds of the camera across the wrap of their 32 bits."""
        if time_ms < self._time_ms - _TURN // 2:
            self._turns += 1
        self._time_ms = time_ms
        return self._turns * _TURN + time_ms

    def _look_after_the_camera(self) -> None:
        """Fetch what the camera answered, and ask the next question when it is time; never waits."""
        answered = self._control.answer("acquire")
        if answered is not None:
            self._note_answer(*answered)
        now_ns = self._clock.now_ns()
        if self._control.is_waiting or now_ns < self._ask_at_ns:
            return
        self._control.begin(self._next_question, "acquire")
        # Virtual time may have begun anew since the last question.
        self._ask_at_ns = min(self._ask_at_ns, now_ns) + self._ask_every_ns
        asks_status = self._next_question is Function.FFC_STATUS
        self._next_question = Function.FPA_TEMPERATURE if asks_status else Function.FFC_STATUS

    def _note_answer(self, function: Function, data: bytes) -> None:
        if function is Function.FFC_STATUS:
            self._ffc_in_progress = int.from_bytes(data, "big") == _FFC_IN_PROGRESS
            if self._ffc_in_progress:
                self._next_question, self._ask_at_ns = Function.FFC_STATUS, self._clock.now_ns()
        elif len(data) == 2:
            self._temperature_k = parse_temperature(data)

    def _check_silence(self) -> None:
        if time.monotonic() - self._heard_s > self._timeout_s:
            raise self._fault(
                DeviceTimeout,
                f"no frame came for {self._timeout_s:g} s",
                "Check the trigger line, its level and rate; without a trigger, switch the camera off and on.",
            )

    def _fault(self, kind: type[DeviceFault], what: str, remedy: str = "") -> DeviceFault:
        return kind(self._name, "acquire", what, last_frame=self._good - 1, remedy=remedy)
