"""Two GigE Vision cameras at 60 frames/s of 640 x 512 Mono16 for 60 s: every frame kept or its loss explained.

The cameras are Aravis' own fake ones, on two loopback addresses (the second needs root). What a camera sent is
known from its frame ids: from the first to the last that was recorded. Frames that the camera itself left out,
because it was not given the processor in time, have no id; they are the difference to the 3600 asked for.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from thermacq.acquisition import record
from thermacq.rig import Rig
from thermacq.store import RunFile, open_run

RATE_HZ = 60.0
SECONDS = 60.0
PROGRAM = "arv-fake-gv-camera-0.8"
ADDRESSES = {"left": "127.0.0.1", "right": "127.0.0.2"}
_STARTING_S = 1.0


def run() -> list[dict[str, Any]]:
    """Rows of the benchmark; none, with the reason printed, where the fake cameras cannot run."""
    if shutil.which(PROGRAM) is None:
        print(f"left out: {PROGRAM} is not installed (Debian: aravis-tools)")
        return []
    subprocess.run(["ip", "addr", "add", "127.0.0.2/8", "dev", "lo"], capture_output=True, check=False)
    with tempfile.TemporaryDirectory() as folder, _cameras():
        dropped_before = _datagrams_dropped()
        result = record(_rig(), Path(folder) / "pair.h5", duration_s=SECONDS)
        dropped = _datagrams_dropped() - dropped_before
        with open_run(result.path) as recorded:
            rows = [row for name in ADDRESSES for row in _rows(recorded, name)]
    sync = result.summary["sync"]
    rows.append({"name": "pairs by device time", "value": sync["pairs"], "unit": "pairs"})
    rows.append({"name": "packets that the kernel had no room for", "value": dropped, "unit": "packets"})
    return rows


def _rig() -> Rig:
    settings = {"columns": 640, "rows": 512}
    cameras = {
        name: {"driver": "gige", "serial": f"BENCH-{name}", "settings": settings | {"address": address}}
        for name, address in ADDRESSES.items()
    }
    trigger = {"mode": "free_run", "frame_rate_hz": RATE_HZ}
    return Rig.model_validate({"name": "gige", "trigger": trigger, "cameras": cameras})


def _rows(recorded: RunFile, name: str) -> Iterator[dict[str, Any]]:
    frames = recorded.frames(name)
    counters = np.asarray(frames.counter)
    sent = int(counters[-1] - counters[0]) + 1
    summary = recorded.summary() or {}
    lost = {cause: count for cause, count in summary["sync"]["devices"][name]["lost"].items() if count}
    asked = RATE_HZ * SECONDS
    baseline = f"{asked:.0f} asked for"
    yield {
        "name": f"{name}: frames that the camera sent",
        "value": sent,
        "unit": "frames",
        "baseline": baseline,
        "ratio": sent / asked,
    }
    yield {
        "name": f"{name}: frames written",
        "value": len(frames),
        "unit": "frames",
        "baseline": "sent",
        "ratio": len(frames) / sent,
    }
    for cause, count in lost.items():
        yield {"name": f"{name}: lost, {cause}", "value": count, "unit": "frames"}
    unexplained = sent - len(frames) - sum(lost.values())
    yield {"name": f"{name}: lost, unexplained", "value": unexplained, "unit": "frames"}


def _datagrams_dropped() -> int:
    """UDP datagrams of this machine that found a full receive buffer, since it was started."""
    lines = [
        line.split() for line in Path("/proc/net/snmp").read_text().splitlines() if line.startswith("Udp:")
    ]
    return int(dict(zip(*lines, strict=True))["RcvbufErrors"])


@contextmanager
def _cameras() -> Iterator[None]:
    processes = [
        subprocess.Popen([PROGRAM, "-i", address, "-s", f"BENCH-{name}"], stdout=subprocess.DEVNULL)
        for name, address in ADDRESSES.items()
    ]
    try:
        time.sleep(_STARTING_S)
        yield
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            process.wait(10)
