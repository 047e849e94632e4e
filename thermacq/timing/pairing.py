"""Which frame of the left camera belongs to which frame of the right one.

Frames are paired by trigger index, else by device time, never by the order of their arrival. A frame
without a partner is listed, not dropped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from thermacq.timing.restarts import DeviceTimes

Indices = NDArray[np.intp]
Times = NDArray[np.int64]


class FrameTimes(Protocol):
    """Times of the frames of one camera, (frames,) int64 each; -1 where unknown."""

    @property
    def trigger_index(self) -> Times:
        """Index of the trigger that made the frame."""
        ...

    @property
    def trigger_ns(self) -> Times:
        """Host time of that trigger."""
        ...

    @property
    def ticks(self) -> Times:
        """Device clock at the start of exposure."""
        ...

    @property
    def host_ns(self) -> Times:
        """Host time of receipt."""
        ...


@dataclass(frozen=True)
class Pairs:
    """Pairs of frames, in the order of time.

    Parameters
    ----------
    left, right
        (pairs,) positions in the two frame tables.
    trigger_index
        (pairs,) int64, -1 when paired by device time.
    time_ns
        (pairs,) int64, host time of the left frame.
    skew_ns
        (pairs,) int64, time of the right frame minus time of the left.
    unpaired_left, unpaired_right
        Positions of the frames without a partner.
    paired_by
        ``trigger index``, ``device time``, or ``nothing`` when neither is known.
    """

    left: Indices
    right: Indices
    trigger_index: Times
    time_ns: Times
    skew_ns: Times
    unpaired_left: Indices
    unpaired_right: Indices
    paired_by: str


def pair_frames(
    left: FrameTimes,
    right: FrameTimes,
    left_clock: DeviceTimes | None = None,
    right_clock: DeviceTimes | None = None,
    tolerance_ns: int | None = None,
) -> Pairs:
    """Pair the frames of two cameras.

    Parameters
    ----------
    left, right
        Times of the frames of the two cameras.
    left_clock, right_clock
        Models of the cameras' clocks; needed when the frames carry no trigger index.
    tolerance_ns
        Largest skew of a pair by device time; default: half the median frame interval of the left camera.
    """
    if np.any(left.trigger_index >= 0) and np.any(right.trigger_index >= 0):
        i, j = _by_index(left.trigger_index, right.trigger_index)
        paired_by = "trigger index"
    elif left_clock and right_clock and np.any(left.ticks >= 0) and np.any(right.ticks >= 0):
        i, j = _by_time(left, right, left_clock, right_clock, tolerance_ns)
        paired_by = "device time"
    else:
        i = j = np.empty(0, np.intp)
        paired_by = "nothing"
    time_left = frame_times_ns(left, left_clock)
    time_right = frame_times_ns(right, right_clock)
    return Pairs(
        left=i,
        right=j,
        trigger_index=left.trigger_index[i],
        time_ns=time_left[i],
        skew_ns=time_right[j] - time_left[i],
        unpaired_left=np.setdiff1d(np.arange(left.host_ns.size), i),
        unpaired_right=np.setdiff1d(np.arange(right.host_ns.size), j),
        paired_by=paired_by,
    )


def frame_times_ns(frames: FrameTimes, clock: DeviceTimes | None = None) -> Times:
    """Best known host time of each frame: its trigger, else its device time, else its receipt."""
    times = np.array(frames.host_ns, np.int64)
    if clock is not None:
        ticked = frames.ticks >= 0
        times[ticked] = clock.times_of(frames.ticks[ticked], frames.host_ns[ticked])
    triggered = frames.trigger_ns >= 0
    times[triggered] = frames.trigger_ns[triggered]
    return times


def _by_index(left: Times, right: Times) -> tuple[Indices, Indices]:
    """Equal trigger indices; of frames that claim the same index the first one has it."""
    indices_left, first_left = np.unique(left, return_index=True)
    indices_right, first_right = np.unique(right, return_index=True)
    common, i, j = np.intersect1d(indices_left, indices_right, assume_unique=True, return_indices=True)
    known = common >= 0
    return first_left[i[known]], first_right[j[known]]


def _by_time(
    left: FrameTimes,
    right: FrameTimes,
    left_clock: DeviceTimes,
    right_clock: DeviceTimes,
    tolerance_ns: int | None,
) -> tuple[Indices, Indices]:
    """Frames that are each other's nearest in device time, within the tolerance."""
    ticked_left, ticked_right = np.flatnonzero(left.ticks >= 0), np.flatnonzero(right.ticks >= 0)
    a = left_clock.times_of(left.ticks[ticked_left], left.host_ns[ticked_left])
    b = right_clock.times_of(right.ticks[ticked_right], right.host_ns[ticked_right])
    order_a, order_b = np.argsort(a, kind="stable"), np.argsort(b, kind="stable")
    a, b = a[order_a], b[order_b]
    if tolerance_ns is None:
        tolerance_ns = int(np.median(np.diff(a))) // 2 if a.size > 1 else 0
    partner = _nearest(a, b)
    mutual = _nearest(b, a)[partner] == np.arange(a.size)
    keep = np.flatnonzero(mutual & (np.abs(b[partner] - a) <= tolerance_ns))
    return ticked_left[order_a[keep]], ticked_right[order_b[partner[keep]]]


def _nearest(wanted: Times, among: Times) -> Indices:
    """Position of the nearest of the sorted values `among` for each of `wanted`."""
    right = np.searchsorted(among, wanted)
    below, above = np.clip(right - 1, 0, None), np.clip(right, None, among.size - 1)
    return np.where(wanted - among[below] <= among[above] - wanted, below, above)
