from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq_calibration import CalibrationError
from thermacq_calibration.probes.immersion_steps import find_steps, given_steps

RATE_HZ = 100.0


def record(levels, seconds, noise=0.0, move_s=0.3, seed=0):
    """Times and raw values of a probe that stays at levels and moves evenly between them."""
    edges = np.cumsum(np.broadcast_to(seconds, len(levels)))
    time = np.arange(0, edges[-1], 1 / RATE_HZ)
    places, values = [0.0], [levels[0]]
    for edge, before, after in zip(edges, levels, [*levels[1:], levels[-1]], strict=True):
        places += [edge - move_s, edge]
        values += [before, after]
    raw = np.interp(time, places, values)
    return time, raw + noise * np.random.default_rng(seed).standard_normal(time.size)


@settings(deadline=None, max_examples=20)
@given(
    seconds=st.lists(st.floats(3, 8), min_size=5, max_size=5),
    offset=st.floats(-1e3, 1e3),
    gain=st.sampled_from([-30.0, -1.0, 0.5, 20.0]),
    seed=st.integers(0, 99),
)
def test_levels_are_found_whatever_the_offset_sign_and_length_of_steps(seconds, offset, gain, seed):
    depths = np.array([0.0, 0.05, 0.12, 0.2, 0.05])
    true = offset + gain * depths
    noise = 0.01 * abs(gain) * 0.05
    steps = find_steps(*record(true, seconds, noise, seed=seed), depths)
    found = np.array([step.raw for step in steps])
    assert np.abs(found - true).max() < 6 * noise / np.sqrt(0.5 * 3 * RATE_HZ)
    for step, end in zip(steps, np.cumsum(seconds), strict=True):
        assert step.start_s < step.stop_s < end


def test_missing_samples_are_left_out():
    depths = np.array([0.0, 0.1, 0.2])
    time, raw = record(20 * depths, 5.0, 0.01)
    raw[::9] = np.nan
    raw[300:320] = np.nan
    steps = find_steps(time, raw, depths)
    assert [round(step.raw, 1) for step in steps] == [0.0, 2.0, 4.0]


@pytest.mark.parametrize(("swing", "least", "most"), [(0.0, 0.85, 1.35), (0.05, 0.2, 1.35)])
def test_the_uncertainty_of_a_level_holds(swing, least, most):
    """|error| over the standard uncertainty is about one; less, never more, when the water swings."""
    rng, scores = np.random.default_rng(1), []
    for seed in range(60):
        time, raw = record([0.0, 2.0, 4.0], 20.0, 0.01, seed=seed)
        raw += swing * np.sin(2 * np.pi * (time / rng.uniform(2, 6) + rng.uniform()))
        steps = find_steps(time, raw, np.array([0.0, 0.1, 0.2]))
        scores += [(step.raw - true) / step.raw_u for step, true in zip(steps, (0.0, 2.0, 4.0), strict=True)]
    assert least < np.std(scores) < most


@pytest.mark.parametrize(
    ("levels", "noise", "count", "message"),
    [
        ([0.0, 1.0, 2.0], 0.01, 5, "does not hold that many levels|does not stand still"),
        ([0.0, 1.0, 2.0, 3.0, 4.0], 0.01, 3, "does not stand still"),
        ([0.0, 0.001, 0.002], 0.5, 3, "does not hold that many levels|does not stand still"),
        ([1.0, 1.0, 1.0], 0.01, 3, "does not hold that many levels|does not stand still"),
    ],
)
def test_a_list_that_does_not_fit_the_record_is_refused(levels, noise, count, message):
    with pytest.raises(CalibrationError, match=message) as caught:
        find_steps(*record(levels, 5.0, noise), 0.05 * np.arange(count))
    assert caught.value.kept == "No file was written."


def test_records_full_of_holes_or_too_short_are_refused():
    time, raw = record([0.0, 1.0, 2.0], 5.0, 0.01)
    depths = np.array([0.0, 0.05, 0.1])
    with pytest.raises(CalibrationError, match="33 % of the 1500 samples"):
        find_steps(time, np.where(np.arange(raw.size) % 3 == 0, np.nan, raw), depths)
    with pytest.raises(CalibrationError, match="holds 40 samples"):
        find_steps(time[:40], raw[:40], depths)
    with pytest.raises(CalibrationError, match="missing"):
        find_steps(np.empty(0), np.empty(0), depths)


def test_a_table_gives_its_steps_row_by_row():
    steps = given_steps(np.array([0, 0, 0.05, 0.1, 0.1, 0.05]), np.array([1, 3, 4, 5, np.nan, 4.5]))
    assert [(step.immersion_m, step.raw, step.samples) for step in steps] == [
        (0.0, 2.0, 2),
        (0.05, 4.0, 1),
        (0.1, 5.0, 1),
        (0.05, 4.5, 1),
    ]
    assert steps[0].raw_u == pytest.approx(1.0)
    with pytest.raises(CalibrationError, match="row 2 of the table"):
        given_steps(np.array([0, np.nan]), np.array([1.0, 2.0]))
    with pytest.raises(CalibrationError, match=r"0.05 m has no raw value \(row 2\)"):
        given_steps(np.array([0, 0.05]), np.array([1.0, np.nan]))
