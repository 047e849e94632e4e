"""Bytes of the LabJack U6, and its stream out of any packets."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_drivers.labjack_u6 import codec
from thermacq_drivers.labjack_u6.stream import EdgeFinder, Packet, PacketParser, ScanAssembler

CONFIG_REPLY = bytes.fromhex("09F81008F601000000 2D010F060002 DF3D7515 0600 01" + "00" * 15 + "04")
STREAM_CONFIG = bytes.fromhex("12F80811FF00 040118000000 409C 00000100 02000300")


def test_worked_commands():
    assert codec.config_read().hex() == "0bf80a080000" + "00" * 20
    assert codec.memory_read(0).hex() == "27f8012d00000000"
    clock = codec.ScanClock(0, 4e6, 40_000)
    assert codec.stream_config([codec.Input(n) for n in range(4)], clock, 24, 1, 0) == STREAM_CONFIG
    assert codec.extended(0x0B, bytes(10))[:6].hex() == "09f8050b0000"


def test_the_published_checksum_of_a_docstring():
    # 07 F8 03 0B 00 00 and six zeros, as in the vendor's documentation.
    assert codec.extended(0x0B, bytes(6)).hex() == "07f8030b0000" + "00" * 6


def test_the_published_config_reply():
    assert codec.parse_config(CONFIG_REPLY) == codec.Individual("360005087", "U6", "1.45")
    with pytest.raises(ValueError, match="damaged"):
        codec.parse_config(CONFIG_REPLY[:-1] + b"\x05")


def test_options_of_an_input():
    assert codec.Input(2, 1000, differential=True).options() == 0b1011_0000
    assert codec.Input(0, 10).options() == 0b0001_0000


def test_volts_of_known_codes():
    codes = np.array([33523, 33524, 33522, 65535, 0], np.uint16)
    expected = [0, 3.1580578e-4, -3.158058e-4, 32012 * 3.1580578e-4, -33523 * 3.158058e-4]
    np.testing.assert_allclose(codec.NOMINAL.volts(codes, 1), expected, rtol=1e-12)
    np.testing.assert_allclose(codec.NOMINAL.volts(codes, 100), np.array(expected) / 100, rtol=1e-12)


@pytest.mark.parametrize(
    ("asked_hz", "tick_rate_hz", "interval"),
    [
        (1000, 48e6, 48_000),
        (997, 48e6, 48_144),
        (700, 4e6, 5_714),
        (50, 187_500, 3_750),
        (1, 15_625, 15_625),
    ],
)
def test_the_scan_clock(asked_hz, tick_rate_hz, interval):
    clock = codec.scan_clock(asked_hz)
    assert (clock.tick_rate_hz, clock.interval) == (tick_rate_hz, interval)


@given(st.floats(0.25, 50_000))
def test_every_rate_is_met_as_near_as_its_clock_can_and_stays(rate_hz):
    clock = codec.scan_clock(rate_hz)
    assert abs(clock.rate_hz / rate_hz - 1) <= 0.5 / clock.interval * 1.001
    assert clock.interval >= 900 or clock.tick_rate_hz / clock.interval < 3 or rate_hz < 100
    assert codec.scan_clock(clock.rate_hz) == clock


def test_a_rate_too_slow_is_refused():
    with pytest.raises(ValueError, match=r"at least 0\.238"):
        codec.scan_clock(0.1)


@given(st.binary(max_size=80))
def test_no_reply_breaks_the_parsers(data):
    for parse in (
        codec.parse_config,
        codec.parse_memory,
        lambda reply: codec.parse_short(reply, codec.STREAM_START),
    ):
        with pytest.raises(ValueError, match="damaged"):
            parse(data)


def test_calibration_that_is_none_is_refused():
    blank = [(-(2.0**-32),) * 4] * 4
    with pytest.raises(ValueError, match="far from the nominal"):
        codec.calibration_from(blank)


# Stream


def packet(counter, samples, error=0, dropped=0):
    body = (
        struct.pack("<IBB", dropped, counter % 256, error) + np.asarray(samples, "<u2").tobytes() + bytes(2)
    )
    head = bytes((0xF9, 4 + len(samples), 0xC0)) + struct.pack("<H", sum(body) & 0xFFFF)
    return bytes((codec.checksum8(head),)) + head + body


def test_the_published_packet():
    # 24 samples from 33523 on, packet 0; the bytes after its beginning follow from the layout.
    sent = packet(0, range(33523, 33547))
    assert sent[:4].hex() == "07f91cc0"
    assert sent[12:16].hex() == "f382f482"
    (found,) = PacketParser(24).feed(sent)
    assert (found.counter, found.error, found.samples.tolist()) == (0, 0, list(range(33523, 33547)))


@given(st.data())
def test_packets_come_whole_however_the_bytes_are_cut(data):
    size = data.draw(st.integers(1, 25))
    sent = b"".join(packet(number, range(number, number + size)) for number in range(8))
    parser, found = PacketParser(size), []
    while sent:
        cut = data.draw(st.integers(1, len(sent)))
        found += parser.feed(sent[:cut])
        sent = sent[cut:]
    assert [one.counter for one in found] == list(range(8))
    assert parser.damaged == 0


@given(st.lists(st.binary(max_size=200), max_size=8))
def test_no_bytes_break_the_stream_parser(pieces):
    parser = PacketParser(25)
    for piece in pieces:
        assert parser.feed(piece) == []
    assert parser.damaged <= -(-sum(map(len, pieces)) // 64)


@given(st.sets(st.integers(1, 10), min_size=1, max_size=4), st.integers(0, 63), st.integers(1, 255))
def test_every_damaged_packet_is_counted(victims, place, flip):
    sent = [bytearray(packet(number, range(25))) for number in range(12)]
    for victim in victims:
        sent[victim][place] ^= flip
    parser = PacketParser(25)
    found = [one.counter for piece in sent for one in parser.feed(bytes(piece))]
    # The sums are weak: some changes of a checksum's byte alone, 0 against 255, leave it as good.
    assert set(range(12)) - victims <= set(found)
    assert parser.damaged == 12 - len(found)


@given(st.integers(1, 15), st.integers(1, 25), st.sets(st.integers(0, 599), max_size=40))
def test_scans_keep_their_numbers_whatever_is_lost(channels, size, lost):
    """Samples say which scan and channel they are; 600 packets wrap the counter."""
    lost = {number for number in lost if not {number + 1, number + 2} <= lost} - {599}
    assembler = ScanAssembler(channels, size)
    seen = []
    for number in range(600):
        if number not in lost:
            samples = np.arange(number * size, (number + 1) * size) % 65536
            for first, codes in assembler.take(Packet(number % 256, 0, 0, samples.astype(np.uint16), 0)):
                numbers = first + np.arange(len(codes))
                expected = (numbers[:, None] * channels + np.arange(channels)) % 65536
                np.testing.assert_array_equal(codes, expected)
                seen += numbers.tolist()
    whole = {
        scan
        for scan in range(600 * size // channels)
        if not lost & set(range(scan * channels // size, ((scan + 1) * channels - 1) // size + 1))
    }
    assert set(seen) == whole
    assert len(seen) == len(whole)
    assert assembler.lost_packets == len(lost)


def take_all(assembler, packets):
    return [
        (first, codes.tolist())
        for number, error, dropped, samples in packets
        for first, codes in assembler.take(Packet(number, error, dropped, np.array(samples, np.uint16), 0))
    ]


def test_dropped_scans_are_a_gap_after_the_scan_under_way():
    runs = take_all(
        ScanAssembler(2, 3), [(0, 59, 0, [1, 2, 3]), (1, 60, 10, [4, 5, 6]), (2, 0, 0, [7, 8, 9])]
    )
    assert runs == [(0, [[1, 2]]), (1, [[3, 4]]), (12, [[5, 6]]), (13, [[7, 8]])]


def test_a_repeated_packet_is_taken_once():
    assert take_all(ScanAssembler(1, 1), [(0, 0, 0, [5]), (0, 0, 0, [5]), (1, 0, 0, [6])]) == [
        (0, [[5]]),
        (1, [[6]]),
    ]


def test_a_lost_report_is_not_passed_over():
    with pytest.raises(ValueError, match="how many scans were dropped"):
        take_all(ScanAssembler(1, 1), [(0, 59, 0, [1]), (2, 0, 0, [1])])


def test_edges_are_found_across_blocks_and_none_in_gaps():
    finder = EdgeFinder(2)
    assert finder.take(0, np.array([4, 0, 4, 4], np.uint16)).tolist() == [2]
    assert finder.take(4, np.array([0, 0xFFFB], np.uint16)).tolist() == []
    assert finder.take(6, np.array([4], np.uint16)).tolist() == [6]
    assert finder.take(20, np.array([4, 0, 4], np.uint16)).tolist() == [22]
