"""The HSVA logger: records out of any bytes, and the driver on its emulated board."""

from __future__ import annotations

import struct
import time
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.devices import DeviceContext
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Emulation
from thermacq.testing.bench import StopSwitch
from thermacq.testing.emulators.hsva_logger import attach
from thermacq.timing.clock import RealClock
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.hsva_logger import HsvaLogger, RecordParser, continue_ticks

WORKED = bytes.fromhex(
    "53 88 13 00 00 F8 13 00 00 68 14 00 00 D8 14 00 00 00 02 F2 01 F9 01 08 02 01 00 00 00 04 45"
)


def record(number, adc=(100, 101, 102, 103)):
    times = [5000 * (number + 1) + 112 * channel for channel in range(4)]
    return b"S" + struct.pack("<4I4hIB", *(value % 2**32 for value in times), *adc, number % 2**32, 4) + b"E"


@contextmanager
def logger(tmp_path, settings=None, **emulation):
    clock = RealClock()
    with attach(Emulation("gauges", clock, tmp_path, emulation)) as transports:
        device = HsvaLogger(DeviceContext("gauges", clock, transports=transports, runtime_dir=tmp_path))
        try:
            device.open()
            device.configure(settings or {})
            device.arm()
            yield device
        finally:
            device.close()


def take(device, samples):
    blocks, taken = [], 0
    for block in device.samples(StopSwitch()):
        blocks.append(block)
        taken += len(block.values)
        if taken >= samples:
            break
    return blocks


def numbers_of(blocks):
    return np.concatenate([block.first_index + np.arange(len(block.values)) for block in blocks])


def test_the_worked_record():
    parser = RecordParser(4)
    parser.feed(record(0))
    (found,) = parser.feed(WORKED)
    assert found["time_us"].tolist() == [5000, 5112, 5224, 5336]
    assert found["adc"].tolist() == [512, 498, 505, 520]
    assert (found["n"], found["id"], parser.damaged) == (1, 4, 0)


@given(st.data())
def test_records_come_whole_however_the_bytes_are_cut(data):
    first = data.draw(st.integers(0, 2**31))
    sent = b"W" * data.draw(st.integers(0, 40)) + b"".join(record(first + i) for i in range(6))
    parser, found = RecordParser(4), []
    while sent:
        piece = data.draw(st.integers(1, len(sent)))
        found += parser.feed(sent[:piece])["n"].tolist()
        sent = sent[piece:]
    assert found == list(range(first, first + 6))
    assert parser.damaged == 0


@given(st.lists(st.binary(max_size=200), max_size=8))
def test_no_bytes_break_the_parser_and_its_memory_is_bounded(pieces):
    parser = RecordParser(4)
    for piece in pieces:
        records = parser.feed(piece)
        assert (np.diff(records["n"].astype(np.int64)) > 0).all()
    assert parser.feed(b"").size == 0


@given(st.integers(1, 8), st.binary(min_size=1, max_size=30), st.integers(0, 31))
def test_damage_costs_the_record_that_it_hits_and_is_counted(victim, garbage, keep):
    sent = [record(number) for number in range(12)]
    # Garbage that happens to be a plausible record is excluded by its length: it is shorter than one.
    sent[victim] = sent[victim][:keep] + garbage if keep < 31 else sent[victim][:-1] + b"\x00"
    parser = RecordParser(4)
    found = parser.feed(b"".join(sent))["n"].tolist()
    kept = [number for number in range(12) if number != victim]
    assert found in (kept, list(range(12)))  # the latter when the garbage completed the record as it was
    if found == kept and set(sent[victim]) != {ord("W")} and sent[victim]:
        assert parser.damaged == 1


def test_marks_inside_a_record_do_no_harm():
    # 0x53 and 0x45 as bytes of values: S at the place where a mark could stand.
    sent = b"".join(record(number, (0x0053, 0x0145, 0x0057, 0x0353)) for number in range(5))
    parser = RecordParser(4)
    assert parser.feed(sent[7:])["n"].tolist() == [1, 2, 3, 4]


def test_one_damaged_number_does_not_spoil_all_that_follow():
    broken = bytearray(record(3))
    broken[28] = 0x7F  # the number becomes 2130706435
    parser = RecordParser(4)
    sent = record(0) + record(1) + record(2) + bytes(broken) + b"".join(record(n) for n in range(4, 8))
    assert parser.feed(sent)["n"].tolist() == [0, 1, 2, 4, 5, 6, 7]


@given(st.lists(st.integers(1, 2**31 - 1), min_size=2, max_size=20), st.integers(0, 2**32 - 1))
def test_microseconds_go_on_across_the_wrap(steps, first):
    true = first + np.concatenate(([0], np.cumsum(steps)))
    ticks, before = [], -1
    for value in true:
        before = int(continue_ticks(np.array([value % 2**32], np.int64), before)[-1])
        ticks.append(before)
    np.testing.assert_array_equal(ticks, true)


def test_volts_and_ticks_arrive(tmp_path):
    with logger(tmp_path) as device:
        blocks = take(device, 60)
    values = np.concatenate([block.values for block in blocks])
    ticks = np.concatenate([block.ticks for block in blocks])
    np.testing.assert_allclose(np.diff(values, axis=1), 10 * 10 / 1023)
    assert set(np.diff(ticks)) == {5000}
    np.testing.assert_array_equal(numbers_of(blocks), np.arange(len(values)))


@pytest.mark.parametrize(
    ("fault", "lost"),
    [
        ({"kind": "bad_crc", "at": 30}, 1),
        ({"kind": "short_read", "at": 30, "amount": 9}, 1),
        ({"kind": "drop", "at": 30, "items": 2}, 2),
        ({"kind": "garbage", "at": 30, "amount": 17}, 0),
        ({"kind": "duplicate", "at": 30}, 0),
        ({"kind": "counter_jump", "at": 30}, 3),
    ],
)
def test_every_fault_shows_as_what_it_is(tmp_path, fault, lost):
    with logger(tmp_path, faults=[fault]) as device:
        numbers = numbers_of(take(device, 60))
    assert numbers[-1] + 1 - numbers.size == lost
    assert len(set(numbers)) == numbers.size


def test_numbers_and_microseconds_wrap(tmp_path):
    with logger(tmp_path, first_us=2**32 - 20_000) as device:
        ticks = np.concatenate([block.ticks for block in take(device, 20)])
    assert set(np.diff(ticks)) == {5000}


def test_it_waits_for_its_trigger_without_complaint(tmp_path):
    with logger(tmp_path, {"timeout_s": 0.3}, line="trigger") as device:
        line = LineWriter(tmp_path, "trigger")
        began_s = time.monotonic()

        class Pulsing(StopSwitch):
            def stopping(self):
                if time.monotonic() - began_s > 0.6 and not self.sent:
                    self.sent = True
                    line.start_session()
                    line.emit(RealClock().now_ns())
                return False

            sent = False

        stream = device.samples(Pulsing())
        block = next(stream)
    assert time.monotonic() - began_s > 0.6
    assert block.first_index == 0


def test_a_logger_that_stops_says_so(tmp_path):
    stopping = {"line": "trigger", "log_for_s": 0.2}
    line = LineWriter(tmp_path, "trigger")
    with logger(tmp_path, **stopping) as device:
        line.start_session()
        line.emit(RealClock().now_ns())
        with pytest.raises(DeviceTimeout, match="has stopped logging"):
            take(device, 1000)


def test_silence_and_unplugging_are_typed(tmp_path):
    silent = {"faults": [{"kind": "timeout", "at": 20, "seconds": 60}]}
    with (
        logger(tmp_path, {"timeout_s": 0.3}, **silent) as device,
        pytest.raises(DeviceTimeout, match="no record"),
    ):
        take(device, 1000)
    gone = {"faults": [{"kind": "disconnect", "at": 20}]}
    with logger(tmp_path, **gone) as device, pytest.raises(DeviceDisconnected, match="is gone"):
        take(device, 1000)


def test_the_wrong_number_of_channels_says_what_to_check(tmp_path):
    wrong = {"channels": ["a", "b", "c"], "timeout_s": 0.4}
    with logger(tmp_path, wrong) as device, pytest.raises(DeviceTimeout) as caught:
        take(device, 10)
    assert "as many as its firmware has" in caught.value.remedy
    with pytest.raises(DeviceFault, match="each name once"), logger(tmp_path, {"channels": ["a", "a"]}):
        pass
