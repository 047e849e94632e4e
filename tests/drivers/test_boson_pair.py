"""The rig of two Bosons and a Pulse Pal, rehearsed: pairs are right although pulses and frames are lost."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest

from thermacq.acquisition import record
from thermacq.store import open_run
from thermacq.testing.emulation.scene import frame_number
from thermacq.timing import unwrap_counter
from thermacq.timing.models import fit_clock
from thermacq.timing.pairing import pair_frames

RIG = Path(__file__).resolve().parents[2] / "examples" / "rigs" / "two_bosons.toml"
FAULTS = """
[clock]
kind = "virtual"
[store]
reserve_mb = 1
[emulation.box]
pulse_faults = [{ kind = "drop", at = 20 }, { kind = "duplicate", at = 30, seconds = 0.002 }]
[emulation.left]
size = "320"
clock_ppm = 30
counter_start = 4294967250
faults = [
  { kind = "drop", at = 60, items = 3 },
  { kind = "bad_crc", at = 80 },
  { kind = "shutter_freeze", at = 90, seconds = 0.2 },
]
[emulation.right]
size = "320"
clock_ppm = -20
telemetry = "8-bit"
faults = [{ kind = "drop", at = 70 }, { kind = "duplicate", at = 100 }]
"""


CAMERAS = ("left", "right")
GAUGE = """
[probes.gauge]
driver = "labjack_u6"
settings = { rate_hz = 1000, line = 0 }
[emulation.gauge]
clock_ppm = 50
line = "trigger"
"""


def rehearse(folder, text):
    """Run file of a rehearsal of 3 s in virtual time."""
    # Paths of sockets are short.
    runtime = tempfile.mkdtemp(prefix="tq-")
    (folder / "rig.toml").write_text(RIG.read_text(encoding="utf-8") + text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", runtime)
        record(folder / "rig.toml", folder / "run.h5", duration_s=3.0, emulate=True)
    shutil.rmtree(runtime)
    return open_run(folder / "run.h5")


@pytest.fixture(scope="module")
def rehearsed(tmp_path_factory):
    """Two cameras and the box, with faults."""
    with rehearse(tmp_path_factory.mktemp("bosons"), FAULTS) as run:
        yield run


def pulses_seen(run, camera):
    """Number of the pulse of each frame, which the emulated picture tells."""
    return np.array([frame_number(run.counts(camera, index)) for index in range(len(run.frames(camera)))])


def frozen(seen):
    """Frames under the shutter: they show the number of an earlier one."""
    return np.flatnonzero(np.diff(seen) == 0) + 1


@pytest.mark.slow
def test_pairs_are_right_with_lost_pulses_and_frames_and_a_counter_that_wraps(rehearsed):
    left, right = rehearsed.frames("left"), rehearsed.frames("right")
    models = [fit_clock(frames.ticks, frames.host_ns, 1000.0) for frames in (left, right)]
    pairs = pair_frames(left, right, *models)
    seen_left, seen_right = pulses_seen(rehearsed, "left"), pulses_seen(rehearsed, "right")
    # All that a frame came of on both sides is paired, and nothing else.
    assert pairs.paired_by == "device time"
    open_ = ~np.isin(pairs.left, frozen(seen_left))
    np.testing.assert_array_equal(seen_left[pairs.left][open_], seen_right[pairs.right][open_])
    assert (len(left), len(right)) == (145, 148)
    assert (pairs.left.size, pairs.unpaired_left.size, pairs.unpaired_right.size) == (144, 1, 4)


@pytest.mark.slow
def test_what_was_lost_is_in_the_file(rehearsed):
    summary = rehearsed.summary()["sync"]
    left = unwrap_counter(rehearsed.frames("left").counter, 32)
    assert np.sum(np.diff(left) - 1) == 4
    assert rehearsed.frames("left").counter.min() < 2**31 < rehearsed.frames("left").counter.max()
    assert summary["paired_by"] == "device time"
    kinds = [event.kind.value for event in rehearsed.events()]
    assert kinds.count("device_gap") == 2
    assert kinds.count("incomplete") == 2
    assert kinds.count("shutter") == 1


@pytest.mark.slow
def test_with_a_gauge_that_stamps_the_pulses_each_frame_knows_its_own(tmp_path):
    with rehearse(tmp_path, FAULTS + GAUGE) as run:
        sync = run.summary()["sync"]
        models = [fit_clock(run.frames(name).ticks, run.frames(name).host_ns, 1000.0) for name in CAMERAS]
        numbers = [pulses_seen(run, name) for name in CAMERAS]
        frames = [run.frames(name) for name in CAMERAS]
    # The picture tells the number of the pulse on the line, which lacks pulse 20 and has pulse 30 twice.
    left, right = (seen + ((seen >= 20) & (seen < 30)) for seen in numbers)
    assert 20 not in left
    assert 20 not in right
    assert sync["paired_by"] == "trigger index"
    assert sync["line"]["lost_pulse_indices"] == [20]
    assert (sync["pairs"], sync["unpaired"]) == (144, {"left": 1, "right": 4})
    assert {name: sync["line"]["cameras"][name]["lost"] for name in CAMERAS} == {"left": 4, "right": 1}
    pairs = pair_frames(*frames, *models)
    open_ = ~np.isin(pairs.left, frozen(left))
    np.testing.assert_array_equal(left[pairs.left][open_], right[pairs.right][open_])
