import json
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from thermacq.timing import fit_clock, line_rows, skew_figures, sync_report


@dataclass
class Times:
    trigger_index: NDArray[np.int64]
    trigger_ns: NDArray[np.int64]
    ticks: NDArray[np.int64]
    host_ns: NDArray[np.int64]


def camera(index: NDArray[np.int64], skew_ns: NDArray[np.int64] | int) -> Times:
    fired = index * 1000 + skew_ns
    return Times(index, fired, np.full(index.size, -1), fired)


def counts(received: int, **lost: int) -> dict[str, object]:
    return {"received": received, "written": received, "lost": lost}


def test_the_report_counts_pairs_gaps_and_skew() -> None:
    left, right = camera(np.arange(100), 0), camera(np.arange(2, 100), -np.arange(2, 100))
    clocks = {"left": None, "right": None, "wp": fit_clock(np.arange(50) * 1000, np.arange(50) * 10**6, 1e6)}
    report = sync_report(
        "software",
        False,
        {"left": left, "right": right},
        clocks,
        {"left": counts(100), "right": counts(98, late_trigger=2), "wp": counts(500)},
    )
    assert report["pairs"] == 98
    assert report["unpaired"] == {"left": 2, "right": 0}
    assert report["late_triggers"] == {"left": 0, "right": 2}
    assert report["skew_ns"]["max"] == 99
    assert report["skew_ns"]["p50"] == pytest.approx(50.5)
    assert report["devices"]["right"]["lost"] == {"late_trigger": 2}
    assert report["clocks"]["wp"]["drift_ppm"] == pytest.approx(0, abs=1e-6)
    assert report["note"] == ""
    json.dumps(report)


def test_a_virtual_clock_says_that_its_skew_is_simulated() -> None:
    frames = camera(np.arange(3), 0)
    report = sync_report("software", True, {"a": frames, "b": frames}, {}, {"a": counts(3), "b": counts(3)})
    assert report["note"] == "virtual clock: skew is simulated"


def test_one_camera_has_no_pairs() -> None:
    report = sync_report("software", False, {"a": camera(np.arange(3), 0)}, {}, {"a": counts(3)})
    assert "pairs" not in report


def test_skew_is_an_absolute_value() -> None:
    assert skew_figures(np.array([-3, 1, 2])) == {"p50": 2.0, "p99": pytest.approx(2.98), "max": 3.0}
    assert skew_figures(np.empty(0, np.int64)) is None


def test_the_line_in_words():
    figures = {
        "probe": "gauge",
        "stamped": 900,
        "emitted": 1000,
        "extra_pulses": 1,
        "lost_pulses": 3,
        "lost_pulse_indices": [4, 5],
        "not_stamped": 2,
        "cameras": {
            "left": {
                "frames": 990,
                "lost": 5,
                "overlooked": 4,
                "extra": 1,
                "delay_ns": 31.25e6,
                "placed_by": "gaps",
            }
        },
    }
    assert line_rows(figures) == [
        (
            "pulses",
            (
                "900 stamped by 'gauge', 1000 reckoned by the source; lost on the line 3 (4, 5, ...), missed "
                "by the probe 2, additional 1"
            ),
        ),
        (
            "left",
            (
                "990 pulses have a frame; frames lost 5, pulses not followed 4, frames of no pulse 1; "
                "31.2 ms later than its pulses, placed by gaps"
            ),
        ),
    ]
