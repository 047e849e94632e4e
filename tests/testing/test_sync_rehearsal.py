"""Synchronisation rehearsed: a Pulse Pal, two Bosons as slaves, a LabJack on the line, and what the run says of it.

The devices are emulated, with faults and clocks that are known; time is virtual.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest

from thermacq.acquisition import record
from thermacq.cli.recording import sync_lines
from thermacq.evaluation.probes import probe_record
from thermacq.plugins import plugins
from thermacq.reconstruction.pairs import run_pairs
from thermacq.rig import load_rig
from thermacq.rig.rehearsal import emulated_devices
from thermacq.store import open_run, trigger_line

EXAMPLE = Path(__file__).parents[2] / "examples" / "rigs" / "rehearsal.toml"
SECONDS, RATE_HZ = 10.0, 50
PULSES = int(SECONDS * RATE_HZ)
LOST_PULSES = (100, 101, 350)
PROBE_PPM, BOX_PPM = 50.0, -20.0
# The box starts with its first cycle of 50 us, in which virtual time begins.
TRUE_NS = 50_000 + np.arange(PULSES) * 20e6 / (1 + BOX_PPM * 1e-6)

COMMON = f"""
[clock]
kind = "virtual"
[trigger]
mode = "hardware"
source = "box"
frame_rate_hz = {RATE_HZ}
[store]
reserve_mb = 1
[trigger_sources.box]
driver = "pulse_pal"
[trigger_sources.box.settings]
pulse_width_s = 0.005
[probes.gauge]
driver = "labjack_u6"
[probes.gauge.settings]
rate_hz = 997
line = 2
[emulation.box]
clock_ppm = {BOX_PPM}
pulse_faults = [{{ kind = "drop", at = 100, items = 2 }}, {{ kind = "drop", at = 350 }}]
[emulation.gauge]
clock_ppm = {PROBE_PPM}
line = "trigger"
line_input = 2
faults = [{{ kind = "drop", at = 200, items = 3 }}]
"""
BOSONS = """
[cameras.left]
driver = "boson"
[cameras.right]
driver = "boson"
[emulation.left]
size = "320"
clock_ppm = 12
faults = [{ kind = "drop", at = 150, items = 3 }]
[emulation.right]
size = "320"
clock_ppm = -8
counter_start = 4294967200
faults = [{ kind = "drop", at = 225 }]
"""
PATTERNS = """
[cameras.left]
driver = "test-pattern"
settings = { rows = 48, columns = 64, lose_every = 90 }
[cameras.right]
driver = "test-pattern"
settings = { rows = 48, columns = 64, counter_bits = 8, counter_start = 250 }
"""


def rehearse(folder, rig):
    (folder / "rig.toml").write_text(COMMON + rig)
    # The path of a socket may have 107 bytes; pytest's folders are long.
    short = tempfile.mkdtemp(prefix="tq-")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", short)
        result = record(folder / "rig.toml", folder / "run.h5", duration_s=SECONDS, emulate=True)
    shutil.rmtree(short)
    assert result.asked_for
    return folder / "run.h5"


@pytest.fixture(scope="module")
def bosons(tmp_path_factory):
    with open_run(rehearse(tmp_path_factory.mktemp("bosons"), BOSONS)) as run:
        yield run


@pytest.fixture(scope="module")
def patterns(tmp_path_factory):
    with open_run(rehearse(tmp_path_factory.mktemp("patterns"), PATTERNS)) as run:
        yield run


def lost_exposures(run, camera):
    """Pulses whose frame the emulated camera threw away, by the times at which it did so."""
    thrown = [
        event.host_ns
        for event in run.events()
        if event.device == camera and event.detail == "emulator acted out: drop"
    ]
    return [int(np.argmin(np.abs(TRUE_NS - moment))) for moment in thrown]


def with_frame(lost_frames):
    """Pulses of which a camera delivered a frame."""
    return np.setdiff1d(np.arange(PULSES), [*LOST_PULSES, *lost_frames])


@pytest.mark.slow
def test_every_frame_of_the_slaves_finds_its_pulse(bosons):
    line = trigger_line(bosons)
    for camera, count in (("left", 3), ("right", 1)):
        lost = lost_exposures(bosons, camera)
        assert len(lost) == count
        frames = line.frames[camera]
        np.testing.assert_array_equal(frames.trigger_index, with_frame(lost))
        # A fifth of a scan of the probe, which is 1 ms.
        assert np.abs(frames.trigger_ns - TRUE_NS[with_frame(lost)]).max() < 200_000
        # The camera itself knows no trigger.
        assert set(bosons.frames(camera).trigger_index) == {-1}
    assert (np.diff(bosons.frames("right").counter) < 0).sum() == 1, "its counter wrapped"


@pytest.mark.slow
def test_pairs_are_frames_of_the_same_pulse(bosons):
    pairs = run_pairs(bosons)
    both = np.intersect1d(
        with_frame(lost_exposures(bosons, "left")), with_frame(lost_exposures(bosons, "right"))
    )
    assert len(pairs) == both.size == 493
    np.testing.assert_allclose(pairs.time_s, TRUE_NS[both] / 1e9, atol=2e-4)
    # Exposures of a pair began in the same virtual instant: both were received as soon as they were made.
    left, right = bosons.frames("left").host_ns[pairs.left], bosons.frames("right").host_ns[pairs.right]
    assert np.abs(left - right).max() < 1_000_000


@pytest.mark.slow
def test_the_report_tells_lost_pulses_from_lost_frames_and_the_drift_of_the_probe(bosons):
    sync = bosons.summary()["sync"]
    line = sync["line"]
    assert (line["lost_pulses"], line["lost_pulse_indices"]) == (3, list(LOST_PULSES))
    # Three packets of the probe were lost, 37.5 scans in which one or two pulses came.
    assert line["stamped"] + line["not_stamped"] == PULSES - 3
    assert line["not_stamped"] in (1, 2)
    told = {name: (one["lost"], one["overlooked"], one["extra"]) for name, one in line["cameras"].items()}
    assert told == {"left": (3, 0, 0), "right": (1, 0, 0)}
    assert line["emitted"] == PULSES
    assert sync["devices"]["left"]["lost"] == {"device_gap": 3}
    assert sync["devices"]["right"]["lost"] == {"device_gap": 1}
    assert sync["clocks"]["gauge"]["drift_ppm"] == pytest.approx(PROBE_PPM, abs=2)
    assert line["period_ns"] == pytest.approx(20e6 / (1 + BOX_PPM * 1e-6), rel=10e-6)
    words = "\n".join(sync_lines(sync))
    assert "lost on the line 3 (100, 101, 350)" in words
    assert "frames lost 3, pulses not followed 0" in words


@pytest.mark.slow
def test_the_probe_is_on_the_time_of_the_cameras(bosons):
    record_ = probe_record(bosons, "gauge")
    assert record_.clock.drift_ppm == pytest.approx(PROBE_PPM, abs=2)
    # Its sine of 0.5 Hz runs by its own clock from virtual time 0.
    own_s = record_.time_s * (1 + PROBE_PPM * 1e-6)
    np.testing.assert_allclose(record_.eta_m, np.sin(np.pi * own_s), atol=0.02)
    assert record_.lost_samples == bosons.summary()["sync"]["devices"]["gauge"]["lost"]["probe_gap"]


@pytest.mark.slow
def test_reckoned_triggers_go_wrong_with_each_lost_pulse_and_the_line_mends_them(patterns):
    """These cameras count pulses, so that what was recorded with them is their own count."""
    emitted = with_frame([])
    frames = patterns.frames("right")
    np.testing.assert_array_equal(frames.trigger_index, np.arange(emitted.size))
    reckoned_off_ns = TRUE_NS[emitted] - frames.trigger_ns
    assert reckoned_off_ns.max() > 59_000_000, "three periods after three lost pulses"
    line = trigger_line(patterns)
    np.testing.assert_array_equal(line.frames["right"].trigger_index, emitted)
    assert np.abs(line.frames["right"].trigger_ns - TRUE_NS[emitted]).max() < 200_000
    left_lost = emitted[89::90]
    np.testing.assert_array_equal(line.frames["left"].trigger_index, with_frame(left_lost))
    cameras = patterns.summary()["sync"]["line"]["cameras"]
    assert (cameras["left"]["lost"], cameras["right"]["lost"]) == (left_lost.size, 0)
    assert len(run_pairs(patterns)) == emitted.size - left_lost.size


def test_the_example_rig_is_that_of_the_how_to():
    rig = load_rig(EXAMPLE)
    assert set(emulated_devices(rig, plugins())) == {"left", "right", "gauge", "box"}
