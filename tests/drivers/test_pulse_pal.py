"""The Pulse Pal driver: its codec against the worked bytes, and its behaviour on the emulated box."""

from __future__ import annotations

import struct
import time
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.devices import DeviceContext
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Emulation
from thermacq.testing.emulators.pulse_pal import attach
from thermacq.timing.clock import NS_PER_S, RealClock, VirtualClock
from thermacq.timing.trigger_line import LineReader
from thermacq_drivers import pulse_pal
from thermacq_drivers.pulse_pal import Command, Parameter, PulsePal


class Host:
    def __init__(self, stop_after=None):
        self.left = stop_after

    def stopping(self):
        return self.left is not None and self.left <= 0


@pytest.mark.parametrize(
    ("made", "worked"),
    [
        (pulse_pal.message(Command.HANDSHAKE), "D5 48"),
        (pulse_pal.programme(Parameter.PHASE1_VOLTAGE, 1, pulse_pal.voltage_code(5.0)), "D5 4A 02 01 00 C0"),
        (
            pulse_pal.programme(Parameter.PHASE1_TIME, 1, pulse_pal.cycles_of(0.001)),
            "D5 4A 04 01 14 00 00 00",
        ),
        (
            pulse_pal.programme(Parameter.INTERPULSE_TIME, 1, pulse_pal.cycles_of(0.019)),
            "D5 4A 07 01 7C 01 00 00",
        ),
        (
            pulse_pal.programme(Parameter.TRAIN_DURATION, 1, pulse_pal.cycles_of(60)),
            "D5 4A 0A 01 80 4F 12 00",
        ),
        (pulse_pal.soft_trigger((1, 2)), "D5 4D 03"),
        (pulse_pal.message(Command.ABORT), "D5 50"),
        (pulse_pal.message(Command.CLIENT_NAME, b"THRACQ"), "D5 59 54 48 52 41 43 51"),
    ],
)
def test_worked_bytes(made, worked):
    assert made == bytes.fromhex(worked)


def test_worked_handshake():
    assert pulse_pal.parse_handshake(bytes.fromhex("4B 15 00 00 00")) == 21


@given(st.binary(max_size=12))
def test_any_answer_to_the_handshake_is_a_version_or_refused(answer):
    try:
        version = pulse_pal.parse_handshake(answer)
    except ValueError:
        assert len(answer) != 5 or answer[0] != ord("K")
    else:
        assert answer == b"K" + struct.pack("<I", version)


@given(st.floats(-10, 10))
def test_a_voltage_is_met_within_one_code(volts):
    code = pulse_pal.voltage_code(volts)
    assert 0 <= code <= 65535
    assert 0 <= code / 65535 * 20 - 10 - volts < 20 / 65535 + 1e-9


@pytest.mark.parametrize("volts", [-10.1, 10.1, float("nan")])
def test_impossible_voltages_are_refused(volts):
    with pytest.raises(ValueError, match="outside"):
        pulse_pal.voltage_code(volts)


@given(st.integers(1, 4_000_000_000))
def test_every_period_on_the_grid_is_taken_exactly(cycles):
    assert pulse_pal.cycles_of(cycles / 20_000) == cycles


def test_a_period_off_the_grid_names_its_neighbours():
    with pytest.raises(ValueError, match=r"59\.8802 Hz \(16\.70 ms\) or 60\.0601 Hz \(16\.65 ms\)"):
        pulse_pal.cycles_of(1 / 60)


@pytest.fixture
def box(tmp_path):
    """Make a driver on an emulated box; takes settings of the emulator and of the driver."""
    stack = []

    def make(emulation=None, settings=None, clock=None, serial=""):
        clock = clock or RealClock()
        context = attach(Emulation("box", clock, tmp_path, emulation or {}))
        transports = context.__enter__()
        device = PulsePal(DeviceContext("box", clock, {}, tmp_path, transports, serial, settings or {}))
        stack.append((context, device))
        return device

    yield make
    for context, device in reversed(stack):
        device.close()
        context.__exit__(None, None, None)


def opened(device, settings=None):
    device.open()
    device.configure(settings or {})
    return device


def line_pulses(reader):
    return [reader.take() for _ in range(reader.waiting)]


def all_pulses(reader):
    """Pulses up to the end of the train; the box is a thread of its own and may be a moment late."""
    taken, deadline_s = [], time.monotonic() + 30
    while not reader.finished and time.monotonic() < deadline_s:
        taken += line_pulses(reader)
        time.sleep(0.001)
    reader.close()
    return taken


def test_identity_is_the_serial_number_and_the_firmware(box):
    identity = box({"serial": "PP-3"}).open()
    assert (identity.model, identity.serial, identity.firmware) == ("Pulse Pal 2", "PP-3", "21")


def test_another_box_than_the_rigs_is_not_opened(box):
    with pytest.raises(DeviceDisconnected, match="'other' was not found; attached: EMU-box"):
        box(serial="other").open()


def test_an_old_box_is_refused(box):
    with pytest.raises(DeviceFault, match="firmware 18; 20 or later"):
        box({"firmware": 18}).open()


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ({"kind": "timeout"}, DeviceTimeout),
        ({"kind": "short_read", "amount": 2}, DeviceTimeout),
        ({"kind": "garbage", "amount": 3}, DeviceFault),
        ({"kind": "disconnect"}, DeviceDisconnected),
    ],
)
def test_a_broken_handshake_is_a_typed_fault_and_can_be_tried_again(box, fault, expected):
    device = box({"faults": [{**fault, "at": 0, "seconds": 0.05 if fault["kind"] == "disconnect" else 0.0}]})
    with pytest.raises(expected):
        device.open()
    time.sleep(0.2)
    assert device.open().serial == "EMU-box"


def test_an_answer_that_is_no_acknowledgement_is_told(box):
    device = box({"faults": [{"kind": "bad_crc", "at": 1}]})
    device.open()
    with pytest.raises(DeviceFault, match=r"answered 54 instead of 01"):
        device.configure({})


def test_answers_that_another_program_left_unread_do_no_harm(box):
    """Published hosts do not read the acknowledgement of command 82."""
    device = opened(box({"faults": [{"kind": "duplicate", "at": 0}, {"kind": "duplicate", "at": 3}]}))
    device.arm(50.0, 3)


def test_pulses_of_a_counted_train_are_on_the_line_at_the_exact_period(box, tmp_path):
    device = opened(box())
    reader = LineReader(tmp_path, "trigger")
    device.arm(50.0, 8)
    told = list(device.pulses(Host()))
    device.disarm()
    emitted = all_pulses(reader)
    assert [index for index, _ in emitted] == [pulse.index for pulse in told] == list(range(8))
    assert {two - one for (_, one), (_, two) in pairwise(emitted)} == {20_000_000}
    # Reckoned from the soft trigger: off by the way of the command, not more.
    assert all(
        abs(pulse.host_ns - host_ns) < 0.1 * NS_PER_S
        for pulse, (_, host_ns) in zip(told, emitted, strict=True)
    )


@pytest.mark.parametrize("ppm", [-90.0, 90.0])
def test_a_counted_train_is_complete_whatever_the_boxs_clock(box, tmp_path, ppm):
    device = opened(box({"clock_ppm": ppm}, clock=VirtualClock()))
    reader = LineReader(tmp_path, "trigger")
    device.arm(100.0, 2000)
    emitted = []
    for _ in device.pulses(Host()):
        emitted += line_pulses(reader)
    device.disarm()
    emitted += all_pulses(reader)
    assert len(emitted) == 2000
    assert (emitted[-1][1] - emitted[0][1]) / NS_PER_S == pytest.approx(19.99 / (1 + ppm * 1e-6), abs=1e-8)


def test_disarming_ends_an_endless_train(box, tmp_path):
    device = opened(box())
    reader = LineReader(tmp_path, "trigger")
    device.arm(200.0, None)
    pulses = device.pulses(Host())
    for _ in range(3):
        next(pulses)
    device.disarm()
    assert list(pulses) == []
    time.sleep(0.1)
    reached = reader.waiting
    time.sleep(0.1)
    assert reader.waiting == reached >= 3
    reader.close()


def test_levels_that_no_input_sees_make_no_pulses(box, tmp_path):
    device = opened(box(), {"high_v": 1.0})
    reader = LineReader(tmp_path, "trigger")
    device.arm(200.0, 5)
    assert len(list(device.pulses(Host()))) == 5
    assert reader.waiting == 0
    reader.close()


def test_outputs_share_their_cycles_and_carry_their_own_lines(box, tmp_path):
    device = opened(box({"lines": ["cameras", "", "probe"]}), {"channels": [1, 3], "delay_s": 0.01})
    cameras, probe = LineReader(tmp_path, "cameras"), LineReader(tmp_path, "probe")
    device.arm(200.0, 4)
    list(device.pulses(Host()))
    device.disarm()
    emitted = all_pulses(cameras)
    assert len(emitted) == 4
    assert emitted == all_pulses(probe)


def test_a_box_that_is_pulled_while_it_pulses_is_told_with_the_last_pulse(box):
    device = opened(box({"pulse_faults": [{"kind": "disconnect", "at": 4}]}))
    device.arm(100.0, None)
    told = []
    with pytest.raises(DeviceDisconnected) as gone:
        told.extend(device.pulses(Host()))
    assert gone.value.last_frame == told[-1].index
    device.disarm()


@pytest.mark.parametrize(
    ("rate_hz", "words"), [(60.0, "nearest are 59.8802 Hz"), (2000.0, "at most 952.381"), (0.0, "asked")]
)
def test_impossible_rates_are_refused(box, rate_hz, words):
    with pytest.raises(DeviceFault, match=words):
        opened(box()).arm(rate_hz, 10)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"pulse_width_s": 0.00103}, "not a multiple of 50 µs"),
        ({"channels": [1, 1]}, "each once"),
        ({"channels": [5]}, "from 1 to 4"),
        ({"linked_inputs": [3]}, "from 1 to 2"),
        ({"high_v": 12.0}, "less than or equal to 10"),
        ({"port": "/dev/elsewhere"}, "'/dev/elsewhere'"),
    ],
)
def test_impossible_settings_are_refused(box, settings, words):
    device = box()
    device.open()
    with pytest.raises(DeviceFault, match=words):
        device.configure(settings)
    assert device.configure({})["channels"] == [1]


def test_the_same_box_is_found_as_is_opened(box, tmp_path):
    with (
        attach(Emulation("a", RealClock(), tmp_path)) as one,
        attach(Emulation("b", RealClock(), tmp_path, {"lines": ["other"]})) as two,
    ):
        both = one + two
        assert [item.serial for item in pulse_pal.discover(both)] == ["EMU-a", "EMU-b"]
        with pytest.raises(DeviceFault, match="several devices fit: EMU-a, EMU-b"):
            PulsePal(DeviceContext("box", RealClock(), transports=both)).open()
        device = PulsePal(DeviceContext("box", RealClock(), transports=both, serial="EMU-b"))
        assert device.open().serial == "EMU-b"
        device.close()
