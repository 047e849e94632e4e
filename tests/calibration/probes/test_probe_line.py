from __future__ import annotations

import numpy as np
import pytest

from thermacq_calibration import CalibrationError
from thermacq_calibration.probes.immersion_steps import StepReading
from thermacq_calibration.probes.probe_line import check_immersions, fit_probe_line, judge_line

DEPTHS = np.array([0.0, 0.04, 0.08, 0.12, 0.16, 0.2])


def readings(depths, raw, raw_u=0.0):
    return [StepReading(float(d), float(r), raw_u) for d, r in zip(depths, raw, strict=True)]


def test_an_exact_line_is_found_exactly():
    line = fit_probe_line(readings(DEPTHS, 2.5 - 20 * DEPTHS))
    assert line.coefficient_m_per_unit == pytest.approx(-0.05, rel=1e-12)
    assert line.zero_raw == pytest.approx(2.5, rel=1e-12)
    assert line.coefficient_u_rel < 1e-12
    assert line.linearity < 1e-12
    assert line.hysteresis_m is None
    assert judge_line(line) == []


def test_stated_uncertainties_hold_over_repeats():
    """Positions of 0.1 mm: errors over standard errors follow Student's t with 4 degrees of freedom."""
    rng = np.random.default_rng(3)
    coefficient, zero, covered = [], [], 0
    for _ in range(2000):
        line = fit_probe_line(readings(DEPTHS, 2.5 + 20 * (DEPTHS + 1e-4 * rng.standard_normal(6))))
        relative = line.coefficient_m_per_unit / 0.05 - 1
        coefficient.append(relative / line.coefficient_u_rel)
        zero.append((line.zero_raw - 2.5) / line.zero_u_raw)
        covered += abs(relative) < line.interval
    for scores in (coefficient, zero):
        # Student's t with 4 degrees of freedom has quartiles at -0.741 and 0.741.
        assert np.percentile(np.abs(scores), 50) == pytest.approx(0.741, abs=0.06)
    assert covered / 2000 == pytest.approx(0.95, abs=0.015)


def test_uncertain_readings_count_where_residuals_happen_to_be_small():
    quiet = fit_probe_line(readings(DEPTHS, 20 * DEPTHS, raw_u=0.02))
    spread = np.sqrt(np.sum((DEPTHS - DEPTHS.mean()) ** 2))
    assert quiet.coefficient_u_rel == pytest.approx(0.02 / spread / 20)


def test_a_bent_probe_a_meniscus_and_a_poor_line_are_said():
    rng = np.random.default_rng(0)
    raw = 20 * (DEPTHS + 0.3 * (DEPTHS - 0.1) ** 2 + 1e-5 * rng.standard_normal(6))
    bent = fit_probe_line(readings(DEPTHS, raw))
    # z = 0.3 (x - 0.1)^2 sags by 0.3 * 0.1^2 over a span of 0.2.
    assert bent.curvature == pytest.approx(0.3 * 0.01 / 0.2, rel=0.02)
    assert any("not linear" in sentence for sentence in judge_line(bent))
    there = np.concatenate([DEPTHS, DEPTHS[-2::-1]])
    moved = np.sign(np.diff(there, prepend=-1))
    hung = fit_probe_line(readings(there, 20 * (there - 5e-4 * moved)))
    assert hung.hysteresis_m == pytest.approx(1e-3, rel=0.05)
    poor = fit_probe_line(readings(DEPTHS, 20 * (DEPTHS + 0.01 * np.array([1, -1, 1, -1, 1, -1]))))
    assert any("is known to" in sentence for sentence in judge_line(poor))


@pytest.mark.parametrize(
    ("depths", "message"),
    [
        ([], "0 immersions"),
        ([0.1], "1 immersion:"),
        ([0.0, 0.1], "2 immersions"),
        ([0.1, 0.1, 0.1], "all immersions are 0.1 m"),
        ([0.0, 0.1, 0.1, 0.2], "0.1 m twice"),
        ([0.0, 0.1, 0.0], "only two different"),
        ([0.0, np.nan, 0.1], "not a number"),
        ([0.0, 50.0, 100.0], "in metres"),
    ],
)
def test_immersions_without_a_line_are_refused(depths, message):
    with pytest.raises(CalibrationError, match=message):
        check_immersions(np.array(depths))


def test_raw_values_that_turn_back_are_refused():
    raw = 20 * DEPTHS
    raw[4] = raw[2]
    with pytest.raises(CalibrationError, match=r"step 5 \(0.16 m\) reads 1.6 and step 3"):
        fit_probe_line(readings(DEPTHS, raw))
    raw[4] = np.nan
    with pytest.raises(CalibrationError, match="not a number"):
        fit_probe_line(readings(DEPTHS, raw))
