"""Skew of software triggers between two camera processes at 50 Hz, as each run's own sync report says.

The paper states less than 0.1 us for its multiprocess triggering. Every run is reported, not the best: the
figures depend on what else the machine does.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from thermacq.acquisition import record
from thermacq.rig import Rig

RUNS = 3
SECONDS = 10.0
PAPER_NS = 100.0
SMALL = {"driver": "test-pattern", "settings": {"rows": 64, "columns": 80}}


def run() -> list[dict[str, Any]]:
    """Rows of the benchmark."""
    rig = Rig.model_validate({"name": "skew", "cameras": {"left": SMALL, "right": SMALL}})
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(1, RUNS + 1):
            result = record(rig, Path(folder) / f"{number}.h5", duration_s=SECONDS)
            sync, scheduling = result.summary["sync"], result.summary["scheduling"]["left"]
            for figure in ("p50", "p99", "max"):
                value = sync["skew_ns"][figure]
                rows.append(
                    {
                        "name": f"run {number}: skew {figure} of {sync['pairs']} pairs ({scheduling})",
                        "value": value,
                        "unit": "ns",
                        "baseline": f"paper, {PAPER_NS:.0f} ns" if figure == "p50" else "",
                        "ratio": value / PAPER_NS if figure == "p50" else None,
                    }
                )
            late = sum(sync["late_triggers"].values())
            rows.append({"name": f"run {number}: late triggers, skipped", "value": late, "unit": "triggers"})
    return rows
