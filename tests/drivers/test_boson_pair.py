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


@pytest.fixture(scope="module")
def rehearsed(tmp_path_factory):
    """Run file of a rehearsal of 3 s with faults, in virtual time."""
    folder = tmp_path_factory.mktemp("bosons")
    # Paths of sockets are short.
    runtime = tempfile.mkdtemp(prefix="tq-")
    (folder / "rig.toml").write_text(RIG.read_text(encoding="utf-8") + FAULTS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", runtime)
        record(folder / "rig.toml", folder / "run.h5", duration_s=3.0, emulate=True)
    shutil.rmtree(runtime)
    with open_run(folder / "run.h5") as run:
        yield run


def pulses_seen(run, camera):
    """Number of the pulse of each frame, which the emulated picture tells."""
    return np.array([frame_number(run.counts(camera, index)) for index in range(len(run.frames(camera)))])


@pytest.mark.slow
def test_pairs_are_right_with_lost_pulses_and_frames_and_a_counter_that_wraps(rehearsed):
    left, right = rehearsed.frames("left"), rehearsed.frames("right")
    models = [fit_clock(frames.ticks, frames.host_ns, 1000.0) for frames in (left, right)]
    pairs = pair_frames(left, right, *models)
    seen_left, seen_right = pulses_seen(rehearsed, "left"), pulses_seen(rehearsed, "right")
    # All that a frame came of on both sides is paired, and nothing else.
    assert pairs.paired_by == "device time"
    shuttered = np.flatnonzero(np.diff(seen_left) == 0) + 1
    open_ = ~np.isin(pairs.left, shuttered)
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
