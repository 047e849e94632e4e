from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermacq_calibration import CalibrationError, PatternGrowth, fit_growth, growth_warning

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


def test_a_recording_that_outgrows_half_the_netd_is_warned_of():
    law = PatternGrowth(0.008, 0.002, 0.5, 0.001)
    assert growth_warning(law, 0.0, 300.0, 0.035) == ""
    # 0.002 sqrt(20) + 0.001 * 20 = 29 mK within 20 minutes.
    text = growth_warning(law, 0.0, 1200.0, 0.035)
    assert "grow by 29 mK during 1200 s, more than half the NETD of 35 mK" in text
    assert np.isclose(law.growth_k(0.0, 1200.0), 0.0289, atol=1e-4)


@pytest.mark.parametrize(
    ("ages", "sigma"),
    [((1, 2, 3), (1, 1, 1)), ((1, 2, 3, 3), (1, 1, 1, 1)), ((1, 2, 3, 4), (1, 1, 1, float("nan"))),
     ((-1, 2, 3, 4), (1, 1, 1, 1))],
)  # fmt: skip
def test_too_little_to_go_by_is_refused(ages, sigma):
    with pytest.raises(CalibrationError):
        fit_growth(ages, sigma)
