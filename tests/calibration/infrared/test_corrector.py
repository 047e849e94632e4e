"""One pass over a picture gives what the formulas say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq_calibration import CalibrationError, CameraCorrection, Corrector

SHAPE = (70, 90)


def make(bad=None, **changes) -> CameraCorrection:
    random = np.random.default_rng(2)
    values = {
        "gain": random.normal(1, 0.03, SHAPE),
        "offset": random.normal(0, 50, SHAPE),
        "shading": random.normal(0, 3, SHAPE),
        "shading_temperature_k": 306.0,
        "shading_zero_k": 303.0,
    }
    bad = random.random(SHAPE) < 0.02 if bad is None else bad
    return CameraCorrection("SIM-1", "left", bad_pixels=bad.astype(np.uint8), **{**values, **changes})


def counts(shape=SHAPE) -> np.ndarray:
    return np.random.default_rng(3).integers(4000, 9000, shape).astype(np.uint16)


def test_good_pixels_follow_the_formula():
    record, raw = make(), counts()
    before = raw.copy()
    good = record.bad_pixels == 0
    expected = record.gain.astype(float) * raw + record.offset - 2 * record.shading
    corrected = Corrector(record)(raw, 309.0)
    np.testing.assert_allclose(corrected[good], expected[good], atol=2e-3)
    np.testing.assert_array_equal(raw, before)


def test_each_stage_can_be_left_out():
    record, raw = make(), counts()
    two_point = record.gain * raw + record.offset
    only = Corrector(record, bad_pixels=False, shading=False)
    np.testing.assert_allclose(only(raw), two_point, atol=2e-3)
    assert only.stages == ("nonuniformity",)
    only = Corrector(record, nonuniformity=False, bad_pixels=False)
    np.testing.assert_allclose(only(raw), raw - record.shading, atol=2e-3)
    nothing = Corrector(record, nonuniformity=False, bad_pixels=False, shading=False)
    np.testing.assert_array_equal(nothing(raw), raw)
    assert nothing.stages == ()
    assert Corrector(record).stages == ("nonuniformity", "shading", "bad-pixels")
    assert Corrector(make(shading=None)).stages == ("nonuniformity", "bad-pixels")


def test_a_picture_does_not_depend_on_those_before_it():
    record, raw = make(), counts()
    alone = Corrector(record)(raw, 304.0)
    used = Corrector(record)
    out = np.empty(SHAPE, np.float32)
    for kelvin in (303.0, float("nan"), 310.0, 304.005):
        assert used(raw, kelvin, out) is out
    np.testing.assert_array_equal(out, alone)


def test_shading_is_as_measured_where_the_temperature_is_unknown():
    record, raw = make(), counts()
    np.testing.assert_array_equal(Corrector(record)(raw), Corrector(record)(raw, 306.0))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0, 0.3))
def test_bad_pixels_become_the_median_of_their_good_neighbours(seed, share):
    random = np.random.default_rng(seed)
    bad = random.random((20, 25)) < share
    raw = random.integers(0, 16384, bad.shape).astype(np.uint16)
    one = np.ones(bad.shape)
    corrected = Corrector(make(bad, gain=one, offset=0 * one, shading=None))(raw)
    np.testing.assert_array_equal(corrected[~bad], raw[~bad])
    for row, column in np.argwhere(bad):
        for reach in range(1, 6):
            near = np.s_[
                max(0, row - reach) : row + reach + 1,
                max(0, column - reach) : column + reach + 1,
            ]
            good = raw[near][~bad[near]]
            if len(good) >= 3:
                break
        assert corrected[row, column] == np.median(good)


def test_a_covered_region_cannot_be_replaced():
    bad = np.zeros(SHAPE, bool)
    bad[:20, :20] = True
    with pytest.raises(CalibrationError, match="so many pixels are bad"):
        Corrector(make(bad))


def test_a_picture_of_another_size_is_refused():
    with pytest.raises(CalibrationError, match=r"90 x 70 pixels does not fit .* 'left' \(70 x 90\)"):
        Corrector(make())(counts((90, 70)))


def test_a_temperature_in_celsius_is_refused():
    with pytest.raises(CalibrationError, match="reports 31 K inside"):
        Corrector(make())(counts(), 31.0)
