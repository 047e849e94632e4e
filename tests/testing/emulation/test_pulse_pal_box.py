"""The emulated Pulse Pal by itself: its answers to the worked bytes, and to any bytes at all."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from thermacq.hooks import Emulation
from thermacq.testing.emulators.pulse_pal import PulsePalBox, PulsePalEmulation
from thermacq.timing.clock import VirtualClock
from thermacq.timing.trigger_line import LineReader


@pytest.fixture
def box(tmp_path):
    def make(**told):
        told = {"lines": ["trigger"], **told}
        return PulsePalBox(Emulation("box", VirtualClock(), tmp_path), PulsePalEmulation(**told))

    return make


def say(box, text):
    return [answer.hex() for answer in box.receive(bytes.fromhex(text))]


@pytest.mark.parametrize(
    ("command", "answers"),
    [
        ("D5 48", ["4b15000000"]),
        ("D5 4A 02 01 00 C0", ["01"]),
        ("D5 4A 04 01 14 00 00 00", ["01"]),
        ("D5 4A 0A 01 80 4F 12 00", ["01"]),
        ("D5 4A 80 01 02", ["01"]),
        ("D5 4D 03", []),
        ("D5 50", []),
        ("D5 51", []),
        ("D5 52 01 01", ["01"]),
        ("D5 4F 01 00 C0", ["01"]),
        ("D5 59 54 48 52 41 43 51", []),
        ("D5 4E 02 41 42", []),
        ("D5 4B 01 00 00 00 0A 00 00 00 00 C0", ["01"]),
        ("D5 49" + "00" * 178, ["01"]),
    ],
)
def test_each_command_is_answered_as_the_protocol_says_and_taken_whole(box, command, answers):
    it = box()
    assert say(it, command) == answers
    assert say(it, "D5 48") == ["4b15000000"]


def test_commands_may_come_in_pieces_among_foreign_bytes(box):
    it = box()
    assert say(it, "00 41 D5") == []
    assert say(it, "4A 04 01 14 00") == []
    assert say(it, "00 00 FF D5 48") == ["01", "4b15000000"]


def test_a_whole_programme_is_laid_out_parameter_by_parameter(box):
    it = box()
    times = [100 * parameter + channel for parameter in range(8) for channel in range(4)]
    volts = [0xFFFF] * 4 + [0x0000] * 4 + [0x8000] * 4
    it.receive(b"\xd5\x49" + struct.pack("<32I12H16B8B2B", *times, *volts, *[0, 1, 0, 0], *[0] * 22))
    assert it.outputs[2].times["phase1"] == 2
    assert it.outputs[3].times["interpulse"] == 303
    assert it.outputs[0].volts == {"phase1": 10.0, "phase2": -10.0, "rest": pytest.approx(0, abs=1e-3)}
    assert [output.biphasic for output in it.outputs] == [False, True, False, False]


def test_pulses_lie_on_the_grid_of_its_own_clock(box, tmp_path):
    it = box(clock_ppm=100.0)
    reader = LineReader(tmp_path, "trigger")
    clock = it._host
    say(it, "D5 4A 04 01 14 00 00 00 D5 4A 07 01 7C 01 00 00 D5 4A 0A 01 40 1F 00 00 D5 4D 01")
    while (due_ns := it.due_ns()) is not None:
        clock.wait_until_ns(due_ns)
        it.act()
    times = [reader.take()[1] for _ in range(reader.waiting)]
    # 8000 cycles of train, 400 from pulse to pulse.
    assert len(times) == 20
    assert times[-1] - times[0] == pytest.approx(19 * 20_000_000 / 1.0001, abs=2)
    assert reader.finished
    reader.close()


def test_lost_late_and_doubled_pulses(box, tmp_path):
    it = box(
        pulse_faults=[
            {"kind": "drop", "at": 1},
            {"kind": "slow", "at": 2, "seconds": 0.003},
            {"kind": "duplicate", "at": 3, "seconds": 0.001},
        ]
    )
    reader = LineReader(tmp_path, "trigger")
    say(it, "D5 4A 04 01 14 00 00 00 D5 4A 07 01 B4 00 00 00 D5 4A 0A 01 00 05 00 00 D5 4D 01")
    it._host.wait_until_ns(1_000_000_000)
    it.act()
    times = [reader.take()[1] for _ in range(reader.waiting)]
    assert [round((time_ns - times[0]) / 1e6) for time_ns in times] == [0, 23, 30, 31, 40, 50, 60]
    reader.close()


@settings(max_examples=200)
@given(st.lists(st.binary(max_size=40) | st.just(b"\xd5J") | st.just(b"\xd5M\x0f"), max_size=8))
def test_no_bytes_crash_it_and_a_handshake_is_answered_after_them(pieces):
    clock = VirtualClock()
    it = PulsePalBox(Emulation("box", clock, Path()), PulsePalEmulation(lines=("",)))
    for piece in pieces:
        it.receive(piece)
        clock.wait_until_ns(clock.now_ns() + 1_000_000)
        it.act()
    # Custom trains announce their own length, any other command is over after 300 bytes.
    said = b"".join(pieces)
    assume(b"\xd5K" not in said and b"\xd5L" not in said)
    it.receive(bytes(300))
    assert it.receive(b"\xd5H") == [b"K\x15\x00\x00\x00"]
