"""Driver ``pulse_pal``: the Pulse Pal 2 trigger box (Sanworks), over its serial port.

The box counts time in cycles of 50 µs, so that 20.000 ms (50 Hz) is exact and 60 Hz is not possible; a
period off that grid is refused, with its neighbours named. Outputs are analogue and the levels are settings:
see what the cameras' inputs stand before connecting them.

The box tells nothing of the pulses that it emits. `pulses` counts them from the moment of the soft trigger
at the programmed period, on the host's clock: a pulse's ``host_ns`` is off by the delay of the USB port (the
same for all pulses of a run) and by the drift of the box's clock. Cameras and probes on the same line share
the true pulses; take their times from these.

Pulse trains are ended by their programmed duration, never by the box's continuous mode: for the command that
sets it (82), firmware and published hosts disagree in the order of its bytes. A train without end is one of
more than two days. Not checked on hardware.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from enum import IntEnum
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from thermacq.devices import (
    DeviceContext,
    DeviceIdentity,
    DeviceKind,
    Settings,
    StreamHost,
    TriggerCapabilities,
    TriggerPulse,
)
from thermacq.errors import DeviceFault
from thermacq.hooks import Driver, Evidence
from thermacq.settings import check_settings
from thermacq.timing.clock import NS_PER_S
from thermacq.transports import Transports
from thermacq_drivers.simflume.exposures import sleep_until
from thermacq_drivers.transports.serial import PortFinder, SerialPort

CYCLE_S = 50e-6
CYCLES_PER_S = 20_000
CHANNELS = 4
OLDEST_FIRMWARE = 20
"""Older boxes (Pulse Pal 1) have voltages of 8 bits and other trains."""

# Arduino Due, native port: the board inside a Pulse Pal 2.
_IDS = (0x2341, 0x003E)
_MARK = 213
_ANSWER_S = 1.0
# 55 hours: near the end of the box's 32 bits.
_ENDLESS_CYCLES = 4_000_000_000
# A counted train is waited for this much longer than the host's clock says, for the box's clock may be slow.
_CLOCK_TOLERANCE = 200e-6
# A soft trigger can be on its way for so long: USB, and a busy computer.
_LATEST_START_NS = 50_000_000


class Command(IntEnum):
    """Second byte of what the host sends."""

    HANDSHAKE = 72
    PROGRAMME_ONE = 74
    SOFT_TRIGGER = 77
    ABORT = 80
    DISCONNECT = 81
    CLIENT_NAME = 89


class Parameter(IntEnum):
    """What `programme` can set; times in cycles, voltages as codes, the rest as numbers."""

    BIPHASIC = 1
    PHASE1_VOLTAGE = 2
    PHASE1_TIME = 4
    INTERPULSE_TIME = 7
    BURST_TIME = 8
    TRAIN_DURATION = 10
    TRAIN_DELAY = 11
    LINK_TRIGGER_1 = 12
    LINK_TRIGGER_2 = 13
    CUSTOM_TRAIN = 14
    RESTING_VOLTAGE = 17
    TRIGGER_MODE = 128


_VOLTAGES = (Parameter.PHASE1_VOLTAGE, Parameter.RESTING_VOLTAGE)
_TIMES = (
    Parameter.PHASE1_TIME,
    Parameter.INTERPULSE_TIME,
    Parameter.BURST_TIME,
    Parameter.TRAIN_DURATION,
    Parameter.TRAIN_DELAY,
)


def message(command: Command, content: bytes = b"") -> bytes:
    """Bytes of a command: the mark, the command, its content."""
    return bytes((_MARK, command)) + content


def voltage_code(volts: float) -> int:
    """Code of a voltage from -10 V to 10 V, for firmware 20 and later; `ValueError` outside."""
    if not -10 <= volts <= 10:
        raise ValueError(f"{volts:g} V is outside -10 V to 10 V")
    return math.ceil((volts + 10) / 20 * 65535)


def programme(parameter: Parameter, channel: int, value: int) -> bytes:
    """Bytes that set one parameter of one output (or trigger input) counted from 1; acknowledged by 1."""
    layout = "<I" if parameter in _TIMES else "<H" if parameter in _VOLTAGES else "<B"
    return message(Command.PROGRAMME_ONE, bytes((parameter, channel)) + struct.pack(layout, value))


def soft_trigger(channels: Sequence[int]) -> bytes:
    """Bytes that start the trains of these outputs, counted from 1, in the same cycle; not answered."""
    return message(Command.SOFT_TRIGGER, bytes((sum(1 << (channel - 1) for channel in channels),)))


def parse_handshake(answer: bytes) -> int:
    """Firmware version in the answer to the handshake; `ValueError` when this is no Pulse Pal."""
    if len(answer) != 5 or answer[:1] != b"K":
        raise ValueError(
            f"the answer to the handshake was {answer.hex(' ') or 'empty'}, not 4b and a version"
        )
    return int.from_bytes(answer[1:], "little")


def cycles_of(period_s: float) -> int:
    """Period in cycles of the box; `ValueError`, naming the neighbours, when it is not on the grid."""
    cycles = period_s * CYCLES_PER_S
    if abs(cycles - round(cycles)) < 1e-6 * cycles:
        return round(cycles)
    below, above = max(1, math.floor(cycles)), math.ceil(cycles)
    near = " or ".join(f"{CYCLES_PER_S / count:.6g} Hz ({count * 0.05:.2f} ms)" for count in (above, below))
    raise ValueError(
        f"a period of {period_s * 1e3:.6g} ms is not a multiple of 50 µs; the nearest are {near}"
    )


class PulsePalSettings(BaseModel):
    """Settings of a Pulse Pal."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(
        "", description="path of the port, when several boxes without serial number are attached"
    )
    channels: tuple[int, ...] = Field((1,), min_length=1, description="outputs that pulse, all in step")
    pulse_width_s: float = Field(0.001, gt=0, le=1, description="length of a pulse, a multiple of 50 µs")
    high_v: float = Field(5.0, ge=-10, le=10, description="level of a pulse; 3.3 or 5 for logic inputs")
    low_v: float = Field(0.0, ge=-10, le=10, description="level between pulses")
    delay_s: float = Field(0.0, ge=0, le=60, description="from the trigger to the first pulse")
    input_mode: Literal["normal", "toggle", "gated"] = Field(
        "normal", description="what the box's own trigger inputs do"
    )
    linked_inputs: tuple[int, ...] = Field((), description="trigger inputs (1, 2) that start the outputs too")

    @field_validator("channels", "linked_inputs")
    @classmethod
    def _known(cls, numbers: tuple[int, ...], info: object) -> tuple[int, ...]:
        highest = CHANNELS if getattr(info, "field_name", "") == "channels" else 2
        if len(set(numbers)) != len(numbers) or not all(1 <= number <= highest for number in numbers):
            raise ValueError(f"numbers from 1 to {highest}, each once")
        return numbers

    @model_validator(mode="after")
    def _on_grid(self) -> PulsePalSettings:
        cycles_of(self.pulse_width_s)
        if self.delay_s > 0:
            cycles_of(self.delay_s)
        return self


class PulsePal:
    """The trigger source behind ``driver = "pulse_pal"``."""

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._finder = PortFinder(context, (_IDS,))
        self._settings = PulsePalSettings()
        self._port: SerialPort | None = None
        self._period_cycles = 0
        self._count: int | None = None

    @property
    def capabilities(self) -> TriggerCapabilities:
        """What the box can emit with the pulse width in force."""
        shortest = cycles_of(self._settings.pulse_width_s) + 1
        return TriggerCapabilities(CYCLES_PER_S / shortest, CYCLE_S, reckons_pulses=True)

    def open(self) -> DeviceIdentity:
        """Find the box with the rig's serial number or port, or the only one, and shake hands."""
        self.close()
        node = self._finder.find()
        port = SerialPort(self._name, node.path)
        try:
            # What another program left unread, such as answers that it did not wait for, is none of ours.
            port.discard("open")
            port.write(message(Command.HANDSHAKE), "open")
            firmware = self._checked_firmware(port.read(5, _ANSWER_S, "open"))
            port.write(message(Command.CLIENT_NAME, b"THRMCQ"), "open")
        except DeviceFault:
            port.close()
            raise
        self._port = port
        return DeviceIdentity("pulse_pal", "Pulse Pal 2", node.serial, str(firmware))

    def configure(self, settings: Settings) -> Settings:
        """Apply settings; they overwrite whatever was set by hand."""
        self.disarm()
        checked = check_settings(PulsePalSettings, settings, self._name)
        self._require_open("configure")
        self._finder.confirm(checked.port)
        self._settings = checked
        self._set_up()
        return checked.model_dump(mode="json")

    def arm(self, rate_hz: float, count: int | None) -> None:
        """Programme the train; the first pulse comes when `pulses` is begun."""
        self.disarm()
        self._require_open("arm")
        fastest_hz = self.capabilities.max_rate_hz
        if not 0 < rate_hz <= fastest_hz * (1 + 1e-9):
            what = f"{rate_hz:g} pulses/s asked, at most {fastest_hz:g} possible with this pulse width"
            raise self._fault("arm", what)
        try:
            period = cycles_of(1 / rate_hz)
        except ValueError as error:
            raise self._fault("arm", str(error)) from None
        longest = _ENDLESS_CYCLES // period
        if (count or 1) > longest:
            raise self._fault(
                "arm", f"{count} pulses asked, at most {longest} in one train at {rate_hz:g} Hz"
            )
        gap = period - cycles_of(self._settings.pulse_width_s)
        # Ends between two pulses, so that neither a late nor an early end changes their number.
        duration = (count or longest) * period - gap // 2
        for channel in self._settings.channels:
            self._programme(Parameter.INTERPULSE_TIME, channel, gap, "arm")
            self._programme(Parameter.TRAIN_DURATION, channel, duration, "arm")
        self._period_cycles, self._count = period, count

    def pulses(self, host: StreamHost) -> Iterator[TriggerPulse]:
        """Start the train and yield each pulse when it is due, as counted on the host's clock.

        ``host_ns`` is reckoned, not measured: see the module's docstring.
        """
        port = self._require_open("acquire")
        if not self._period_cycles:
            raise self._fault("acquire", "it is not armed")
        before_ns = self._clock.now_ns()
        port.write(soft_trigger(self._settings.channels), "acquire")
        sent_ns = (before_ns + self._clock.now_ns()) // 2
        period_ns = self._period_cycles * NS_PER_S // CYCLES_PER_S
        # The box starts its trains with the cycle after the one in which it reads the command.
        first_ns = sent_ns + round((CYCLE_S + self._settings.delay_s) * NS_PER_S)
        index = 0
        while index != self._count:
            due_ns = first_ns + index * period_ns
            if not self._wait(due_ns, host, index):
                return
            yield TriggerPulse(index, due_ns)
            index += 1
        # The box ends the train by itself; whoever disarms it now must not cut off the last pulse.
        lag_ns = round(index * period_ns * _CLOCK_TOLERANCE) + _LATEST_START_NS
        self._wait(first_ns + (index - 1) * period_ns + lag_ns + self._width_ns(), host, index)

    def disarm(self) -> None:
        """Stop all outputs at once."""
        self._period_cycles = 0
        if self._port is not None:
            with suppress(DeviceFault):
                self._port.write(message(Command.ABORT), "disarm")

    def close(self) -> None:
        """Stop the outputs and let the box go back to its own menu."""
        self.disarm()
        if self._port is not None:
            with suppress(DeviceFault):
                self._port.write(message(Command.DISCONNECT), "close")
            self._port.close()
            self._port = None

    def _checked_firmware(self, answer: bytes) -> int:
        try:
            firmware = parse_handshake(answer)
        except ValueError as error:
            raise self._fault("open", str(error)) from None
        if firmware < OLDEST_FIRMWARE:
            what = f"it has firmware {firmware}; {OLDEST_FIRMWARE} or later (Pulse Pal 2) is needed"
            raise self._fault("open", what)
        return firmware

    def _set_up(self) -> None:
        """Programme everything but the train's rate and length."""
        settings = self._settings
        delay = cycles_of(settings.delay_s) if settings.delay_s > 0 else 0
        values = (
            (Parameter.RESTING_VOLTAGE, voltage_code(settings.low_v)),
            (Parameter.PHASE1_VOLTAGE, voltage_code(settings.high_v)),
            (Parameter.PHASE1_TIME, cycles_of(settings.pulse_width_s)),
            (Parameter.TRAIN_DELAY, delay),
            (Parameter.BIPHASIC, 0),
            (Parameter.BURST_TIME, 0),
            (Parameter.CUSTOM_TRAIN, 0),
            (Parameter.LINK_TRIGGER_1, int(1 in settings.linked_inputs)),
            (Parameter.LINK_TRIGGER_2, int(2 in settings.linked_inputs)),
        )
        for channel in settings.channels:
            for parameter, value in values:
                self._programme(parameter, channel, value, "configure")
        mode = ("normal", "toggle", "gated").index(settings.input_mode)
        for trigger_input in (1, 2):
            self._programme(Parameter.TRIGGER_MODE, trigger_input, mode, "configure")

    def _programme(self, parameter: Parameter, channel: int, value: int, stage: str) -> None:
        port = self._require_open(stage)
        port.discard(stage)
        port.write(programme(parameter, channel, value), stage)
        answer = port.read(1, _ANSWER_S, stage)
        if answer != b"\x01":
            what = f"it answered {answer.hex()} instead of 01 to {parameter.name.lower()} of {channel}"
            raise self._fault(stage, what)

    def _wait(self, due_ns: int, host: StreamHost, index: int) -> bool:
        """Wait for a pulse, watching the port; False when the host stops or the box was disarmed."""
        port = self._port
        while port is not None and self._period_cycles and not host.stopping():
            try:
                port.check("acquire")
            except DeviceFault as fault:
                raise type(fault)(
                    self._name, "acquire", "the box is gone", last_frame=index - 1, remedy=fault.remedy
                ) from None
            now_ns = self._clock.now_ns()
            if now_ns >= due_ns:
                return True
            # In virtual time, one step to the pulse; in real time look at the port now and then.
            step_ns = due_ns if self._clock.is_virtual else min(due_ns, now_ns + NS_PER_S // 10)
            sleep_until(self._clock, step_ns, host)
            port = self._port
        return False

    def _width_ns(self) -> int:
        return round(self._settings.pulse_width_s * NS_PER_S)

    def _require_open(self, stage: str) -> SerialPort:
        if self._port is None:
            raise self._fault(stage, "it is not open")
        return self._port

    def _fault(self, stage: str, what: str) -> DeviceFault:
        return DeviceFault(self._name, stage, what)


def discover(transports: Transports) -> list[DeviceIdentity]:
    """Ports of the board that is inside a Pulse Pal 2; whether it is one is known when it is opened."""
    return [
        DeviceIdentity("pulse_pal", "Pulse Pal 2 (or another Arduino Due)", node.serial)
        for node in transports.serial_ports()
        if (node.vid, node.pid) == _IDS
    ]


DRIVER = Driver(
    name="pulse_pal",
    kind=DeviceKind.TRIGGER_SOURCE,
    summary="Pulse Pal 2 trigger box: pulses on a grid of 50 µs, 20.000 ms exact",
    evidence=Evidence.EMULATED,
    make=PulsePal,
    settings=lambda: PulsePalSettings,
    discover=discover,
    usb_ids=(_IDS,),
)
