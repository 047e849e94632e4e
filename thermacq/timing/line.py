"""Which pulse of the trigger line made which frame, when a probe stamped the pulses.

A trigger box that tells nothing of the pulses that it emits is reckoned: its n-th pulse is taken for n periods
after the first. A pulse lost on the way then shifts all that follow by one, and the box's clock is taken for
the host's. A probe that samples the line saw the pulses themselves. Pulses and frames are each put on a grid
of periods by their own times, the two grids are laid over each other, and gaps of one and not of the other
tell lost pulses from lost frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from thermacq.timing.clock import NS_PER_S
from thermacq.timing.pairing import FrameTimes
from thermacq.timing.restarts import DeviceTimes, fit_device_clock, pulse_times_ns

Times = NDArray[np.int64]

_FEWEST_PULSES = 3
# So many periods are numbered by the nominal period; no clock is off by more than 0.1 % of them.
_FIRST_STRETCH = 256
_LARGEST_DELAY_NS = 100_000_000
_LISTED = 20
# A lost pulse misfits twice when frames are laid on the wrong pulses; one or a chance must not decide.
_CLEARLY_BETTER = 3


@dataclass(frozen=True)
class CameraEvidence:
    """What is known of the frames of one camera.

    Parameters
    ----------
    frames
        Their times.
    clock
        Model of the camera's clock; without one the times of receipt must do.
    sequence
        (frames,) int64, counter without its wraps; None when the camera has none.
    """

    frames: FrameTimes
    clock: DeviceTimes | None = None
    sequence: Times | None = None

    def own_times_ns(self) -> Times:
        """Host times of the frames by the camera's clock alone, late by an unknown, steady delay."""
        times = np.array(self.frames.host_ns, np.int64)
        if self.clock is not None:
            ticked = self.frames.ticks >= 0
            times[ticked] = self.clock.times_of(self.frames.ticks[ticked], times[ticked])
        return times


@dataclass(frozen=True)
class ProbeEvidence:
    """What a probe says of the line.

    Parameters
    ----------
    name
        Name in the rig.
    ticks, received_ns
        (n,) int64, device clock at samples, and the host times at which they were received.
    tick_rate_hz
        Nominal rate of the device clock.
    sample_ticks
        Device clock from sample to sample.
    pulse_ticks
        (pulses,) int64, device clock at the pulses that it stamped.
    restarts_ns
        Host times from which its clock counted anew.
    """

    name: str
    ticks: Times
    received_ns: Times
    tick_rate_hz: float
    sample_ticks: float
    pulse_ticks: Times
    restarts_ns: Sequence[int] = ()


@dataclass(frozen=True)
class LineFrames:
    """Frames with the trigger that the line tells: a `thermacq.timing.FrameTimes`.

    `trigger_index` counts pulses from the first that anybody saw; -1 for a frame of no pulse of the grid.
    """

    trigger_index: Times
    trigger_ns: Times
    ticks: Times
    host_ns: Times


@dataclass(frozen=True)
class TriggerLine:
    """The trigger line as a probe saw it.

    Parameters
    ----------
    pulse_ns
        (pulses,) int64, host times of the stamped pulses.
    frames
        Frames of each camera with their triggers.
    figures
        What was lost where, as plain values for the sync report.
    """

    pulse_ns: Times
    frames: dict[str, LineFrames]
    figures: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Grid:
    """Events on a grid of periods: their numbers, and the line through them.

    `kept` are the events that have their number alone: of several with the same one the nearest.
    """

    times_ns: Times
    numbers: Times
    kept: NDArray[np.bool_]
    slope: float
    intercept: float

    def at(self, numbers: Times) -> NDArray[np.float64]:
        """Times of numbers, on the line."""
        return np.asarray(self.slope * numbers + self.intercept, np.float64)

    def residual_ns(self) -> NDArray[np.float64]:
        """Distance of all events from the line."""
        return np.asarray(self.times_ns - self.at(self.numbers), np.float64)


def follow_line(
    pulse_ns: Times,
    period_ns: float,
    resolution_ns: float,
    cameras: Mapping[str, CameraEvidence],
    sampling_since_ns: int | None = None,
) -> TriggerLine | None:
    """Find the pulse of every frame, and what was lost.

    Parameters
    ----------
    pulse_ns
        (pulses,) int64, host times of the pulses that the probe stamped, by the model of its clock.
    period_ns
        Nominal period of the pulses.
    resolution_ns
        Sample interval of the probe. A pulse that lies no further than this from the grid has its time from
        the grid, which is finer.
    cameras
        Frames by camera.
    sampling_since_ns
        When the probe began to sample: the first pulse that it stamped was the first of all if that was well
        before.

    Returns
    -------
    TriggerLine or None
        None when the probe stamped fewer than three pulses.
    """
    pulses = np.unique(np.asarray(pulse_ns, np.int64))
    if pulses.size < _FEWEST_PULSES:
        return None
    stamps = _on_grid(pulses, period_ns)
    stamped = stamps.numbers[stamps.kept]
    first_was_seen = sampling_since_ns is not None and pulses[0] - sampling_since_ns > 1.5 * period_ns
    grids, placed_by = {}, {}
    for name, camera in cameras.items():
        if camera.frames.host_ns.size:
            grid = _on_grid(camera.own_times_ns(), period_ns)
            exposed = _exposed(camera, grid)
            grids[name], placed_by[name] = _laid_over(grid, stamps, exposed, first_was_seen)
    seen = np.unique(np.concatenate([stamped, *(grid.numbers[grid.kept] for grid in grids.values())]))
    away = np.abs(stamps.residual_ns()) > resolution_ns
    times_ns = np.where(away, pulses, np.rint(stamps.at(stamps.numbers))).astype(np.int64)
    frames = {
        name: _frames(cameras[name].frames, grid, stamps, times_ns, int(seen[0]))
        for name, grid in grids.items()
    }
    lost = np.setdiff1d(np.arange(seen[0], seen[-1] + 1), seen) - seen[0]
    figures = {
        "stamped": int(stamped.size),
        "extra_pulses": int((~stamps.kept).sum()),
        "period_ns": stamps.slope,
        "rms_ns": float(np.std(stamps.residual_ns()[stamps.kept])),
        "lost_pulses": int(lost.size),
        "lost_pulse_indices": lost[:_LISTED].tolist(),
        "not_stamped": int(np.setdiff1d(seen, stamped).size),
        "cameras": {
            name: {
                **_losses(cameras[name], grid, seen),
                "placed_by": placed_by[name],
                "delay_ns": float(np.median(grid.times_ns - stamps.at(grid.numbers))),
            }
            for name, grid in grids.items()
        },
    }
    return TriggerLine(times_ns[stamps.kept], frames, figures)


def line_of_probes(
    probes: Sequence[ProbeEvidence], period_ns: float, cameras: Mapping[str, CameraEvidence]
) -> TriggerLine | None:
    """The trigger line as the probe saw it that stamped most pulses; parameters as for `follow_line`.

    Host times of the pulses come from the times at which the probe's samples were received. They are late by
    the shortest delay of its samples, as the samples themselves are: probe and cameras share one time.
    """
    probe = max(probes, key=lambda one: one.pulse_ticks.size, default=None)
    if probe is None or probe.pulse_ticks.size < _FEWEST_PULSES or probe.tick_rate_hz <= 0:
        return None
    clock = fit_device_clock(probe.ticks, probe.received_ns, probe.tick_rate_hz, probe.restarts_ns)
    resolution_ns = probe.sample_ticks / probe.tick_rate_hz * NS_PER_S
    since_ns = int(clock.times_of(probe.ticks[:1], probe.received_ns[:1])[0])
    pulses_ns = pulse_times_ns(clock, probe.pulse_ticks)
    line = follow_line(pulses_ns, period_ns, resolution_ns, cameras, since_ns)
    return replace(line, figures={"probe": probe.name, **line.figures}) if line else None


def _on_grid(times_ns: Times, period_ns: float) -> _Grid:
    """Number events by whole periods; in stretches of growing length, so that no drift adds up."""
    since = (times_ns - times_ns[0]).astype(np.float64)
    size = min(_FIRST_STRETCH, since.size)
    numbers = np.rint(since / period_ns)
    slope, intercept = _line(numbers[:size], since[:size], period_ns)
    while size < since.size:
        size = min(2 * size, since.size)
        numbers = np.rint((since - intercept) / slope)
        slope, intercept = _line(numbers[:size], since[:size], period_ns)
    found = np.rint((since - intercept) / slope).astype(np.int64)
    return _Grid(
        times_ns, found, _alone(since - intercept, found, slope), slope, intercept + int(times_ns[0])
    )


def _line(numbers: NDArray[np.float64], since: NDArray[np.float64], period_ns: float) -> tuple[float, float]:
    """Line through events, the few that are far off (late or additional pulses) left out."""
    if np.ptp(numbers) == 0:
        return period_ns, float(np.median(since - period_ns * numbers))
    slope, intercept = np.polyfit(numbers, since, 1)
    off = np.abs(since - slope * numbers - intercept)
    near = off <= max(4 * float(np.median(off)), 1.0)
    if np.ptp(numbers[near]) > 0:
        slope, intercept = np.polyfit(numbers[near], since[near], 1)
    return float(slope), float(intercept)


def _alone(since: NDArray[np.float64], numbers: Times, slope: float) -> NDArray[np.bool_]:
    """Of the events with the same number, the one nearest to the line."""
    order = np.lexsort((np.abs(since - slope * numbers), numbers))
    _, first = np.unique(numbers[order], return_index=True)
    kept = np.zeros(numbers.size, bool)
    kept[order[first]] = True
    return kept


def _laid_over(
    camera: _Grid, stamps: _Grid, exposed: Times, first_was_seen: bool
) -> tuple[_Grid, Literal["first pulse", "shortest delay", "gaps"]]:
    """The camera's grid in the numbers of the stamps, and what that rests on.

    The first frame has the first pulse if the probe sampled before that, for the cameras were armed before the
    trigger source; else the delay is taken to be the shortest that is possible. Another offset must explain the
    gaps clearly better.
    """
    stamped = stamps.numbers[stamps.kept]
    # In stamps' numbers, frames taken to have no delay.
    by_time = round((camera.times_ns[0] - stamps.at(stamped[:1])[0]) / stamps.slope) + int(stamped[0])
    shortest = by_time - int(camera.numbers[0])
    reach = int(_LARGEST_DELAY_NS / stamps.slope) + 1
    offsets = range(shortest - reach, shortest + reach + 1)
    usual = int(stamped[0] - exposed[0]) if first_was_seen else shortest
    usual = min(max(usual, offsets[0]), offsets[-1])
    misfits = {offset: _misfits(exposed + offset, stamped) for offset in offsets}
    best = min(offsets, key=lambda offset: (misfits[offset], abs(offset - usual)))
    by_gaps = misfits[best] + _CLEARLY_BETTER <= misfits[usual]
    offset = best if by_gaps else usual
    moved = replace(
        camera, numbers=camera.numbers + offset, intercept=camera.intercept - camera.slope * offset
    )
    return moved, "gaps" if by_gaps else "first pulse" if first_was_seen else "shortest delay"


def _misfits(exposed: Times, stamped: Times) -> int:
    """Exposures without pulse and pulses without exposure, where both devices were there."""
    first, last = max(exposed[0], stamped[0]), min(exposed[-1], stamped[-1])
    both = [one[(one >= first) & (one <= last)] for one in (exposed, stamped)]
    return int(np.setxor1d(*both).size)


def _exposed(camera: CameraEvidence, grid: _Grid) -> Times:
    """Numbers of the exposures of a camera: of its frames, and of those that its counter says it made besides."""
    numbers = grid.numbers[grid.kept]
    if camera.sequence is None:
        return np.unique(numbers)
    counted = np.diff(camera.sequence[grid.kept])
    whole = np.flatnonzero((np.diff(numbers) > 1) & (counted == np.diff(numbers)))
    between = [np.arange(numbers[place] + 1, numbers[place + 1]) for place in whole]
    return np.unique(np.concatenate([numbers, *between]))


def _frames(frames: FrameTimes, grid: _Grid, stamps: _Grid, times_ns: Times, first: int) -> LineFrames:
    """Frames with number and time of their pulse; one that was not stamped has its time from the grid."""
    trigger_ns = np.rint(stamps.at(grid.numbers)).astype(np.int64)
    _, mine, theirs = np.intersect1d(
        grid.numbers[grid.kept], stamps.numbers[stamps.kept], return_indices=True
    )
    trigger_ns[np.flatnonzero(grid.kept)[mine]] = times_ns[stamps.kept][theirs]
    return LineFrames(
        trigger_index=np.where(grid.kept, grid.numbers - first, -1),
        # Negative times are unknown ones; a pulse at the very start may come out before it.
        trigger_ns=np.where(grid.kept, np.maximum(trigger_ns, 0), -1),
        ticks=frames.ticks,
        host_ns=frames.host_ns,
    )


def _losses(camera: CameraEvidence, grid: _Grid, seen: Times) -> dict[str, Any]:
    """Pulses without a frame: overlooked where the camera's counter went on by 1, else lost after exposure."""
    place = np.searchsorted(seen, grid.numbers[grid.kept])
    order = np.argsort(place, kind="stable")
    missing = np.diff(place[order]) - 1
    overlooked = 0
    if camera.sequence is not None:
        counted = np.diff(camera.sequence[grid.kept][order]) - 1
        overlooked = int(np.sum(missing - np.clip(counted, 0, missing)))
    return {
        "frames": int(grid.kept.sum()),
        "lost": int(seen.size - place.size) - overlooked,
        "overlooked": overlooked,
        "extra": int((~grid.kept).sum()),
        "rms_ns": float(np.std(grid.residual_ns()[grid.kept])),
    }
