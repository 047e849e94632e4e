"""Find the steps of a static probe calibration in its record: levels between which the probe was moved.

The number of steps is known (their immersions are written down while calibrating), so the record is cut into
that many pieces of constant level with the least squared deviation, exactly, by dynamic programming (Bellman &
Roth 1969, curve fitting by segmented straight lines). Of each piece the beginning and the end are left out:
the probe was still moving there, or the water was.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.models import Float

_BINS = 800
_LEAST_SAMPLES = 20
"""Samples that a step needs at least."""
_SETTLING, _LEAVING = 0.30, 0.15
"""Shares of a piece left out at its beginning and at its end."""
_BLOCKS = 8
_SHORTEST = 0.2
"""A step lasts for at least this share of the mean step; shorter pieces would be the moves between steps."""
_MOST_MISSING = 0.2
_CLEAR = 5.0
"""Neighbouring levels differ by this many standard uncertainties, or they are one level."""
_CLEAR_SHARE = 0.05
_STEADY_SHARE = 0.25


@dataclass(frozen=True)
class StepReading:
    """One position of the probe.

    Parameters
    ----------
    immersion_m
        Depth to which it was lowered, from its position in still water.
    raw
        Mean raw value.
    raw_u
        Standard uncertainty of the mean, from the scatter of means over eighths of the step: slow swinging
        of the water counts, as it does not in the scatter of samples over the root of their number.
    start_s, stop_s
        What was used of the record; both 0 for readings that were given.
    samples
        Number of samples used.
    """

    immersion_m: float
    raw: float
    raw_u: float
    start_s: float = 0.0
    stop_s: float = 0.0
    samples: int = 1


def find_steps(time_s: Float, raw: Float, immersions_m: Float) -> list[StepReading]:
    """Readings of the steps of a record.

    Parameters
    ----------
    time_s
        (samples,) seconds, increasing.
    raw
        (samples,) raw values, NaN where missing.
    immersions_m
        (steps,) depths in the order in which the probe was moved.

    Raises
    ------
    CalibrationError
        Too much is missing, or the record does not hold that many steps, or holds more.
    """
    count = len(immersions_m)
    known = np.isfinite(raw) & np.isfinite(time_s)
    missing = 1.0 - float(known.mean()) if known.size else 1.0
    if missing > _MOST_MISSING:
        raise CalibrationError(
            f"{100 * missing:.0f} % of the {known.size} samples of the record are missing (NaN)",
            kept="No file was written.",
            remedy="Look at the wiring of the probe and record again.",
        )
    time, values = time_s[known], raw[known]
    if values.size < _LEAST_SAMPLES * count:
        raise CalibrationError(
            f"the record holds {values.size} samples, too few for {count} steps of {_LEAST_SAMPLES} or more",
            kept="No file was written.",
            remedy="Record for longer at each step.",
        )
    edges = _segments(values, count)
    steps = [
        _reading(float(immersion), time, values, slice(*edge))
        for immersion, edge in zip(immersions_m, edges, strict=True)
    ]
    _require_distinct(steps)
    _require_steady(steps, values, edges)
    return steps


def _segments(values: Float, count: int) -> list[tuple[int, int]]:
    """First and last-but-one sample of each piece of constant level."""
    edges = np.linspace(0, values.size, min(_BINS, values.size) + 1).round().astype(np.intp)
    sizes = np.diff(edges).astype(np.float64)
    means = np.add.reduceat(values, edges[:-1]) / sizes
    means = means - means.mean()
    n, s, q = (np.concatenate([[0.0], np.cumsum(v)]) for v in (sizes, sizes * means, sizes * means**2))
    bins = sizes.size
    shortest = max(1, round(_SHORTEST * bins / count))

    def cost(first: np.ndarray, last: int) -> Float:
        deviation: Float = q[last] - q[first] - (s[last] - s[first]) ** 2 / (n[last] - n[first])
        return deviation

    best = np.full(bins + 1, np.inf)
    best[1:] = [float(cost(np.array([0]), last)[0]) for last in range(1, bins + 1)]
    origins = []
    for pieces in range(2, count + 1):
        better, origin = np.full(bins + 1, np.inf), np.zeros(bins + 1, np.intp)
        for last in range(pieces * shortest, bins + 1):
            first = np.arange((pieces - 1) * shortest, last - shortest + 1)
            total = best[first] + cost(first, last)
            chosen = int(np.argmin(total))
            better[last], origin[last] = total[chosen], first[chosen]
        best = better
        origins.append(origin)
    cuts = [bins]
    for origin in reversed(origins):
        cuts.append(int(origin[cuts[-1]]))
    places = [0, *(int(edges[cut]) for cut in reversed(cuts))]
    return list(pairwise(places))


def _core(piece: slice) -> slice:
    length = piece.stop - piece.start
    return slice(piece.start + round(_SETTLING * length), piece.stop - round(_LEAVING * length))


def _block_means(values: Float) -> Float:
    return np.array([block.mean() for block in np.array_split(values, min(_BLOCKS, values.size))])


def _reading(immersion_m: float, time_s: Float, values: Float, piece: slice) -> StepReading:
    core = _core(piece)
    used = values[core]
    if used.size < 2:
        raise CalibrationError(
            f"a step of the record lasts for {piece.stop - piece.start} samples only: its level cannot be told",
            kept="No file was written.",
            remedy="Stay longer at each step, or correct the list of immersions.",
        )
    means = _block_means(used)
    uncertainty = float(means.std(ddof=1) / np.sqrt(means.size))
    times = time_s[core]
    return StepReading(
        immersion_m, float(used.mean()), uncertainty, float(times[0]), float(times[-1]), used.size
    )


def _require_distinct(steps: list[StepReading]) -> None:
    """Neighbouring levels must differ by more than noise, or the list is longer than the record."""
    if len(steps) < 2:
        return
    levels = np.array([step.raw for step in steps])
    uncertainty = np.array([step.raw_u for step in steps])
    moved = np.abs(np.diff(levels))
    least = np.maximum(
        _CLEAR * np.hypot(uncertainty[1:], uncertainty[:-1]), _CLEAR_SHARE * float(np.median(moved))
    )
    if (moved <= least).any():
        raise CalibrationError(
            f"the list has {len(steps)} immersions, but the record does not hold that many levels that can be "
            "told apart",
            kept="No file was written.",
            remedy="Correct the list; if it is right, the record is too noisy or too short for steps this small.",
        )


def _require_steady(steps: list[StepReading], values: Float, edges: list[tuple[int, int]]) -> None:
    """No piece may hold two levels, or the record is longer than the list."""
    smallest = min(abs(b.raw - a.raw) for a, b in pairwise(steps)) if len(steps) > 1 else 0
    for number, (step, edge) in enumerate(zip(steps, edges, strict=True), start=1):
        swing = float(np.ptp(_block_means(values[_core(slice(*edge))])))
        if len(steps) > 1 and swing > _STEADY_SHARE * smallest:
            raise CalibrationError(
                f"step {number} of {len(steps)} ({step.start_s:.1f} to {step.stop_s:.1f} s) does not stand still: "
                f"it wanders by {swing:.4g}, a quarter or more of the smallest step of {smallest:.4g}",
                kept="No file was written.",
                remedy="Count the steps of the record: it may hold more than the list, or fewer; or the water was not at "
                "rest.",
            )


def given_steps(immersions_m: Float, raw: Float) -> list[StepReading]:
    """Readings from a table: one or several rows for each immersion; rows of one step stand together.

    Raises
    ------
    CalibrationError
        A row lacks its immersion, or a step has no reading at all.
    """
    if not np.isfinite(immersions_m).all():
        row = int(np.argmin(np.isfinite(immersions_m))) + 1
        raise CalibrationError(f"row {row} of the table has no immersion", kept="No file was written.")
    first = np.flatnonzero(np.diff(immersions_m, prepend=np.nan) != 0)
    steps = []
    for start, stop in pairwise([*first.tolist(), immersions_m.size]):
        readings = raw[start:stop][np.isfinite(raw[start:stop])]
        if readings.size == 0:
            raise CalibrationError(
                f"the step at {immersions_m[start]:g} m has no raw value (row {start + 1})",
                kept="No file was written.",
            )
        several = readings.size > 1
        uncertainty = float(readings.std(ddof=1) / np.sqrt(readings.size)) if several else 0.0
        steps.append(
            StepReading(
                float(immersions_m[start]), float(readings.mean()), uncertainty, samples=readings.size
            )
        )
    return steps
