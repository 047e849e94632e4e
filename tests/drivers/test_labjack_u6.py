"""The LabJack U6: its bytes, its stream out of any packets, and the driver on emulated devices with faults."""

from __future__ import annotations

import struct
import time
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.devices import DeviceContext
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.hooks import Emulation
from thermacq.testing.emulation.world import EmulatedTransports
from thermacq.testing.emulators.labjack_u6 import attach
from thermacq.timing.clock import VirtualClock
from thermacq.timing.trigger_line import LineWriter
from thermacq_drivers.labjack_u6 import codec
from thermacq_drivers.labjack_u6.link import discover
from thermacq_drivers.labjack_u6.probe import LabJackU6
from thermacq_drivers.labjack_u6.stream import EdgeFinder, Packet, PacketParser, ScanAssembler

CONFIG_REPLY = bytes.fromhex("09F81008F601000000 2D010F060002 DF3D7515 0600 01" + "00" * 15 + "04")
STREAM_CONFIG = bytes.fromhex("12F80811FF000401180000004 09C0000010002000300".replace(" ", ""))
FOUR = {
    "inputs": [{"name": f"gauge{ain}", "ain": ain} for ain in range(4)],
    "line": 2,
}


class Host:
    def stopping(self):
        return False


# Bytes


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


# Driver on emulated devices


@contextmanager
def gauge(tmp_path, settings=None, clock=None, serial="", **emulation):
    clock = clock or VirtualClock()
    with attach(Emulation("gauge", clock, tmp_path, emulation)) as transports:
        device = LabJackU6(DeviceContext("gauge", clock, transports=transports, serial=serial))
        try:
            device.open()
            device.configure(settings or {})
            device.arm()
            yield device
        finally:
            device.close()


def take(device, scans):
    """Blocks up to this scan, and the faults through which the stream went on."""
    blocks, faults = [], []
    stream = device.samples(Host())
    while not blocks or blocks[-1].first_index + len(blocks[-1].ticks) < scans:
        try:
            blocks.append(next(stream))
        except (IncompleteFrame, DeviceOverrun) as fault:
            faults.append(type(fault))
            stream = device.samples(Host())
    return blocks, faults


def together(blocks):
    index = np.concatenate([block.first_index + np.arange(len(block.ticks)) for block in blocks])
    return index, np.concatenate([block.values for block in blocks])


def test_identity_and_what_is_really_applied(tmp_path):
    with gauge(tmp_path, {**FOUR, "rate_hz": 997.0}, serial="", pro=True) as device:
        identity = device.open()
        applied = device.configure({**FOUR, "rate_hz": 997.0})
        assert device.configure(applied) == applied
        assert device.capabilities.tick_rate_hz == 48e6
    assert (identity.model, identity.firmware, len(identity.serial)) == ("U6-Pro", "1.45", 9)
    assert applied["rate_hz"] == pytest.approx(48e6 / 48_144)
    assert applied["calibration"] == "device"


def test_volts_are_those_of_the_sine_through_the_devices_own_constants(tmp_path):
    inputs = [{"name": "a", "ain": 0}, {"name": "b", "ain": 4, "gain": 10, "differential": True}]
    with gauge(tmp_path, {"inputs": inputs}, amplitude_v=0.5, wave_hz=2.0) as device:
        blocks, faults = take(device, 1000)
    index, values = together(blocks)
    wave = 0.5 * np.sin(2 * np.pi * 2.0 * index / 1000)
    np.testing.assert_allclose(values[:, 0], wave, atol=1.7e-4)
    np.testing.assert_allclose(values[:, 1], wave + 0.4, atol=1.7e-5)
    assert not faults
    # Nominal constants are off by 0.2 % and 7.25 codes.
    with gauge(tmp_path, {"inputs": inputs, "calibration": "nominal"}, amplitude_v=0.5) as device:
        _, nominal = together(take(device, 1000)[0])
    assert nominal[0, 0] > 2e-3


def test_a_blank_memory_gives_nominal_constants_and_says_so(tmp_path, caplog):
    with gauge(tmp_path, blank_calibration=True) as device:
        assert device.configure({})["calibration"] == "nominal"
    assert "nominal calibration is used" in caplog.text


@pytest.mark.parametrize("rate_hz", [2.0, 40.0, 333.0, 5000.0])
def test_blocks_are_short_at_every_rate_and_scans_follow_each_other(tmp_path, rate_hz):
    with gauge(tmp_path, {**FOUR, "rate_hz": rate_hz}) as device:
        blocks, faults = take(device, 40)
        capabilities = device.capabilities
    index, _ = together(blocks)
    ticks = np.concatenate([block.ticks for block in blocks])
    np.testing.assert_array_equal(index, np.arange(index.size))
    assert not faults
    assert set(np.diff(ticks)) == {round(capabilities.tick_rate_hz / rate_hz)}
    assert max(np.ptp(block.ticks) for block in blocks) <= 0.25 * capabilities.tick_rate_hz


@pytest.mark.parametrize(
    ("fault", "lost_packets", "announced"),
    [
        ({"kind": "bad_crc", "at": 30, "items": 2}, 2, [IncompleteFrame, IncompleteFrame]),
        ({"kind": "short_read", "at": 30, "amount": 9}, 1, [IncompleteFrame]),
        ({"kind": "garbage", "at": 30, "amount": 17}, 0, [IncompleteFrame]),
        ({"kind": "drop", "at": 30, "items": 3}, 3, []),
        ({"kind": "duplicate", "at": 30}, 0, []),
        ({"kind": "stall", "at": 30}, 1, [IncompleteFrame]),
    ],
)
def test_every_fault_is_announced_and_its_gap_is_exact(tmp_path, fault, lost_packets, announced):
    with gauge(tmp_path, {**FOUR, "inputs": FOUR["inputs"][:3]}, faults=[fault]) as device:
        blocks, faults = take(device, 1000)
    index, values = together(blocks)
    # Packets of 25 samples, scans of 4: those that touch a lost packet are gone, no other.
    lost = set(range(30, 30 + lost_packets))
    whole = [scan for scan in range(index[-1] + 1) if not lost & {4 * scan // 25, (4 * scan + 3) // 25}]
    assert index.tolist() == whole
    assert faults == announced
    np.testing.assert_allclose(values[:, 0], np.sin(np.pi * index / 1000), atol=1.7e-4)


def test_a_late_host_costs_scans_that_are_counted_exactly(tmp_path):
    slow = {"kind": "slow", "at": 40, "seconds": 2.0}
    with gauge(tmp_path, FOUR, faults=[slow]) as device:
        blocks, faults = take(device, 4000)
    index, values = together(blocks)
    gaps = np.diff(index) - 1
    assert faults == [DeviceOverrun]
    # It keeps 984 samples (196 scans of 5) of the 2000 scans.
    assert 1750 < gaps.sum() < 2000
    assert np.count_nonzero(gaps) == 1
    np.testing.assert_allclose(values[:, 1], 0.1 + np.sin(np.pi * index / 1000), atol=1.7e-4)


def test_silence_and_unplugging_are_typed(tmp_path):
    silent = [{"kind": "timeout", "at": 20, "items": 100_000}]
    with (
        gauge(tmp_path, {"timeout_s": 0.3}, faults=silent) as device,
        pytest.raises(DeviceTimeout, match="no packet within"),
    ):
        take(device, 100_000)
    gone = [{"kind": "disconnect", "at": 20}]
    with gauge(tmp_path, faults=gone) as device, pytest.raises(DeviceDisconnected, match="gone from USB"):
        take(device, 100_000)


def test_it_works_again_after_it_was_plugged_in_again(tmp_path):
    with gauge(tmp_path, FOUR, faults=[{"kind": "disconnect", "at": 20, "seconds": 0.2}]) as device:
        with pytest.raises(DeviceDisconnected):
            take(device, 100_000)
        device.close()
        time.sleep(0.3)
        device.open()
        device.configure(FOUR)
        device.arm()
        blocks, _ = take(device, 500)
    assert blocks[0].first_index == 0


def test_a_stream_that_was_left_running_is_ended(tmp_path):
    with gauge(tmp_path, FOUR, left_running=True) as device:
        blocks, faults = take(device, 300)
        assert not faults
        # Started behind the driver's back: error 48 at StreamStart.
        device.arm()
        device._link.ask(codec.STREAM_START, "test")
        blocks, _ = take(device, 300)
    np.testing.assert_array_equal(together(blocks)[0], np.arange(len(together(blocks)[0])))


@pytest.mark.parametrize("clock_ppm", [0.0, 50.0])
def test_pulses_on_the_line_get_ticks(tmp_path, clock_ppm):
    clock = VirtualClock()
    with gauge(tmp_path, FOUR, clock, clock_ppm=clock_ppm, line="trigger", line_input=2) as device:
        line = LineWriter(tmp_path, "trigger")
        line.start_session()
        pulses_s = 0.0137 + np.arange(100) * 0.02
        for pulse_s in pulses_s:
            line.emit(clock.now_ns() + round(pulse_s * 1e9))
        line.finish_session()
        blocks, _ = take(device, 2500)
    ticks = np.concatenate([block.pulse_ticks for block in blocks])
    stamped_s = ticks / device.capabilities.tick_rate_hz
    assert ticks.size == 100
    np.testing.assert_allclose(stamped_s, pulses_s * (1 + clock_ppm * 1e-6), atol=0.51e-3)


def test_several_devices_are_told_apart_by_their_own_numbers(tmp_path):
    clock = VirtualClock()
    with (
        attach(Emulation("a", clock, tmp_path, {"serial": "360000001"})) as first,
        attach(Emulation("b", clock, tmp_path, {"serial": "360000002", "pro": True})) as second,
    ):
        both: EmulatedTransports = first + second
        assert [(one.serial, one.model) for one in discover(both)] == [
            ("360000001", "U6"),
            ("360000002", "U6-Pro"),
        ]
        wanted = LabJackU6(DeviceContext("b", clock, transports=both, serial="360000002"))
        assert wanted.open().serial == "360000002"
        # One that is in use is listed, without its number.
        assert [one.serial for one in discover(both)] == ["360000001", ""]
        wanted.close()
        with pytest.raises(DeviceFault, match="360000001, 360000002"):
            LabJackU6(DeviceContext("c", clock, transports=both)).open()
        with pytest.raises(DeviceDisconnected, match="no LabJack U6 with serial number '9'"):
            LabJackU6(DeviceContext("d", clock, transports=both, serial="9")).open()


def test_mistakes_in_the_settings_say_what_to_mend(tmp_path):
    with gauge(tmp_path) as device:
        for wrong, words in (
            ({"rate_hz": 20_000, **FOUR}, "at most 10000 scans/s with 5 channels"),
            ({"inputs": [{"name": "a", "ain": 1, "differential": True}]}, "even terminal"),
            ({"inputs": [{"name": "a", "ain": 1}, {"name": "a", "ain": 2}]}, "each name once"),
            ({"line": 16}, "line"),
        ):
            with pytest.raises(DeviceFault, match=words):
                device.configure(wrong)
        with pytest.raises(DeviceFault, match="not configured"):
            device.arm()
