"""Whole recordings in which cables are pulled and put back: real processes, emulated and simulated devices."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thermacq.acquisition import EndReason, record
from thermacq.acquisition.control import Status
from thermacq.cli.recording import sync_lines
from thermacq.errors import AcquisitionError
from thermacq.evaluation.probes import probe_clock
from thermacq.reconstruction.pairs import run_pairs
from thermacq.rig import parse_rig
from thermacq.store import RunFile, open_run, recover, verify
from thermacq_drivers.testpattern import check_pattern

pytestmark = pytest.mark.slow

BOX_AND_PROBE = """
trigger = { mode = "hardware", source = "box", frame_rate_hz = 20 }
store = { reserve_mb = 1 }
[reconnect]
give_up_after_s = %s
[cameras.left]
driver = "test-pattern"
settings = { rows = 16, columns = 64 }
[cameras.right]
driver = "test-pattern"
settings = { rows = 16, columns = 64 }
[trigger_sources.box]
driver = "pulse_pal"
[probes.wp]
driver = "serial_ascii"
settings = { timeout_s = 1.0 }
[emulation.box]
pulse_faults = [{ kind = "disconnect", at = 20, seconds = %s }]
[emulation.wp]
rate_hz = 20
faults = [{ kind = "disconnect", at_s = 2.0, seconds = 0.5 }]
"""
LOST_PROBE = """
[probes.lost]
driver = "serial_ascii"
[probes.lost.reconnect]
give_up_after_s = 0.3
[emulation.lost]
rate_hz = 20
faults = [{ kind = "disconnect", at_s = 2.0 }]
"""
SEEKS = """
trigger = { mode = "free_run", frame_rate_hz = 9 }
store = { reserve_mb = 1 }
[cameras.left]
driver = "seek"
serial = "SEEK00000001"
[cameras.right]
driver = "seek"
serial = "SEEK00000002"
[emulation.left]
faults = [{ kind = "disconnect", at = 15, seconds = 1.0 }]
"""


def told(run: RunFile, device: str) -> list[str]:
    return [event.kind.value for event in run.events() if event.device == device]


def lost(result: Any, device: str) -> dict[str, int]:
    return result.summary["sync"]["devices"][device]["lost"]


def test_a_camera_that_was_unplugged_goes_on_in_the_same_file(make_rig, tmp_path: Path) -> None:
    states: list[str] = []

    def watch(status: Status) -> None:
        states.append(status["devices"].get("left", {}).get("state", ""))

    rig = make_rig({"fail_at_frame": 30, "replug_after_s": 0.6})
    result = record(rig, tmp_path / "run.h5", frames=100, on_status=watch)
    assert result.end_reason == EndReason.COMPLETED
    assert "reconnecting" in states
    assert any("'left' was away for" in warning for warning in result.warnings)
    missed = lost(result, "left")["disconnected"]
    assert 30 <= missed <= 60
    with open_run(result.path) as run:
        left, right = run.frames("left"), run.frames("right")
        assert len(left) + missed + lost(result, "left").get("late_trigger", 0) == 100
        assert len(right) + lost(result, "right").get("late_trigger", 0) == 100
        assert lost(result, "right").get("disconnected", 0) == 0
        assert told(run, "left").count("disconnected") == told(run, "left").count("reconnected") == 1
        assert told(run, "right").count("disconnected") == 0
        # Each picture is that of its row: the camera counts from 0 again after its return.
        first = int(np.flatnonzero(left.host_ns == left.restarts_ns[0])[0])
        numbers = [check_pattern(run.counts("left", row)) for row in range(len(left))]
        assert numbers == [*range(first), *range(len(left) - first)]
        assert np.array_equal(np.diff(left.sequence_number), np.ones(len(left) - 1))
        deadlines = run.header.host_anchor_ns + left.trigger_index * 20_000_000
        assert np.all((left.trigger_ns >= deadlines) & (left.trigger_ns <= deadlines + 1_000_000))
        pairs = run_pairs(run)
        assert np.array_equal(left.trigger_index[pairs.left], right.trigger_index[pairs.right])
        assert len(pairs) == np.intersect1d(left.trigger_index, right.trigger_index).size
    (outage,) = result.summary["sync"]["outages"]
    assert outage["missed"] == missed
    assert outage["came_back"]
    assert outage["changed"] == {}
    assert any(line.startswith("away         left: from 0.") for line in sync_lines(result.summary["sync"]))
    assert verify(result.path).findings == []
    recover(result.path, tmp_path / "clean.h5")
    assert verify(tmp_path / "clean.h5").findings == []


def test_another_camera_in_its_place_is_refused_and_the_run_ends(make_rig, tmp_path: Path) -> None:
    exchanged = {"fail_at_frame": 20, "replug_after_s": 0.2, "replug_serial": "TP-right"}
    rig = make_rig(exchanged, reconnect={"give_up_after_s": 1.0}, trigger={"mode": "free_run"})
    result = record(rig, tmp_path / "run.h5")
    assert result.end_reason == EndReason.CAMERA_LOST
    assert "serial number 'TP-right', not 'TP-left'" in result.message
    with open_run(result.path) as run:
        assert run.complete
        assert run.frame_count("left") == 20
        assert run.frame_count("right") > 50
        assert run.frames("left").restarts_ns.size == 0
    assert verify(result.path).findings == []


def test_box_and_probe_come_back_and_a_lost_probe_is_told(tmp_path: Path) -> None:
    rig = parse_rig(BOX_AND_PROBE % (10, 0.6) + LOST_PROBE)
    result = record(rig, tmp_path / "run.h5", duration_s=5.0, emulate=True)
    assert result.end_reason == EndReason.COMPLETED
    assert any("'lost' (reconnect): did not come back within 0.3 s" in text for text in result.warnings)
    with open_run(result.path) as run:
        left, right = run.frames("left"), run.frames("right")
        missed = lost(result, "box")["disconnected"]
        assert 12 <= missed <= 30
        for frames in (left, right):
            assert len(np.unique(frames.trigger_index)) == len(frames)
            # The box may believe in one pulse that it did not emit any more.
            assert 100 - missed - 1 <= len(frames) <= 100 - missed
            assert frames.restarts_ns.size == 0
        assert np.array_equal(left.trigger_index, right.trigger_index)
        assert np.all(left.trigger_ns > 0)
        assert np.max(np.abs(left.trigger_ns - left.host_ns)) < 0.2e9
        assert told(run, "box")[0] == told(run, "wp")[0] == "disconnected"
        assert told(run, "lost").count("disconnected") == 2  # gone, and given up
        assert len(run.probe("lost")) > 0
        assert told(run, "box").count("reconnected") == told(run, "wp").count("reconnected") == 1
        samples = run.probe("wp")
        assert np.array_equal(np.diff(samples.index), np.ones(len(samples) - 1))
        (back_ns,) = samples.restarts_ns
        # Without a clock of its own its times come from its count, which knows nothing of the gap.
        times_ns = probe_clock(samples, left.trigger_ns).times_of(samples.index, samples.host_ns)
        late_ns = (samples.host_ns - times_ns)[20:]  # the first ones were printed before the start
        assert np.max(np.abs(late_ns)) < 0.3e9
        row = int(np.searchsorted(samples.host_ns, back_ns))
        assert times_ns[row] - times_ns[row - 1] > 0.4e9
    assert verify(result.path).findings == []


def test_a_box_that_is_lost_for_good_ends_the_run(tmp_path: Path) -> None:
    rig = parse_rig(BOX_AND_PROBE % (1.5, 0))
    result = record(rig, tmp_path / "run.h5", duration_s=60.0, emulate=True)
    assert result.end_reason == EndReason.TRIGGER_LOST
    assert "did not come back within 1.5 s" in result.message
    with open_run(result.path) as run:
        assert run.complete
        assert run.frame_count("left") == run.frame_count("right") == 20
        assert told(run, "wp").count("reconnected") == 1
    assert verify(result.path).findings == []


def test_an_emulated_usb_camera_comes_back(tmp_path: Path) -> None:
    result = record(parse_rig(SEEKS), tmp_path / "run.h5", duration_s=5.0, emulate=True)
    assert result.end_reason == EndReason.COMPLETED
    with open_run(result.path) as run:
        left, right = run.frames("left"), run.frames("right")
        missed = lost(result, "left")["disconnected"]
        assert missed >= 8
        assert len(left) + missed == pytest.approx(45, abs=3)
        assert len(right) == pytest.approx(45, abs=3)
        assert left.restarts_ns.size == 1
        assert {event.kind.value for event in run.events() if event.device == "left"} >= {
            "disconnected",
            "reconnected",
        }
    assert verify(result.path).findings == []


def test_device_wins_needs_a_driver_that_can_ask(tmp_path: Path) -> None:
    text = BOX_AND_PROBE % (1, 0)
    rig = parse_rig(text.replace("[reconnect]", '[reconnect]\npolicy = "device_wins"'))
    with pytest.raises(AcquisitionError, match="'device_wins' needs"):
        record(rig, tmp_path / "run.h5", duration_s=3.0, emulate=True)
    assert not (tmp_path / "run.h5").exists()
