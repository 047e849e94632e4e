"""The Tau 2's bytes: worked packets, FTDI's packets, frames and serial bytes found in any stream."""

from __future__ import annotations

import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq_drivers.tau2 import packets, teax
from thermacq_drivers.tau2.packets import Answer, AnswerFinder, Function, Sensor
from thermacq_drivers.tau2.teax import StreamFinder

ROWS, COLUMNS = 128, 160  # the smallest camera


@pytest.mark.parametrize(
    ("made", "worked"),
    [
        (packets.packet(Function.DO_FFC), "6E 00 00 0C 00 00 AA DA 00 00"),
        (packets.packet(Function.SERIAL_NUMBER), "6E 00 00 04 00 00 03 7B 00 00"),
        (packets.ask_sensor(Sensor.FPA), "6E 00 00 20 00 02 79 3F 00 00 00 00"),
        (packets.packet(Function.READ_SENSOR, packets.word(253)), "6E 00 00 20 00 02 79 3F 00 FD 3E B2"),
        (packets.packet(Function.EXTERNAL_SYNC, packets.word(1)), "6E 00 00 21 00 02 4E 0F 00 01 10 21"),
        (packets.packet(Function.EXTERNAL_SYNC), "6E 00 00 21 00 00 6E 4D 00 00"),
    ],
)
def test_worked_packets(made, worked):
    assert made == bytes.fromhex(worked)


def test_the_worked_answer_is_25_degrees():
    answers = AnswerFinder().feed(bytes.fromhex("6E 00 00 20 00 02 79 3F 00 FD 3E B2"))
    assert answers == [Answer(0x20, 0, b"\x00\xfd")]
    assert packets.parse_temperature(answers[0].data, Sensor.FPA) == pytest.approx(25.3 + 273.15)


def test_temperatures_are_signed():
    assert packets.parse_temperature(b"\xff\x9c", Sensor.FPA) == pytest.approx(273.15 - 10.0)
    assert packets.parse_temperature(b"\xff\x9c", Sensor.HOUSING) == pytest.approx(273.15 - 1.0)


@given(st.binary(max_size=12))
def test_contents_of_any_length_are_parsed_or_refused(data):
    for parse, length in ((packets.parse_word, 2), (packets.parse_serial, 8)):
        try:
            parse(data)
        except ValueError:
            assert len(data) != length
        else:
            assert len(data) == length


answers_sent = st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=20)), min_size=1, max_size=6)


@given(answers_sent, st.data())
def test_answers_come_whole_however_the_bytes_are_cut(sent, data):
    stream = b"".join(packets.packet(function, content) for function, content in sent)
    finder, found = AnswerFinder(), []
    while stream:
        piece = data.draw(st.integers(1, len(stream)))
        found += finder.feed(stream[:piece])
        stream = stream[piece:]
    assert found == [Answer(function, 0, content) for function, content in sent]
    assert finder.passed_over == 0


@given(answers_sent, st.data())
def test_a_damaged_answer_is_missing_and_no_other(sent, data):
    made = [packets.packet(function, content) for function, content in sent]
    victim = data.draw(st.integers(0, len(made) - 1))
    place = data.draw(st.integers(0, len(made[victim]) - 1))
    broken = bytearray(made[victim])
    broken[place] ^= data.draw(st.integers(1, 255))
    # Enough after it that a damaged length cannot wait for more.
    stream = b"".join(bytes(broken) if n == victim else one for n, one in enumerate(made)) + bytes(300)
    finder = AnswerFinder()
    found = finder.feed(stream)
    kept = [Answer(function, 0, content) for n, (function, content) in enumerate(sent) if n != victim]
    assert found == kept
    assert finder.passed_over >= len(made[victim])


@given(st.binary(max_size=1500))
def test_status_bytes_are_taken_out(data):
    pieces = [data[place : place + 510] for place in range(0, max(1, len(data)), 510)]
    assert teax.without_status(b"".join(b"\x32\x60" + piece for piece in pieces)) == data


def test_the_size_of_a_frame_is_the_published_one():
    words = 1 + 512 * (640 + 2)
    assert 8 + 2 * words == 657_418
    # Flirpy reads width + 2 at offset 5: the middle of the number of words, for a camera of 256 rows.
    assert struct.unpack_from("<H", struct.pack("<I", 1 + 256 * (336 + 2)), 1)[0] == 336 + 2


def frame(value, rows=ROWS, columns=COLUMNS):
    words = np.full((rows, columns + 2), 0x4000, "<u2")
    words[:, 1:-1] = 0xC000 | value
    words[-1, -1] = 0
    return b"TEAX" + struct.pack("<IH", words.size + 1, 0x1234) + words.tobytes()


def serial(data):
    return b"".join(b"UART\x01" + bytes([byte]) for byte in data)


@pytest.mark.parametrize(("rows", "columns"), [(512, 640), (256, 336), (128, 160)])
def test_pictures_of_every_size(rows, columns):
    found = StreamFinder().feed(frame(0x2ABC, rows, columns))
    assert [one.shape for one in found] == [(rows, columns)]
    assert np.all(found[0] == 0x2ABC)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.one_of(st.integers(0, 0x3FFF), st.binary(max_size=12)), max_size=5), st.data())
def test_frames_and_serial_bytes_come_whole_however_the_stream_is_cut(items, data):
    stream = b"".join(frame(item) if isinstance(item, int) else serial(item) for item in items)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    finder, found = StreamFinder(), []
    for begins, ends in pairwise([0, *cuts, len(stream)]):
        found += finder.feed(stream[begins:ends])
    assert [int(one[0, 0]) for one in found] == [item for item in items if isinstance(item, int)]
    assert bytes(finder.serial) == b"".join(item for item in items if isinstance(item, bytes))
    assert finder.damaged == 0


@settings(deadline=None, max_examples=80)
@given(
    st.lists(st.sampled_from(["good", "cut", "hole", "mark", "length"]), min_size=1, max_size=6),
    st.integers(8, 18_000),
)
def test_every_damaged_frame_is_counted_and_no_other_is_lost(kinds, number):
    sent, good = [frame(0)], [0]
    for value, kind in enumerate([*kinds, "good"], start=1):
        whole = frame(value)
        middle = 8 + number // 2 * 2
        sent.append(
            {
                "good": whole,
                "cut": whole[: len(whole) - 600 - number],
                "hole": whole[:middle] + whole[middle + 2 * 700 :],
                "mark": b"TEAK" + whole[4:],
                "length": whole[:4] + b"\xff\xff\xff\xff" + whole[8:],
            }[kind]
        )
        if kind == "good":
            good.append(value)
    finder = StreamFinder()
    found = [int(one[0, 0]) for piece in sent for one in finder.feed(piece)]
    assert found == good
    assert finder.damaged >= len(sent) - len(good)
    # A frame without its length is noticed at its mark, and again as a stretch of noise.
    assert finder.damaged <= len(sent) - len(good) + kinds.count("length")


@settings(deadline=None)
@given(st.lists(st.binary(max_size=400) | st.sampled_from([b"TEAX", b"UART", b"TEAX\x00\xa0"]), max_size=20))
def test_no_bytes_break_the_finder(pieces):
    finder = StreamFinder()
    for piece in pieces:
        finder.feed(piece)
        finder.serial.clear()
    # It finds its way back: a frame that was begun by chance ends at the mark of the next one.
    assert [int(one[0, 0]) for one in finder.feed(frame(7) + frame(8))][-1] == 8


def test_serial_bytes_after_noise_are_kept():
    finder = StreamFinder()
    noise = b"TEAK" + frame(1)[4:]
    found = finder.feed(frame(0) + noise + noise + serial(b"abc") + noise + frame(2))
    assert [int(one[0, 0]) for one in found] == [0, 2]
    assert (bytes(finder.serial), finder.damaged) == (b"abc", 3)


def test_memory_is_bounded_by_the_largest_frame():
    finder = StreamFinder()
    finder.feed(b"TEAX" + struct.pack("<I", 383_999))
    for _ in range(60):
        finder.feed(b"\xff" * 20_000)
        assert len(finder._bytes) <= 8 + 2 * 384_000
