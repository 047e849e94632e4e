from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_calibration import CalibrationError, PatternGrowth, fit_growth

AGES_S = (1.0, 30.0, 120.0, 300.0, 900.0, 1800.0)


@given(
    start=st.floats(0, 0.02),
    power=st.floats(0.002, 0.02),
    exponent=st.sampled_from([0.2, 0.35, 0.5]),
    linear=st.floats(0, 0.002),
)
def test_the_law_is_found_again(start, power, exponent, linear):
    law = PatternGrowth(start, power, exponent, linear)
    found = fit_growth(AGES_S, [law.sigma_k(age) for age in AGES_S])
    for age in (60.0, 600.0, 3600.0):
        assert found.sigma_k(age) == pytest.approx(law.sigma_k(age), rel=0.01)


def test_growth_is_never_negative():
    found = fit_growth(AGES_S, [0.01, 0.009, 0.011, 0.01, 0.009, 0.01])
    assert found.growth_k(0, 3600) >= 0
    assert found.growth_k(0, 3600) < 0.001


def test_growth_within_a_recording():
    law = PatternGrowth(0.008, 0.002, 0.5, 0.001)
    # 0.002 sqrt(20) + 0.001 * 20 = 28.9 mK within 20 minutes.
    assert law.growth_k(0.0, 1200.0) == pytest.approx(0.0289, abs=1e-4)


@pytest.mark.parametrize(
    ("ages", "sigma"),
    [((1, 2, 3), (1, 1, 1)), ((1, 2, 3, 3), (1, 1, 1, 1)), ((1, 2, 3, 4), (1, 1, 1, float("nan"))),
     ((-1, 2, 3, 4), (1, 1, 1, 1))],
)  # fmt: skip
def test_too_little_to_go_by_is_refused(ages, sigma):
    with pytest.raises(CalibrationError):
        fit_growth(ages, sigma)
