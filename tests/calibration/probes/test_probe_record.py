from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from thermacq_calibration import CalibrationError
from thermacq_calibration.probes.immersion_steps import StepReading
from thermacq_calibration.probes.probe_line import fit_probe_line
from thermacq_calibration.probes.probe_record import (
    ProbeCalibration,
    coefficient_spread,
    load_probe_calibration,
    probe_drift,
)

DEPTHS = np.array([0.0, 0.05, 0.1, 0.15, 0.2])


def made(gain=20.0, zero=2.5, noise_m=1e-4, seed=0, serial="P-1"):
    rng = np.random.default_rng(seed)
    raw = zero + gain * (DEPTHS + noise_m * rng.standard_normal(DEPTHS.size))
    steps = tuple(StepReading(float(d), float(r), 1e-4) for d, r in zip(DEPTHS, raw, strict=True))
    line = fit_probe_line(steps)
    return ProbeCalibration("P1", serial, "a", "V", steps, line, "p.csv", f"2026-01-{seed % 28 + 1:02d}")


def test_a_saved_record_comes_back_and_is_never_overwritten(tmp_path):
    record = made()
    record.save(tmp_path / "p.json")
    assert load_probe_calibration(tmp_path / "p.json") == record
    with pytest.raises(CalibrationError, match="exists already"):
        record.save(tmp_path / "p.json")
    with pytest.raises(CalibrationError, match="cannot be written"):
        record.save(tmp_path / "none" / "p.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not valid JSON"),
        ("{}", "no probe calibration"),
        ("[1]", "not a table"),
        ("\x00", "not valid JSON"),
    ],
)
def test_foreign_files_are_refused(tmp_path, text, message):
    (tmp_path / "p.json").write_text(text)
    with pytest.raises(CalibrationError, match=message):
        load_probe_calibration(tmp_path / "p.json")


def test_an_altered_record_is_refused(tmp_path):
    values = made().to_dict()
    values["line"]["coefficient_m_per_unit"] *= 1.01
    (tmp_path / "p.json").write_text(json.dumps(values))
    with pytest.raises(CalibrationError, match="altered"):
        load_probe_calibration(tmp_path / "p.json")
    del values["line"]["zero_raw"]
    with pytest.raises(CalibrationError, match="zero_raw is not a number"):
        ProbeCalibration.from_dict(values)


def test_drift_is_told_from_chance():
    """Repeats without drift are called significant about as often as a factor of two allows; real drift always."""
    flagged = [probe_drift(made(seed=2 * i), made(seed=2 * i + 1)) for i in range(200)]
    # Two standard errors of 3 + 3 degrees of freedom: between 5 % (many) and 14 % (three).
    assert np.mean([drift.coefficient_significant for drift in flagged]) < 0.2
    assert np.mean([drift.zero_significant for drift in flagged]) < 0.2
    drift = probe_drift(made(), made(gain=20.4, zero=2.6, seed=1))
    assert drift.coefficient_significant
    assert drift.coefficient_rel == pytest.approx(20 / 20.4 - 1, abs=0.003)
    assert drift.zero_significant
    assert drift.zero_m == pytest.approx(0.1 / 20, abs=3e-4)


def test_different_probes_are_not_compared():
    with pytest.raises(CalibrationError, match="different serials, 'P-1' and 'P-2'"):
        probe_drift(made(), made(serial="P-2"))
    other_unit = dataclasses.replace(made(), unit="counts")
    with pytest.raises(CalibrationError, match="different units"):
        probe_drift(made(), other_unit)


def test_the_spread_of_repeated_calibrations():
    records = [made(gain=20 * factor, noise_m=0.0) for factor in (1.0, 1.01, 0.99)]
    spread = coefficient_spread(records)
    assert spread.count == 3
    assert spread.sd_rel == pytest.approx(0.01, rel=0.02)
    assert spread.range_rel == pytest.approx(0.02, rel=0.02)
    assert np.isnan(coefficient_spread(records[:1]).sd_rel)
