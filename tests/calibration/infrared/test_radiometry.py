from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_calibration import CalibrationError, radiometric_scale


@given(slope=st.floats(1, 500), zero=st.floats(100, 290), step=st.floats(0.5, 10))
def test_a_straight_line_is_found_again(slope, zero, step):
    kelvin = [290.0, 290 + step, 290 + 3 * step]
    scale = radiometric_scale(kelvin, [slope * (t - zero) for t in kelvin])
    assert scale.counts_per_kelvin == pytest.approx(slope, rel=1e-6)
    assert scale.kelvin_at_zero == pytest.approx(zero, abs=1e-3)
    assert scale.residual_k < 1e-6


def test_curvature_shows_as_residual():
    kelvin = (290.0, 295.0, 300.0)
    scale = radiometric_scale(kelvin, [80 * (t - 290) + 0.4 * (t - 295) ** 2 for t in kelvin])
    # A parabola of 10 counts at the ends lies 2/3 of that from its line in the middle.
    assert scale.residual_k == pytest.approx(10 * 2 / 3 / 80, rel=0.02)
    assert scale.slope_error == pytest.approx((200 / 3 / 50) ** 0.5, rel=0.01)


def test_two_views_say_nothing_about_the_residual():
    scale = radiometric_scale((290.0, 300.0), (1000.0, 1800.0))
    assert (scale.counts_per_kelvin, scale.kelvin_at_zero) == (80.0, 277.5)
    assert scale.slope_error is None


@pytest.mark.parametrize(
    ("kelvin", "counts", "message"),
    [
        ((295.0, 295.0), (1.0, 2.0), "at least two known temperatures"),
        ((295.0,), (1.0,), "at least two known temperatures"),
        ((290.0, 300.0), (2.0, 1.0), "do not rise"),
    ],
)
def test_what_has_no_slope_is_refused(kelvin, counts, message):
    with pytest.raises(CalibrationError, match=message):
        radiometric_scale(kelvin, counts)
