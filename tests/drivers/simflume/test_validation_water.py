from __future__ import annotations

import numpy as np
import pytest

from thermacq_drivers.simflume import validation_water
from thermacq_drivers.simflume.validation_water import Check, failed, mean_period, water_checks


@pytest.mark.slow
def test_the_water_is_what_formulas_and_the_paper_say() -> None:
    checks = water_checks()
    assert failed(checks) == []
    assert len({check.name for check in checks}) == len(checks) == 15 + 4 + 3 + 3 + 15 + 2 + 1


def test_a_check_that_does_not_hold_is_told() -> None:
    good, bad = Check("depth", "m", 0.9, 0.901, 0.002), Check("depth", "m", 0.9, 0.8, 0.002)
    assert good.holds
    assert not bad.holds
    assert failed([good, bad]) == ["depth: 0.8 m instead of 0.9 +- 0.002"]


def test_a_wrong_reflection_would_be_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation_water, "reflection_by_three_probes", lambda *_: 0.2)
    assert len(failed(validation_water.reflection_checks())) == 2


def test_periods_are_found_between_samples() -> None:
    time_s = np.arange(0, 100, 0.11)
    assert mean_period(time_s, np.sin(2 * np.pi * time_s / 1.37)) == pytest.approx(1.37, rel=1e-5)
