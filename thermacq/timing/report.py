"""The synchronisation report that every run carries: pairs, skew, late triggers, losses by cause."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.timing.line import TriggerLine
from thermacq.timing.pairing import FrameTimes, pair_frames
from thermacq.timing.restarts import DeviceTimes

SKEW_SOURCES = {
    "software": "host time read by each process just before it fires its trigger",
    "hardware": "one line for all cameras: the host cannot see their skew",
    "free_run": "device clocks mapped to host time",
}
VIRTUAL_NOTE = "virtual clock: skew is simulated"


def sync_report(
    trigger_mode: str,
    virtual: bool,
    cameras: Mapping[str, FrameTimes],
    clocks: Mapping[str, DeviceTimes | None],
    counts: Mapping[str, Mapping[str, Any]],
    line: TriggerLine | None = None,
) -> dict[str, Any]:
    """Say how well a run was synchronised.

    Parameters
    ----------
    trigger_mode, virtual
        How the run was triggered (``free_run``, ``software``, ``hardware``), and whether its clock was virtual.
    cameras
        Times of the frames by camera, in the order of the rig; the first two make the stereo pair.
    clocks
        Clock models by device, probes included; None where there was not enough evidence.
    counts
        By device: ``received``, ``written``, and ``lost``, a table of losses by cause.
    line
        The trigger line as a probe stamped it; frames are then paired by its pulses.

    Returns
    -------
    dict
        Plain values for the run's summary.
    """
    report: dict[str, Any] = {
        "clock": "virtual" if virtual else "real",
        "note": VIRTUAL_NOTE if virtual else "",
        "trigger_mode": trigger_mode,
        "cameras": list(cameras),
        "devices": {name: dict(values) for name, values in counts.items()},
        "late_triggers": {name: counts[name]["lost"].get("late_trigger", 0) for name in cameras},
        "clocks": {name: model.to_dict() if model else None for name, model in clocks.items()},
    }
    if line is not None:
        report["line"] = line.figures
        cameras = {name: line.frames.get(name, frames) for name, frames in cameras.items()}
    if len(cameras) >= 2:
        report |= _pair_report(trigger_mode, list(cameras.items())[:2], clocks)
    return report


def _pair_report(
    trigger_mode: str, stereo: list[tuple[str, FrameTimes]], clocks: Mapping[str, DeviceTimes | None]
) -> dict[str, Any]:
    (name_left, left), (name_right, right) = stereo
    pairs = pair_frames(left, right, clocks.get(name_left), clocks.get(name_right))
    return {
        "pairs": int(pairs.left.size),
        "paired_by": pairs.paired_by,
        "unpaired": {name_left: int(pairs.unpaired_left.size), name_right: int(pairs.unpaired_right.size)},
        "skew_ns": skew_figures(pairs.skew_ns),
        "skew_source": SKEW_SOURCES[trigger_mode],
    }


def line_rows(line: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The part ``line`` of a report in words: of what, and what is said of it."""
    first = ", ".join(str(index) for index in line["lost_pulse_indices"])
    listed = f" ({first}{', ...' if line['lost_pulses'] > len(line['lost_pulse_indices']) else ''})"
    emitted = f", {line['emitted']} reckoned by the source" if "emitted" in line else ""
    pulses = (
        f"{line['stamped']} stamped by '{line['probe']}'{emitted}; lost on the line {line['lost_pulses']}"
        f"{listed if first else ''}, missed by the probe {line['not_stamped']}, "
        f"additional {line['extra_pulses']}"
    )
    rows = [("pulses", pulses)]
    for name, camera in line["cameras"].items():
        words = (
            f"{camera['frames']} pulses have a frame; frames lost {camera['lost']}, pulses not followed "
            f"{camera['overlooked']}, frames of no pulse {camera['extra']}; "
            f"{camera['delay_ns'] / 1e6:.1f} ms later than its pulses, placed by {camera['placed_by']}"
        )
        rows.append((name, words))
    return rows


def skew_figures(skew_ns: NDArray[np.int64]) -> dict[str, float] | None:
    """Median, 99th percentile and maximum of the absolute skew, ns; None without pairs."""
    if skew_ns.size == 0:
        return None
    size = np.abs(skew_ns)
    return {
        "p50": float(np.percentile(size, 50)),
        "p99": float(np.percentile(size, 99)),
        "max": float(size.max()),
    }
