"""The schedule of faults: when they strike, how often, and the record of it."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from thermacq.testing.emulation.faults import FaultKind, FaultSchedule, FaultSettings, damaged
from thermacq.timing.clock import VirtualClock


def schedule(*faults, clock=None, log=None):
    return FaultSchedule([FaultSettings(**fault) for fault in faults], clock or VirtualClock(), log)


@given(at=st.integers(0, 50), items=st.integers(1, 10))
def test_a_fault_strikes_as_many_consecutive_items_as_it_says(at, items):
    faults = schedule({"kind": "drop", "at": at, "items": items})
    struck = [item for item in range(80) if faults.strike(item)]
    assert struck == list(range(at, at + items))
    assert faults.injected == {FaultKind.DROP: items}


def test_a_fault_at_a_time_strikes_the_first_item_after_it():
    clock = VirtualClock()
    faults = schedule({"kind": "slow", "at_s": 0.25, "seconds": 1.0}, clock=clock)
    struck = []
    for item in range(10):
        clock.wait_until_ns(item * 100_000_000)
        struck += [item for _ in faults.strike(item)]
    assert struck == [3]


def test_parts_of_an_emulator_ask_for_their_kinds_only():
    faults = schedule({"kind": "drop", "at": 1}, {"kind": "slow", "at": 1})
    assert [fault.kind for fault in faults.strike(1, FaultKind.SLOW)] == ["slow"]
    assert [fault.kind for fault in faults.strike(1)] == ["drop"]


def test_every_fault_that_struck_is_written_down(tmp_path):
    log = tmp_path / "faults.jsonl"
    faults = schedule({"kind": "drop", "at": 3, "items": 2}, {"kind": "stall", "at": 4}, log=log)
    for item in range(6):
        faults.strike(item)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert [(line["fault"], line["item"]) for line in lines] == [("drop", 3), ("drop", 4), ("stall", 4)]


@pytest.mark.parametrize("times", [{}, {"at": 1, "at_s": 1.0}])
def test_a_fault_says_when_in_one_way(times):
    with pytest.raises(ValidationError, match="say when it strikes"):
        FaultSettings(kind="drop", **times)


@given(data=st.binary(max_size=50), kind=st.sampled_from(FaultKind), amount=st.integers(1, 60))
def test_damage_is_what_the_kind_says(data, kind, amount):
    arrived = damaged(data, FaultSettings(kind=kind, at=0, amount=amount))
    if kind is FaultKind.GARBAGE:
        assert len(arrived) == amount + len(data)
        assert arrived.endswith(data)
    elif kind is FaultKind.SHORT_READ:
        assert arrived == data[: max(0, len(data) - amount)]
    elif kind is FaultKind.BAD_CRC and data:
        assert arrived != data
        assert len(arrived) == len(data)
