"""Readings of a static probe calibration: from a run file, from a series, or from a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from thermacq.errors import StoreError
from thermacq.evaluation.series import Series
from thermacq.evaluation.textseries import read_columns, read_series
from thermacq.store import open_run
from thermacq_calibration.probes.immersion_steps import StepReading, find_steps, given_steps
from thermacq_calibration.probes.probe_line import check_immersions


@dataclass(frozen=True)
class ProbeSteps:
    """Readings, and where they come from; texts are empty where nothing is known."""

    steps: Sequence[StepReading]
    source: str
    created: str
    probe: str = ""
    serial: str = ""
    channel: str = ""
    unit: str = ""


def steps_of_run(path: Path, immersions_m: Series, probe: str | None, channel: str | None) -> ProbeSteps:
    """Find the steps in the record of a probe.

    Parameters
    ----------
    path
        Run file.
    immersions_m
        (steps,) depths in the order of the record.
    probe, channel
        Names; None: the only probe, the rig's channel.

    Raises
    ------
    StoreError
        The run cannot be read, or has no such probe or channel.
    CalibrationError
        The steps are not there.
    """
    check_immersions(immersions_m)
    with open_run(path) as run:
        name = probe or _only_probe(run.probes, path)
        samples, stream = run.probe(name), run.probe_stream(name)
        chosen = channel or run.rig.probes[name].channel or samples.channels[0]
        if chosen not in samples.channels:
            raise StoreError(
                f"probe '{name}' of '{path}' has no channel '{chosen}'",
                remedy=f"It has: {', '.join(samples.channels)}.",
            )
        rated = samples.tick_rate_hz > 0
        time_s = samples.ticks / samples.tick_rate_hz if rated else samples.index.astype(np.float64)
        raw = samples.values[:, samples.channels.index(chosen)]
        return ProbeSteps(
            find_steps(time_s - time_s[:1], raw, immersions_m),
            f"{path.name} (run {run.header.run_id})",
            run.header.start_time,
            name,
            stream.serial,
            chosen,
            samples.unit,
        )


def steps_of_series(
    path: Path, immersions_m: Series, column: str | None, rate_hz: float | None
) -> ProbeSteps:
    """Find the steps in a text file of times and raw values, see `read_series`; same errors, and its own."""
    check_immersions(immersions_m)
    time_s, raw = read_series(path, value_column=column or "", rate_hz=rate_hz)
    return ProbeSteps(find_steps(time_s, raw, immersions_m), path.name, _now(), channel=column or "")


def steps_of_table(path: Path, immersion_column: str, column: str | None) -> ProbeSteps:
    """Read the steps from a text file with a column of immersions (metres) and one of raw values."""
    immersions_m, raw = read_columns(path, [immersion_column, column or "2"])
    return ProbeSteps(given_steps(immersions_m, raw), path.name, _now(), channel=column or "")


def _only_probe(probes: Sequence[str], path: Path) -> str:
    if len(probes) == 1:
        return probes[0]
    what = f"has the probes {', '.join(probes)}" if probes else "has no probe"
    raise StoreError(f"'{path}' {what}", remedy="Say which one with --probe NAME." if probes else "")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
