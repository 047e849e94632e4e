"""Two emulated Thermal Master P3 at their nominal 25 frames/s for 60 s: every frame kept or its loss explained.

The cameras are emulated behind pyusb; driver, recorder and file are the real ones. What a camera sent is known
from its own count, from the first to the last frame that was recorded.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from thermacq.acquisition import record
from thermacq.rig import Rig
from thermacq.store import RunFile, open_run

RATE_HZ = 25.0
SECONDS = 60.0
CAMERAS = ("left", "right")


def run() -> list[dict[str, Any]]:
    """Rows of the benchmark."""
    trigger = {"mode": "free_run", "frame_rate_hz": RATE_HZ}
    cameras = {name: {"driver": "p3"} for name in CAMERAS}
    rig = Rig.model_validate({"name": "usb cameras", "trigger": trigger, "cameras": cameras})
    with tempfile.TemporaryDirectory() as folder:
        result = record(rig, Path(folder) / "pair.h5", duration_s=SECONDS, emulate=True)
        with open_run(result.path) as recorded:
            return [row for name in CAMERAS for row in _rows(recorded, name)]


def _rows(recorded: RunFile, name: str) -> list[dict[str, Any]]:
    frames = recorded.frames(name)
    counters = np.asarray(frames.counter)
    sent = int(counters[-1] - counters[0]) + 1
    lost = (recorded.summary() or {})["sync"]["devices"][name]["lost"]
    asked = RATE_HZ * SECONDS
    rows = [
        (f"{name}: frames that the camera sent", sent, f"{asked:.0f} nominal", sent / asked),
        (f"{name}: frames written", len(frames), "sent", len(frames) / sent),
        *((f"{name}: lost, {cause}", count, "", None) for cause, count in lost.items() if count),
        (f"{name}: lost, unexplained", sent - len(frames) - sum(lost.values()), "", None),
    ]
    return [
        {"name": what, "value": value, "unit": "frames", "baseline": baseline, "ratio": ratio}
        for what, value, baseline, ratio in rows
    ]
