"""Which pairs of a run are reconstructed, with which calibration, and whether the two fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import FrameFlag
from thermacq.errors import ReconstructionError
from thermacq.store import FrameTable, RunFile, frame_times
from thermacq.timing import NS_PER_S, DeviceTimes, fit_device_clock, pair_frames
from thermacq_calibration import StereoCalibration, load_calibration


@dataclass(frozen=True)
class RunPairs:
    """Pairs of a run in the order of time.

    Parameters
    ----------
    left_camera, right_camera
        Names in the rig.
    left, right
        (pairs,) positions of the frames.
    time_s
        (pairs,) float64, seconds since the start of the recording.
    left_out
        Pairs not used because a frame was incomplete or behind the closed shutter.
    """

    left_camera: str
    right_camera: str
    left: NDArray[np.intp]
    right: NDArray[np.intp]
    time_s: NDArray[np.float64]
    left_out: int

    def __len__(self) -> int:
        return self.left.size

    def select(self, chosen: slice | NDArray[np.intp]) -> RunPairs:
        """Some of the pairs."""
        return RunPairs(
            self.left_camera,
            self.right_camera,
            self.left[chosen],
            self.right[chosen],
            self.time_s[chosen],
            self.left_out,
        )


def camera_sides(run: RunFile, pair: str | None = None) -> tuple[str, str]:
    """Names of the left and the right camera of a pair.

    Parameters
    ----------
    run
        The run.
    pair
        A pair of the rig's ``[pairs]``, or two cameras as ``LEFT,RIGHT``. None: the first pair of the rig;
        without ``[pairs]`` the cameras ``left`` and ``right``, else the first two.

    Raises
    ------
    ReconstructionError
        There is no such pair, or the run has fewer than two cameras.
    """
    pairs = run.rig.pairs
    if pair is not None or pairs:
        return _named_pair(run, next(iter(pairs)) if pair is None else pair)
    if {"left", "right"} <= set(run.cameras):
        return "left", "right"
    if len(run.cameras) < 2:
        raise ReconstructionError(
            f"'{run.path}' has {len(run.cameras)} camera(s); stereo needs two",
            remedy="Record or import both cameras into one run.",
        )
    return run.cameras[0], run.cameras[1]


def _named_pair(run: RunFile, pair: str) -> tuple[str, str]:
    if pair in run.rig.pairs:
        sides = (run.rig.pairs[pair].left, run.rig.pairs[pair].right)
    else:
        left, _, right = pair.partition(",")
        sides = (left.strip(), right.strip())
    if sides[0] == sides[1] or not set(sides) <= set(run.cameras):
        known = ", ".join(run.rig.pairs) or "none: its rig has no [pairs]"
        raise ReconstructionError(
            f"'{run.path}' has no pair '{pair}' (pairs: {known}; cameras: {', '.join(run.cameras)})",
            remedy="Name a pair of the rig, or two cameras: --pair LEFT,RIGHT.",
        )
    return sides


def run_pairs(run: RunFile, pair: str | None = None) -> RunPairs:
    """Pair the frames of two cameras of a run by trigger index, else by device time.

    `pair` is as in `camera_sides`.

    Raises
    ------
    ReconstructionError
        No frame of one camera has a partner of the other.
    """
    names = camera_sides(run, pair)
    tables = [run.frames(name) for name in names]
    clocks = [_clock(run, name, table) for name, table in zip(names, tables, strict=True)]
    times = frame_times(run, names)
    pairs = pair_frames(times[0], times[1], clocks[0], clocks[1])
    if pairs.left.size == 0:
        counts = ", ".join(
            f"'{name}' has {len(table)} frames" for name, table in zip(names, tables, strict=True)
        )
        raise ReconstructionError(
            f"no frames of '{run.path}' belong together ({counts}; paired by {pairs.paired_by})",
            remedy="`thermacq info` shows what was recorded.",
        )
    spoilt = int(FrameFlag.INCOMPLETE | FrameFlag.SHUTTER)
    good = ((tables[0].flags[pairs.left] | tables[1].flags[pairs.right]) & spoilt) == 0
    if not good.any():
        raise ReconstructionError(
            f"all {good.size} pairs of '{run.path}' are incomplete or behind a closed shutter"
        )
    return RunPairs(
        *names,
        left=pairs.left[good],
        right=pairs.right[good],
        time_s=(pairs.time_ns[good] - run.header.host_anchor_ns) / NS_PER_S,
        left_out=int((~good).sum()),
    )


def select_frames(pairs: RunPairs, frames: str | None) -> RunPairs:
    """Pairs ``A:B`` (from A up to, not with, B; either may be empty; negative counts from the end).

    Raises
    ------
    ReconstructionError
        The text is no range, or selects nothing.
    """
    if frames is None:
        return pairs
    try:
        first, _, last = frames.partition(":")
        if ":" not in frames:
            raise ValueError(frames)
        chosen = pairs.select(slice(int(first) if first else None, int(last) if last else None))
    except ValueError:
        raise ReconstructionError(f"'{frames}' is no range of pairs", remedy="Write 0:100 or 50:.") from None
    if len(chosen) == 0:
        raise ReconstructionError(f"range {frames} holds none of the run's {len(pairs)} pairs")
    return chosen


def find_calibration(run: RunFile, given: Path | None, pair: str | None = None) -> StereoCalibration:
    """The calibration that was given, else the one stored with the run; checked against its pictures.

    `pair` is as in `camera_sides`.

    Raises
    ------
    ReconstructionError
        There is none, or it belongs to another rig.
    thermacq_calibration.CalibrationError
        The given or stored record is damaged.
    """
    stored = run.calibration()
    if given is not None:
        calibration = load_calibration(given)
    elif stored is not None:
        calibration = StereoCalibration.from_dict(stored)
    else:
        raise ReconstructionError(
            f"'{run.path}' holds no calibration", remedy="Give one with --calibration CALIBRATION.json."
        )
    columns, rows = calibration.image_size
    for name in camera_sides(run, pair):
        stream = run.camera(name)
        if (stream.columns, stream.rows) != (columns, rows):
            raise ReconstructionError(
                f"the calibration belongs to another rig: it is for pictures of {columns} x {rows}, "
                f"camera '{name}' of '{run.path}' has {stream.columns} x {stream.rows}",
                remedy="Use the calibration of these cameras.",
            )
    _check_serials(run, calibration, pair)
    return calibration


def camera_serials(run: RunFile, pair: str | None = None) -> tuple[str, str] | None:
    """Serial numbers of the left and the right camera, None unless both are known."""
    left, right = (run.camera(name).serial for name in camera_sides(run, pair))
    return (left, right) if left and right else None


def _check_serials(run: RunFile, calibration: StereoCalibration, pair: str | None) -> None:
    found, wanted = camera_serials(run, pair), calibration.serials
    if found is None or wanted is None or found == wanted:
        return
    what = "with left and right exchanged" if found == wanted[::-1] else "of other cameras"
    raise ReconstructionError(
        f"the calibration is {what}: it is for left {wanted[0]}, right {wanted[1]}; "
        f"'{run.path}' has left {found[0]}, right {found[1]}",
        remedy="Use the calibration of these cameras.",
    )


def _clock(run: RunFile, camera: str, table: FrameTable) -> DeviceTimes | None:
    rate_hz = float(run.camera(camera).capabilities.get("tick_rate_hz") or 0.0)
    known = table.ticks >= 0
    if rate_hz <= 0 or not known.any():
        return None
    return fit_device_clock(table.ticks[known], table.host_ns[known], rate_hz, table.restarts_ns)
