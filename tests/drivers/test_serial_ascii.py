"""The printing probe: lines from any bytes, and the driver on its emulated probe with faults of the wire."""

from __future__ import annotations

import re
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.devices import DeviceContext
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.hooks import Emulation
from thermacq.testing.bench import StopSwitch
from thermacq.testing.emulators.serial_ascii import attach
from thermacq.timing.clock import RealClock
from thermacq_drivers.serial_ascii import (
    LONGEST_LINE,
    LineSplitter,
    SerialAsciiProbe,
    channel_names,
    discover,
    parse_line,
)

MAXBOTIX = re.compile(r"R(?P<distance>\d{4})")
WAIT = 5.0


@contextmanager
def probe(tmp_path, settings=None, serial="", **emulation):
    clock = RealClock()
    with attach(Emulation("gauge", clock, tmp_path, {"rate_hz": 100, **emulation})) as transports:
        context = DeviceContext("gauge", clock, transports=transports, serial=serial, runtime_dir=tmp_path)
        device = SerialAsciiProbe(context)
        try:
            device.open()
            device.configure({"timeout_s": WAIT, **(settings or {})})
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
            return blocks
    return blocks


def lost(blocks):
    ends = [block.first_index + len(block.values) for block in blocks]
    return sum(block.first_index - end for block, end in zip(blocks[1:], ends, strict=False))


@given(st.lists(st.integers(0, 9999), max_size=8), st.data())
def test_lines_come_whole_however_the_bytes_are_cut(numbers, data):
    sent = b"".join(b"R%04d\r" % number for number in numbers)
    splitter, lines = LineSplitter(b"\r"), []
    while sent:
        piece = data.draw(st.integers(1, len(sent)))
        lines += splitter.feed(sent[:piece])
        sent = sent[piece:]
    assert [parse_line(line, MAXBOTIX, 1.0) for line in lines] == [[float(number)] for number in numbers]


@given(st.lists(st.binary(max_size=400), max_size=6))
def test_no_bytes_break_the_splitter_and_its_memory_is_bounded(pieces):
    splitter = LineSplitter(b"\r\n")
    lines = [line for piece in pieces for line in splitter.feed(piece)]
    assert len(lines) == b"".join(pieces).count(b"\r\n")
    assert all(len(line) <= LONGEST_LINE and line.isprintable() for line in lines if "\t" not in line)


def test_bytes_that_are_not_ascii_do_no_harm():
    assert LineSplitter(b"\r").feed(b"\xffR12\xfe34\r") == ["R1234"]


def test_an_overlong_line_is_one_line_that_fits_nothing():
    splitter = LineSplitter(b"\r")
    assert splitter.feed(b"1" * 3 * LONGEST_LINE) == []
    assert splitter.feed(b"R0001\rR0002\r") == ["", "R0002"]


@pytest.mark.parametrize("line", ["", "R12", "R12345", "xR1234", "R1234R1240", "R１２３４"])
def test_a_line_must_fit_as_a_whole(line):
    assert parse_line(line, re.compile(r"R([0-9]{4})"), 1.0) is None


def test_numbers_that_are_none_are_refused():
    assert parse_line("nan", re.compile("(.*)"), 1.0) is None
    assert parse_line("abc", re.compile("(.*)"), 1.0) is None
    assert parse_line("5", re.compile("(5)|(6)"), 1.0) is None


def test_groups_name_the_channels():
    pattern = re.compile(r"(?P<level>[-\d.]+),([-\d.]+)")
    assert channel_names(pattern) == ("level", "value2")
    assert parse_line("0.5,-2", pattern, 10.0) == [5.0, -20.0]


def test_what_is_printed_arrives_in_metres(tmp_path):
    with probe(tmp_path, amplitude=0, mean=1234) as device:
        blocks = take(device, 20)
    values = np.concatenate([block.values for block in blocks])
    np.testing.assert_allclose(values, 1.234)
    assert lost(blocks) == 0
    assert blocks[0].first_index == 0


@pytest.mark.parametrize(
    ("fault", "least", "most"),
    [
        ({"kind": "bad_crc", "at": 10}, 1, 1),  # the line end is damaged: two lines become one
        ({"kind": "short_read", "at": 10, "amount": 3}, 1, 1),
        (
            {"kind": "garbage", "at": 10, "amount": 5},
            0,
            2,
        ),  # may itself hold a line end, or nothing that is ASCII
        ({"kind": "duplicate", "at": 10}, 0, 0),
    ],
)
def test_a_damaged_line_is_a_gap_in_the_count(tmp_path, fault, least, most):
    with probe(tmp_path, faults=[fault], amplitude=0, mean=1500) as device:
        blocks = take(device, 40)
    assert least <= lost(blocks) <= most
    np.testing.assert_allclose(np.concatenate([block.values for block in blocks]), 1.5)


def test_a_probe_that_is_asked(tmp_path):
    settings = {"ask": "?", "rate_hz": 100.0}
    with probe(tmp_path, settings, ask="?", amplitude=0, mean=777) as device:
        blocks = take(device, 10)
    assert {float(value) for block in blocks for value in block.values.ravel()} == {0.777}


def test_silence_and_unplugging_are_typed(tmp_path):
    silent = {"faults": [{"kind": "timeout", "at": 5, "seconds": 60}]}
    with (
        probe(tmp_path, {"timeout_s": 0.3}, **silent) as device,
        pytest.raises(DeviceTimeout, match="no line"),
    ):
        take(device, 1000)
    unplugged = {"faults": [{"kind": "disconnect", "at": 5}]}
    with probe(tmp_path, **unplugged) as device, pytest.raises(DeviceDisconnected, match="is gone"):
        take(device, 1000)


def test_it_works_again_after_it_was_plugged_in_again(tmp_path):
    with probe(tmp_path, faults=[{"kind": "disconnect", "at": 5, "seconds": 0.2}]) as device:
        with pytest.raises(DeviceDisconnected):
            take(device, 1000)
        device.close()
        for _ in range(100):
            try:
                identity = device.open()
                break
            except DeviceDisconnected:
                RealClock().wait_until_ns(RealClock().now_ns() + 20_000_000)
        device.configure({"timeout_s": WAIT})
        device.arm()
        assert lost(take(device, 10)) == 0
    assert identity.serial == "EMU-gauge"


def test_wrong_settings_say_what_to_mend(tmp_path):
    with probe(tmp_path) as device:
        with pytest.raises(DeviceFault, match="it has no group"):
            device.configure({"pattern": "R1234"})
        with pytest.raises(DeviceFault, match="no regular expression"):
            device.configure({"pattern": "R("})
        device.configure({"pattern": "(X)", "timeout_s": 0.2})
        device.arm()
        with pytest.raises(DeviceTimeout, match="no line that fits") as caught:
            take(device, 1)
    assert "Check baud rate" in caught.value.remedy


def test_only_the_adapter_that_is_meant_is_opened(tmp_path):
    with pytest.raises(DeviceDisconnected, match="EMU-gauge"), probe(tmp_path, serial="OTHER"):
        pass
    with attach(Emulation("gauge", RealClock(), tmp_path, {})) as transports:
        assert [found.serial for found in discover(transports)] == ["EMU-gauge"]
