import os

import pytest

from thermacq.acquisition import priority


def test_priority_is_raised_for_the_block_only() -> None:
    raised = priority.TriggerPriority()
    before = os.sched_getscheduler(0)
    with raised.raised():
        assert os.sched_getscheduler(0) == (os.SCHED_FIFO if raised.name == "fifo" else before)
    assert os.sched_getscheduler(0) == before == os.SCHED_OTHER


def test_without_permission_nothing_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "setpriority", refuse)
    plain = priority.TriggerPriority()
    assert plain.name == "normal"
    with plain.raised():
        pass


def test_cores_are_handed_out_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {2, 5, 7})
    assert [priority.core_for(place) for place in range(4)] == [2, 5, 7, 2]
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    assert priority.core_for(0) is None


def test_a_core_that_is_not_there_is_not_pinned() -> None:
    assert not priority.pin(None)
    assert not priority.pin(100_000)
