"""The trigger line of a run whose trigger source only reckoned its pulses, as a probe stamped it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from thermacq.timing import (
    NS_PER_S,
    CameraEvidence,
    FrameTimes,
    ProbeEvidence,
    TriggerLine,
    fit_device_clock,
    line_of_probes,
)

if TYPE_CHECKING:
    from thermacq.store.reader import RunFile


def trigger_line(run: RunFile) -> TriggerLine | None:
    """Triggers of all frames of a run from the pulses that a probe stamped.

    Returns
    -------
    TriggerLine or None
        None when the trigger source observed its pulses itself, or no probe stamped them: what is recorded
        with the frames is then the best that is known.
    """
    if not run.header.triggers_reckoned:
        return None
    period_ns = NS_PER_S / run.rig.trigger.frame_rate_hz
    cameras = {name: _camera(run, name) for name in run.cameras}
    return line_of_probes([_probe(run, name) for name in run.probes], period_ns, cameras)


def frame_times(run: RunFile, cameras: tuple[str, ...]) -> list[FrameTimes]:
    """Times of the frames of these cameras, with the triggers that the line tells where it tells any."""
    line = trigger_line(run)
    found = line.frames if line else {}
    return [found.get(name) or run.frames(name) for name in cameras]


def _camera(run: RunFile, name: str) -> CameraEvidence:
    table, capabilities = run.frames(name), run.camera(name).capabilities
    rate_hz = float(capabilities.get("tick_rate_hz") or 0.0)
    known = table.ticks >= 0
    clock = None
    if rate_hz > 0 and known.any():
        clock = fit_device_clock(table.ticks[known], table.host_ns[known], rate_hz, table.restarts_ns)
    return CameraEvidence(table, clock, table.sequence_number if capabilities.get("counter_bits") else None)


def _probe(run: RunFile, name: str) -> ProbeEvidence:
    samples = run.probe(name)
    # Only the last sample of a block was received about when it was taken.
    last = np.append(samples.host_ns[1:] != samples.host_ns[:-1], True)[: len(samples)]
    return ProbeEvidence(
        name,
        samples.ticks[last],
        samples.host_ns[last],
        samples.tick_rate_hz,
        float(np.median(np.diff(samples.ticks))) if len(samples) > 1 else 0.0,
        samples.pulse_ticks,
        samples.restarts_ns,
    )
