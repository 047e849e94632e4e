"""FSLP frames and telemetry rows of the Boson: worked bytes, and any bytes at all."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_drivers.boson import fslp
from thermacq_drivers.boson.acquisition import parse_temperature
from thermacq_drivers.boson.fslp import FrameParser, Function
from thermacq_drivers.boson.telemetry import PACKINGS, Place, find_telemetry, read_telemetry

WORKED_COMMANDS = [
    (1, Function.RUN_FFC, "", "8E 00 00000001 00050007 FFFFFFFF 225C AE"),
    (2, Function.CAMERA_SERIAL, "", "8E 00 00000002 00050002 FFFFFFFF 2C4F AE"),
    (3, Function.FPA_TEMPERATURE, "", "8E 00 00000003 00050030 FFFFFFFF 8F01 AE"),
    (4, Function.SET_FFC_MODE, "00000000", "8E 00 00000004 00050012 FFFFFFFF 00000000 9575 AE"),
    (5, Function.SET_EXT_SYNC, "00000002", "8E 00 00000005 00050098 FFFFFFFF 00000002 A07E AE"),
    (5, Function.SET_EXT_SYNC, "00000001", "8E 00 00000005 00050098 FFFFFFFF 00000001 901D AE"),
    (6, Function.SET_TELEMETRY_STATE, "00000001", "8E 00 00000006 00040001 FFFFFFFF 00000001 A961 AE"),
    (7, Function.SET_TELEMETRY_LOCATION, "00000000", "8E 00 00000007 00040003 FFFFFFFF 00000000 3A44 AE"),
    (0x8E, 0x00050006, "", "8E 00 000000 9E81 00050006 FFFFFFFF AFEB AE"),
]
WORKED_REPLIES = [
    ("8E 00 00000001 00050007 00000000 BB93 AE", (1, Function.RUN_FFC, 0, "")),
    ("8E 00 00000002 00050002 00000000 000439BE 5316 AE", (2, Function.CAMERA_SERIAL, 0, "000439BE")),
    ("8E 00 00000003 00050030 00000000 013A 357F AE", (3, Function.FPA_TEMPERATURE, 0, "013A")),
    ("8E 00 00000003 00050030 00000000 FFCE AA2A AE", (3, Function.FPA_TEMPERATURE, 0, "FFCE")),
    (
        "8E 00 9E81 9E91 9EA1 00 00050002 00000000 9E81 9E91 9EA1 01 D646 AE",
        (0x8E9EAE00, Function.CAMERA_SERIAL, 0, "8E9EAE01"),
    ),
    ("8E 00 00000009 00050007 00000161 DDDA AE", (9, Function.RUN_FFC, fslp.UNKNOWN_COMMAND, "")),
]
content = st.binary(max_size=60)


@pytest.mark.parametrize(("sequence", "function", "arguments", "worked"), WORKED_COMMANDS)
def test_worked_commands(sequence, function, arguments, worked):
    assert fslp.command(sequence, function, bytes.fromhex(arguments)) == bytes.fromhex(worked)


@pytest.mark.parametrize(("worked", "said"), WORKED_REPLIES)
def test_worked_replies(worked, said):
    ((channel, payload),) = FrameParser().feed(bytes.fromhex(worked))
    reply = fslp.parse_reply(payload)
    assert channel == fslp.COMMAND_CHANNEL
    assert (reply.sequence, reply.function, reply.status, reply.data.hex().upper()) == said


def test_the_checksum_of_the_digits():
    assert fslp.crc(b"123456789") == 0xE5CC


@pytest.mark.parametrize(("data", "celsius"), [("013A", 31.4), ("FFCE", -5.0)])
def test_temperatures_have_a_sign(data, celsius):
    assert parse_temperature(bytes.fromhex(data)) == pytest.approx(celsius + 273.15)


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\x02\x03"])
def test_a_temperature_of_another_length_is_none(data):
    with pytest.raises(ValueError, match="2 bytes"):
        parse_temperature(data)


@given(st.lists(st.tuples(st.integers(0, 255), content), max_size=6), st.data())
def test_frames_come_whole_however_the_bytes_are_cut(frames, data):
    sent = b"".join(fslp.frame(channel, payload) for channel, payload in frames)
    parser, got = FrameParser(), []
    while sent:
        piece = data.draw(st.integers(1, len(sent)))
        got += parser.feed(sent[:piece])
        sent = sent[piece:]
    assert got == frames
    assert parser.damaged == 0


@given(content)
def test_marks_stand_at_the_ends_only(payload):
    wire = fslp.frame(0, payload)
    assert wire[0] == fslp.START
    assert wire[-1] == fslp.END
    assert not {fslp.START, fslp.END} & set(wire[1:-1])


@given(st.lists(st.binary(max_size=200), max_size=6), content)
def test_no_bytes_break_the_parser_and_the_next_frame_is_read(pieces, payload):
    parser = FrameParser()
    for piece in pieces:
        for _channel, found in parser.feed(piece):
            fslp.parse_reply(found)
    parser.feed(bytes((fslp.END,)))
    assert parser.feed(fslp.frame(7, payload)) == [(7, payload)]


@given(content, st.data())
def test_every_damaged_frame_is_counted(payload, data):
    wire = bytearray(fslp.frame(0, payload))
    place = data.draw(st.integers(1, len(wire) - 2))
    wrong = data.draw(st.integers(0, 255).filter(lambda byte: byte not in (wire[place], fslp.END)))
    wire[place] = wrong
    parser = FrameParser()
    found = parser.feed(bytes(wire))
    # A start mark in the middle begins a frame of its own; its beginning is damaged, and its rest too.
    assert found == []
    assert parser.damaged == (2 if wrong == fslp.START else 1)


def test_a_frame_that_never_ends_is_given_up():
    parser = FrameParser()
    assert parser.feed(bytes((fslp.START,)) + bytes(10_000)) == []
    assert parser.damaged == 1


@pytest.mark.parametrize("payload", [b"", bytes(11)])
def test_a_short_payload_is_no_reply(payload):
    assert fslp.parse_reply(payload) is None


def record_row(packing, *, serial, counter, time_ms):
    """A row as the descriptions have it, written here once more."""
    row = np.zeros(640, np.uint16)
    for offset, value in ((2, serial), (84, counter), (88, 5), (280, time_ms)):
        if packing == "16-bit":
            row[offset // 2], row[offset // 2 + 1] = value >> 16, value & 0xFFFF
        else:
            row[offset : offset + 4] = list(struct.pack("<I", value))
    return row


@given(
    st.sampled_from(PACKINGS),
    st.sampled_from([0, 1, -1, -2]),
    st.integers(256, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
)
def test_the_row_is_found_and_read_in_both_packings(packing, place, serial, counter, time_ms):
    picture = np.full((10, 640), 20_011, np.uint16)
    picture[place] = record_row(packing, serial=serial, counter=counter, time_ms=time_ms)
    # Below 256 (no camera has such a number) both packings look alike.
    found = find_telemetry(picture, serial, PACKINGS)
    assert found == Place(packing, place)
    said = read_telemetry(picture[place], packing)
    assert (said.serial, said.counter, said.time_ms, said.last_ffc) == (serial, counter, time_ms, 5)
    assert picture[found.picture].shape == (8, 640)
    assert (picture[found.picture] == 20_011).all()


def test_word_42_is_the_counter_and_word_140_the_milliseconds():
    row = np.zeros(640, np.uint16)
    row[42:44], row[140:142] = (0x0001, 0x0002), (0x0003, 0x0004)
    said = read_telemetry(row, "16-bit")
    assert (said.counter, said.time_ms) == (0x10002, 0x30004)


def test_another_cameras_row_or_none_is_not_found():
    picture = np.full((10, 640), 20_011, np.uint16)
    assert find_telemetry(picture, 276926, PACKINGS) is None
    picture[0] = record_row("16-bit", serial=276927, counter=1, time_ms=2)
    assert find_telemetry(picture, 276926, PACKINGS) is None
    assert find_telemetry(np.zeros((10, 640), np.uint16), 0, PACKINGS) is None
    assert find_telemetry(picture, 276927, ("8-bit",)) is None
