from __future__ import annotations

import numpy as np
import pytest

from thermacq.evaluation import compare_series, flatness, quantisation_curve
from thermacq.report.data import (
    Coverage,
    EventLine,
    Place,
    Quantisation,
    ReportData,
    SampleFrame,
    Surface,
)

HOSTILE = '<script>alert("x")</script> $\\frac{a}$ & \'"{{ 7*7 }} https://example.org/x.js'


def _comparisons(generator):
    fine = np.arange(-0.5, 9.5, 0.01)
    time = np.arange(0, 9, 0.02)

    def wave(t, phase=0.0):
        angle = 2 * np.pi * t / 0.791 - phase
        return 0.039 * np.cos(angle) + 0.004 * np.cos(2 * angle)

    stereo = 0.985 * wave(time) + generator.normal(0, 8e-4, time.size)
    stereo[100:104] = np.nan
    probe = wave(fine) + generator.normal(0, 2e-4, fine.size)
    return (
        compare_series(time, stereo, fine, probe, reference_name="probe P1"),
        compare_series(time, stereo, time, wave(time), reference_name="truth (simulated) at probe P1"),
        compare_series(
            fine,
            probe,
            fine,
            wave(fine),
            measured_name="probe P1",
            reference_name="truth (simulated) at probe P1",
        ),
    )


@pytest.fixture(scope="session")
def full_data() -> ReportData:
    """A report with every part, names from files hostile wherever a file could bring them."""
    generator = np.random.default_rng(0)
    x, y = np.linspace(0.02, 0.52, 101), np.linspace(-0.25, 0.25, 101)
    eta = 0.04 * np.cos(2 * np.pi * x / 0.9)[None, :] + generator.normal(0, 4e-4, (101, 101))
    eta[:, :9] = np.nan
    eta[np.hypot(x[None, :] - 0.3, y[:, None] + 0.1) < 0.03] = np.nan
    rows, columns = np.mgrid[0:512, 0:640]
    counts = (
        9000 + 400 * np.sin(rows / 31) * np.cos(columns / 23) + generator.normal(0, 20, rows.shape)
    ).astype(np.uint16)
    disparity = 70 - 0.03 * rows + 0.5 * np.sin(columns / 90)
    disparity[:, :60] = np.nan
    still = [generator.normal(0, 4e-4, (101, 101)) + 3e-4 * np.cos(9 * x)[None, :] for _ in range(12)]
    tilt = np.radians(22.8)
    rotation = np.array([[0, np.sin(tilt), np.cos(tilt)], [-1, 0, 0], [0, -np.cos(tilt), -np.sin(tilt)]])
    return ReportData(
        title=f"Run {HOSTILE}",
        created="2026-01-02T03:04:05Z",
        simulated=True,
        sample=SampleFrame(120, 2.4, counts, np.roll(counts, -60, axis=1), disparity),
        surface=Surface(x, y, eta, 2.4),
        coverage=Coverage(450, 0.21, 0.034, 31.0, 6e-4),
        comparisons=_comparisons(generator),
        places=(Place(f"probe {HOSTILE}", 0.3, 0.05),),
        flatness=flatness(still, x, y),
        flatness_source=HOSTILE,
        quantisation=Quantisation(
            quantisation_curve(np.linspace(0.4, 2, 60), 0.06, 705.9, (320, 256), rotation), 0.651, 0.06, 705.9
        ),
        sync={
            "trigger_mode": "software",
            "clock": "virtual",
            "note": "virtual clock: skew is simulated",
            "pairs": 450,
            "paired_by": "trigger index",
            "unpaired": {"left": 0, "right": 1},
            "skew_ns": {"p50": 80.0, "p99": 240.0, "max": 1200.0},
            "skew_source": "host times at which the triggers were fired",
            "late_triggers": {"left": 1, "right": 0},
            "devices": {
                "left": {"received": 450, "written": 450, "lost": {}},
                HOSTILE: {"received": 451, "written": 449, "lost": {"ring_full": 2}},
            },
            "clocks": {
                "P1": {"drift_ppm": 12.3, "residual_ns": 800.0, "method": "pulses", "points": 450},
                "left": None,
            },
        },
        events=(EventLine(1.25, HOSTILE, "late_trigger", 62, HOSTILE),),
        event_count=40,
        notes=(HOSTILE,),
        provenance={"Run": {"sha256": "ab" * 32, "title": HOSTILE}, "Matcher": {"name": "sgbm"}},
    )
