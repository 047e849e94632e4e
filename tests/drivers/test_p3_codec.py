"""The P3's bytes: worked commands, markers, and frames found among any bytes."""

from __future__ import annotations

import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from thermacq_drivers.p3 import codec
from thermacq_drivers.p3.codec import FrameFinder, Marker, Model

TINY = Model("tiny", 2, 4)  # 48 bytes of pixels, 72 with markers
PERIOD_S = 0.04


@pytest.mark.parametrize(
    ("made", "worked"),
    [
        (codec.read_register(*codec.NAME), "01 01 81 00 01 00 00 00 00 00 00 00 1E 00 00 00 4F 90"),
        (codec.read_register(*codec.FIRMWARE), "01 01 81 00 02 00 00 00 00 00 00 00 0C 00 00 00 1F 63"),
        (codec.read_register(6, 64), "01 01 81 00 06 00 00 00 00 00 00 00 40 00 00 00 65 4F"),
        (codec.read_register(*codec.SERIAL), "01 01 81 00 07 00 00 00 00 00 00 00 40 00 00 00 10 4C"),
        (codec.read_register(0x0A, 64), "01 01 81 00 0A 00 00 00 00 00 00 00 40 00 00 00 19 59"),
        (codec.read_register(0x0F, 64), "01 01 81 00 0F 00 00 00 00 00 00 00 40 00 00 00 B8 57"),
        (codec.START_STREAM, "01 2F 81 00 00 00 00 00 00 00 00 00 01 00 00 00 49 30"),
        (codec.GAIN["low"], "01 2F 41 00 00 00 00 00 00 00 00 00 00 00 00 00 3C 3A"),
        (codec.GAIN["high"], "01 2F 41 00 01 00 00 00 00 00 00 00 00 00 00 00 49 39"),
        (codec.SHUTTER, "01 36 43 00 00 00 00 00 00 00 00 00 00 00 00 00 CD 0B"),
    ],
)
def test_worked_commands(made, worked):
    assert made == bytes.fromhex(worked)


def test_sizes_of_the_two_models():
    p3, p1 = codec.MODELS[0x45A2], codec.MODELS[0x45C2]
    assert (p3.pixel_bytes, p1.pixel_bytes) == (197_632, 77_440)
    for model in (p3, p1):
        assert model.read_bytes % 512 == 0
        assert model.read_bytes > model.pixel_bytes + 12


def marker(sync, cnt1, cnt3):
    return struct.pack("<BBIIH", 12, sync, cnt1, 5, cnt3)


def frame(number, model=TINY, fill=0):
    pixels = bytes([fill]) * model.pixel_bytes
    toggle = number & 1
    begins, ends = 40 * number % 2048, 40 * (number + 1) % 2048
    return marker(0x8C | toggle, number, begins) + pixels + marker(0x8E | toggle, number, ends)


def test_worked_markers():
    assert codec.parse_marker(marker(0x8C, 601097, 40)) == Marker(0x8C, 601097, 5, 40)
    assert codec.parse_marker(marker(0x8F, 601097, 80)) == Marker(0x8F, 601097, 5, 80)
    assert codec.parse_marker(marker(0x8C, 1, 2048)) is None
    assert codec.parse_marker(marker(0x90, 1, 0)) is None
    assert codec.parse_marker(b"\x0c\x8c") is None


@given(st.binary(max_size=200))
def test_texts_of_any_bytes_are_printable(data):
    assert codec.parse_text(data).isprintable()
    assert codec.parse_text(b" P3\0 rubbish") == "P3"


def test_temperatures_are_the_last_rows():
    words = np.arange((2 * TINY.rows + 2) * TINY.columns, dtype="<u2")
    np.testing.assert_array_equal(
        codec.temperatures(words.tobytes(), TINY), [[16, 17, 18, 19], [20, 21, 22, 23]]
    )


@given(st.integers(1, 12), st.data())
def test_frames_come_whole_however_the_bytes_are_cut(number, data):
    sent = b"".join(frame(index) for index in range(number))
    finder, found = FrameFinder(TINY), []
    while sent:
        piece = data.draw(st.integers(1, len(sent)))
        found += finder.feed(sent[:piece])
        sent = sent[piece:]
    assert [raw.start.cnt1 for raw in found] == list(range(number))
    assert not any(raw.skipped for raw in found)


damage = st.sampled_from(["cut", "lost", "start", "end", "garbage before", "none"])


@given(st.lists(damage, min_size=1, max_size=10), st.binary(min_size=1, max_size=150), st.integers(1, 60))
@example(["cut"], b"\0", 3)  # the next frame begins with the bytes that are missing
def test_every_damaged_frame_is_missing_in_the_count_and_no_other(damages, garbage, cut):
    # Neither a marker nor, by chance, the end of a frame that was cut before it.
    garbage = b"\xff" + garbage.replace(b"\x0c", b"\x0b")
    sent, good = [frame(0)], [0]
    for number, kind in enumerate([*damages, "none"], start=1):
        whole = frame(number)
        changed = {
            "cut": whole[:-cut],
            "lost": b"",
            "start": b"\xff" + whole[1:],
            "end": whole[:-11] + b"\0" + whole[-10:],
            "garbage before": garbage + whole,
            "none": whole,
        }
        sent.append(changed[kind])
        if kind in ("garbage before", "none"):
            good.append(number)
    finder = FrameFinder(TINY)
    found = [raw for piece in sent for raw in finder.feed(piece)]
    assert [raw.start.cnt1 for raw in found] == good
    lost = sum(codec.lost_frames(one.end.cnt3, two.start.cnt3, PERIOD_S) for one, two in pairwise(found))
    assert lost == len(damages) + 2 - len(good)


@given(st.lists(st.binary(max_size=400), max_size=8))
def test_no_bytes_break_the_finder_and_its_memory_is_bounded(pieces):
    finder = FrameFinder(TINY)
    for piece in pieces:
        finder.feed(piece)
        assert len(finder._bytes) < TINY.frame_bytes
    found = finder.feed(frame(7) + frame(8) + frame(9))
    assert [raw.start.cnt1 for raw in found][-2:] == [8, 9]


def test_the_start_pattern_inside_a_picture_does_no_harm():
    tricky = bytearray(frame(1))
    tricky[12:60] = marker(0x8C, 9, 40) * 4
    found = FrameFinder(TINY).feed(frame(0)[20:] + bytes(tricky) + frame(2))
    assert [raw.start.cnt1 for raw in found] == [1, 2]


def test_the_irregular_first_frame_after_a_shutter_is_found():
    model = codec.MODELS[0x45A2]
    whole = frame(5, model)
    stream = bytes(9204) + whole + whole[-12:]
    assert (len(stream[204_800:]), len(stream)) == (2060 + 12, 204_800 + 2060 + 12)
    finder = FrameFinder(model)
    found = [
        raw for piece in (stream[:204_800], stream[204_800:-12], stream[-12:]) for raw in finder.feed(piece)
    ]
    assert [(raw.start.cnt1, raw.skipped) for raw in found] == [(5, 9204)]
    assert [raw.skipped for raw in finder.feed(frame(6, model))] == [12]


@given(st.integers(0, 2047), st.integers(0, 400), st.integers(-1, 1), st.floats(-0.4, 0.4, allow_nan=False))
def test_gaps_are_counted_across_turns_in_spite_of_jitter(ended, lost, jitter_ms, late_s):
    begins = (ended + 40 * lost + jitter_ms) % 2048
    elapsed_s = max(0.0, (lost + 1) * PERIOD_S + late_s)
    assert codec.lost_frames(ended, begins, elapsed_s) == lost


def test_a_leap_of_the_counter_is_a_gap_without_time():
    assert codec.lost_frames(0, 40 * 30, PERIOD_S) == 30
    assert codec.lost_frames(0, 0, 1.5) == 0  # the host was late, the frame was waiting


@given(st.binary(max_size=4))
def test_status(data):
    assert codec.is_ready(data) == (data[:1] in (b"\x02", b"\x03"))
