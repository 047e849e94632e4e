"""Pulses on the line and the frames that they made: against a truth with losses of every kind."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq.timing import CameraEvidence, LineFrames, follow_line

PERIOD_NS = 20_000_000
# 997 Hz: no multiple of the rate of the pulses, so that they fall on all phases of a scan.
SCAN_NS = 1_003_009
# The probe began to sample before the first pulse.
BEFORE_NS = -500_000_000


def truth(count=1000, drift=30e-6, start_ns=5_000_000):
    """True host times of pulses of a box whose clock is off."""
    return start_ns + np.rint(np.arange(count) * PERIOD_NS * (1 + drift)).astype(np.int64)


def stamped(pulses_ns, keep):
    """What a probe says of the pulses that it saw: seen at a scan, on average half a scan late, corrected."""
    return (pulses_ns[keep] // SCAN_NS) * SCAN_NS + SCAN_NS // 2


def camera(pulses_ns, exposed, kept, delay_ns=12_000_000, jitter_ns=500_000, seed=0):
    """A camera that exposed at some pulses and delivered some of its frames."""
    rng = np.random.default_rng(seed)
    sequence = np.cumsum(exposed) - 1 + 65_500
    delivered = exposed & kept
    host_ns = pulses_ns[delivered] + delay_ns + rng.integers(-jitter_ns, jitter_ns, delivered.sum())
    unknown = np.full(host_ns.size, -1, np.int64)
    return CameraEvidence(LineFrames(unknown, unknown, unknown, host_ns), None, sequence[delivered])


def without(count, places):
    keep = np.ones(count, bool)
    keep[list(places)] = False
    return keep


@pytest.mark.parametrize("delay_ms", [0.5, 10.0, 19.5, 35.0])
def test_losses_of_every_kind_are_told_apart(delay_ms):
    count = 1000
    pulses = truth(count)
    emitted = without(count, [100, 101, 500])
    seen_by_probe = emitted & without(count, [300, 301, 302])
    left = camera(pulses, emitted, without(count, [200, 700]), round(delay_ms * 1e6))
    right = camera(pulses, emitted & without(count, [400]), without(count, [200, 999]), 17_000_000, seed=1)
    line = follow_line(
        stamped(pulses, seen_by_probe), PERIOD_NS, SCAN_NS, {"left": left, "right": right}, BEFORE_NS
    )
    figures = line.figures
    assert (figures["lost_pulses"], figures["lost_pulse_indices"]) == (3, [100, 101, 500])
    assert (figures["stamped"], figures["not_stamped"], figures["extra_pulses"]) == (994, 3, 0)
    told = {name: (one["lost"], one["overlooked"]) for name, one in figures["cameras"].items()}
    assert told == {"left": (2, 0), "right": (2, 1)}
    # The grid is finer than the probe's scans.
    for name, delivered in (
        ("left", emitted & without(count, [200, 700])),
        ("right", emitted & without(count, [200, 400, 999])),
    ):
        frames = line.frames[name]
        np.testing.assert_array_equal(frames.trigger_index, np.flatnonzero(delivered))
        assert np.abs(frames.trigger_ns - pulses[delivered]).max() < 150_000


def test_late_and_additional_pulses_keep_their_own_times():
    pulses = truth(200, drift=0.0)
    pulses[50] += 6_000_000
    all_pulses = np.sort(np.append(pulses, pulses[120] + 10_500_000))
    left = camera(all_pulses, np.ones(201, bool), np.ones(201, bool), jitter_ns=10_000)
    line = follow_line(stamped(all_pulses, slice(None)), PERIOD_NS, SCAN_NS, {"left": left}, BEFORE_NS)
    frames = line.frames["left"]
    assert (line.figures["extra_pulses"], line.figures["cameras"]["left"]["extra"]) == (1, 1)
    assert np.flatnonzero(frames.trigger_index < 0).tolist() == [121]
    assert abs(frames.trigger_ns[50] - pulses[50]) <= SCAN_NS // 2
    assert frames.trigger_index.max() == 199


@given(
    st.sets(st.integers(1, 298), max_size=20),
    st.sets(st.integers(1, 298), max_size=20),
    st.integers(0, 40_000_000),
    st.floats(-200e-6, 200e-6),
)
def test_every_frame_finds_its_pulse(no_pulse, no_frame, delay_ns, drift):
    pulses = truth(300, drift)
    emitted = without(300, no_pulse)
    left = camera(pulses, emitted, without(300, no_frame), delay_ns)
    line = follow_line(stamped(pulses, emitted), PERIOD_NS, SCAN_NS, {"left": left}, BEFORE_NS)
    assert line.figures["lost_pulses"] == len(no_pulse)
    assert line.figures["cameras"]["left"]["lost"] == len(no_frame - no_pulse)
    np.testing.assert_array_equal(
        line.frames["left"].trigger_index, np.flatnonzero(emitted & without(300, no_frame))
    )


def test_two_hours_with_a_clock_100_ppm_off():
    count = 360_000
    pulses = truth(count, 100e-6)
    keep = without(count, range(7, count, 911))
    left = camera(pulses, keep, np.ones(count, bool))
    line = follow_line(stamped(pulses, keep), PERIOD_NS, SCAN_NS, {"left": left}, BEFORE_NS)
    np.testing.assert_array_equal(line.frames["left"].trigger_index, np.flatnonzero(keep))
    assert line.figures["period_ns"] == pytest.approx(PERIOD_NS * (1 + 100e-6), rel=1e-9)


def test_a_probe_that_began_late_leaves_the_shortest_delay():
    pulses = truth(400)
    left = camera(pulses, np.ones(400, bool), without(400, range(395, 400)), 4_000_000)
    line = follow_line(stamped(pulses, slice(20, None)), PERIOD_NS, SCAN_NS, {"left": left}, int(pulses[19]))
    frames = line.frames["left"]
    assert np.abs(frames.trigger_ns - pulses[:395]).max() < 300_000
    figures = line.figures
    assert (figures["not_stamped"], figures["cameras"]["left"]["lost"]) == (20, 5)
    assert figures["cameras"]["left"]["delay_ns"] == pytest.approx(4e6, abs=3e5)
    assert figures["cameras"]["left"]["placed_by"] == "shortest delay"


def test_a_first_frame_that_was_lost_is_seen_by_the_gaps():
    pulses = truth(400)
    emitted = without(400, [50, 200, 201])
    left = camera(pulses, emitted, without(400, [0, 120]), 30_000_000)
    line = follow_line(stamped(pulses, emitted), PERIOD_NS, SCAN_NS, {"left": left}, BEFORE_NS)
    assert line.figures["cameras"]["left"]["placed_by"] == "gaps"
    np.testing.assert_array_equal(
        line.frames["left"].trigger_index, np.flatnonzero(emitted & without(400, [0, 120]))
    )


def test_a_lost_frame_beside_a_pulse_that_the_probe_missed_is_no_lost_pulse():
    pulses = truth(400)
    left = camera(pulses, np.ones(400, bool), without(400, [150]), 25_000_000)
    line = follow_line(stamped(pulses, without(400, [151])), PERIOD_NS, SCAN_NS, {"left": left}, BEFORE_NS)
    assert line.figures["lost_pulses"] == 0
    np.testing.assert_array_equal(line.frames["left"].trigger_index, np.flatnonzero(without(400, [150])))


def test_too_few_pulses_say_nothing():
    assert follow_line(np.array([1, 2]), PERIOD_NS, SCAN_NS, {}) is None
    alone = follow_line(truth(5), PERIOD_NS, SCAN_NS, {})
    assert alone.frames == {}
    assert alone.figures["stamped"] == 5
