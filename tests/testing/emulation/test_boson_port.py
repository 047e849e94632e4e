"""The emulated Boson's serial port by itself: its answers to the worked bytes, and to any bytes at all."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.hooks import Emulation
from thermacq.testing.emulators.boson import BosonCore, BosonEmulation
from thermacq.testing.emulators.boson_fslp import FslpPort, checksum
from thermacq.timing.clock import VirtualClock


def port(**settings):
    told = BosonEmulation(**{"serial": "276926", **settings})
    return FslpPort(BosonCore(Emulation("left", VirtualClock(), Path()), told))


WORKED = [
    ({}, "8E 00 00000001 00050007 FFFFFFFF 225C AE", "8E 00 00000001 00050007 00000000 BB93 AE"),
    ({}, "8E 00 00000002 00050002 FFFFFFFF 2C4F AE", "8E 00 00000002 00050002 00000000 000439BE 5316 AE"),
    ({}, "8E 00 00000003 00050030 FFFFFFFF 8F01 AE", "8E 00 00000003 00050030 00000000 013A 357F AE"),
    (
        {"fpa_celsius": -5.0},
        "8E 00 00000003 00050030 FFFFFFFF 8F01 AE",
        "8E 00 00000003 00050030 00000000 FFCE AA2A AE",
    ),
]


@pytest.mark.parametrize(("settings", "request_", "reply"), WORKED)
def test_worked_answers(settings, request_, reply):
    assert port(**settings).receive(bytes.fromhex(request_)) == [bytes.fromhex(reply)]


def test_the_checksum_of_the_digits():
    assert checksum(b"123456789") == 0xE5CC


def test_what_is_set_shows_in_the_core():
    it = port()
    slave = "8E 00 00000005 00050098 FFFFFFFF 00000002 A07E AE"
    telemetry = "8E 00 00000006 00040001 FFFFFFFF 00000001 A961 AE"
    top = "8E 00 00000007 00040003 FFFFFFFF 00000000 3A44 AE"
    manual = "8E 00 00000004 00050012 FFFFFFFF 00000000 9575 AE"
    assert len(it.receive(bytes.fromhex(slave + telemetry + top + manual))) == 4
    core = it._core
    assert (core.sync, core.telemetry_on, core.telemetry_location, core.ffc_mode) == (2, 1, 0, 0)
    it.power_up()
    assert (core.sync, core.telemetry_on, core.ffc_mode) == (0, False, 1)


def test_a_camera_without_telemetry_refuses_it():
    (reply,) = port(telemetry="none").receive(
        bytes.fromhex("8E 00 00000006 00040001 FFFFFFFF 00000001 A961 AE")
    )
    assert reply[10:14] == bytes.fromhex("000001B0")


@given(st.lists(st.binary(max_size=80), max_size=6))
def test_no_bytes_crash_it_and_it_answers_after_them(pieces):
    it = port()
    for piece in pieces:
        it.receive(piece)
    it.receive(b"\xae")
    ((_, asked, reply),) = WORKED[1:2]
    assert it.receive(bytes.fromhex(asked)) == [bytes.fromhex(reply)]
