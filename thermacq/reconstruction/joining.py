"""The world frame of a second pair of cameras put into that of the first: by a shared board, or by the water.

Height and tilt of each pair come from its own still water, which knows them ten times better than any board. What
still water cannot tell is taken from the other pair: the place of the camera along and across the flume, and
the direction of X.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.shared_board import BoardCorners, common_corners
from thermacq.reconstruction.world import WorldFrame
from thermacq_calibration import StereoCalibration
from thermacq_calibration.geometry.rigid_motion import RigidMotion, fit_rigid_motion

_STEP = 1e-6
_DOUBTFUL = 4.0


@dataclass(frozen=True)
class Placing:
    """Where the left camera of a second pair stands in the world frame of the first.

    Parameters
    ----------
    x_m, y_m
        Its place.
    yaw_rad
        Direction of X of the first frame, seen in the second: from its X towards its Y.
    covariance
        (3, 3) of x, y (m) and yaw (rad).
    source
        How it was found, as plain values.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    covariance: NDArray[np.float64]
    source: dict[str, Any]


def joined_frame(first: WorldFrame, second: WorldFrame, placing: Placing) -> WorldFrame:
    """The second frame with origin and X of the first; height and tilt stay its own."""
    cosine, sine = np.cos(placing.yaw_rad), np.sin(placing.yaw_rad)
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    slopes = np.eye(3)
    slopes[1:, 1:] = turn[:2, :2]
    x_u, y_u, yaw_u = np.sqrt(np.diag(placing.covariance))
    joined = {
        "to_calibration_sha256": first.source.get("calibration_sha256"),
        "x_u_m": float(x_u),
        "y_u_m": float(y_u),
        "yaw_u_deg": float(np.degrees(yaw_u)),
        **placing.source,
    }
    return dataclasses.replace(
        second,
        rotation=turn @ second.rotation,
        translation_m=np.array([placing.x_m, placing.y_m, second.camera_height_m]),
        covariance=slopes @ second.covariance @ slopes.T,
        x_axis_u_deg=float(np.hypot(np.degrees(yaw_u), first.x_axis_u_deg or 0.0)),
        source={**second.source, "joined": joined},
    )


def scale_uncertainty(calibration: StereoCalibration) -> float:
    """Relative standard uncertainty of depth at the working distance; 0 where the record states none."""
    depth_m, distance_m = calibration.standard_uncertainty("depth_m"), calibration.working_distance_m
    return 0.0 if depth_m is None or distance_m is None else depth_m / distance_m


def motion_between(
    first: Sequence[BoardCorners],
    second: Sequence[BoardCorners],
    scales: tuple[float, float] = (0.0, 0.0),
) -> tuple[RigidMotion, list[str]]:
    """Rigid motion that takes points of the second pair's camera to the first's, from shared views of a board.

    Views whose corners miss each other by more than four times the median are left out, and named.

    Parameters
    ----------
    first, second
        Corners as each pair sees them.
    scales
        Relative standard uncertainties of the lengths that each pair measures, see `scale_uncertainty`. A wrong
        scale moves the board along its direction from the camera, in all views alike, which no scatter shows.

    Raises
    ------
    ReconstructionError
        There is no shared view.
    """
    shared = common_corners(list(first), list(second))
    # One wrong view would tear the common fit; so each view alone proposes a motion and the others vote.
    proposals = [_fit([pair]) for pair in shared]
    misfits = np.array([[_misfit(*pair, motion) for pair in shared] for motion in proposals])
    misfit = misfits[np.argmin(np.median(misfits, axis=1))]
    kept = misfit <= 4 * max(float(np.median(misfit)), 1e-9)
    left_out = [
        f"view {one.frames.start}-{one.frames.stop - 1} left out: its corners miss each other by "
        f"{1000 * off:.1f} mm"
        for (one, _), off, keep in zip(shared, misfit, kept, strict=True)
        if not keep
    ]
    good = [pair for pair, keep in zip(shared, kept, strict=True) if keep]
    return _with_scales(_fit(good), good, scales), left_out


def placing_by_board(first: WorldFrame, second: WorldFrame, motion: RigidMotion) -> tuple[Placing, list[str]]:
    """Place of the second camera by the motion between the pairs, and sentences on what does not agree."""
    place = _place(first, second, motion.rotation, motion.translation_m)
    derivative = np.stack(
        [(_moved(first, second, motion, axis) - place) / _STEP for axis in range(6)], axis=1
    )
    covariance = derivative @ motion.covariance @ derivative.T
    # Whether the board sees the water of both pairs where still water saw it.
    higher = float(place[2]) - second.camera_height_m
    up = first.rotation @ motion.rotation @ second.rotation[2]
    tilted = float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))))
    higher_u = float(
        np.sqrt(covariance[2, 2] + np.nan_to_num(first.covariance[0, 0] + second.covariance[0, 0]))
    )
    doubts = []
    if abs(higher) > max(_DOUBTFUL * higher_u, 0.003):
        doubts.append(
            f"by the board the second camera is {1000 * higher:+.1f} mm higher than by its still water: the water "
            "level, a camera or the size of the squares changed between the records"
        )
    if tilted > 0.5:
        doubts.append(f"by the board the two still-water planes are inclined to each other by {tilted:.2f}°")
    source = {
        "by": "board",
        "views": motion.views,
        "corners": motion.points,
        "residual_rms_m": motion.rms_m,
        "height_difference_m": higher,
        "height_difference_u_m": higher_u,
        "tilt_difference_deg": tilted,
        "rotation": motion.rotation.tolist(),
        "translation_m": motion.translation_m.tolist(),
        "motion_covariance": motion.covariance.tolist(),
    }
    chosen = np.ix_([0, 1, 3], [0, 1, 3])
    return Placing(float(place[0]), float(place[1]), float(place[3]), covariance[chosen], source), doubts


def require_calibration(frame: WorldFrame, sha256: str, which: str) -> None:
    """Refuse a world frame that belongs to another calibration; raises `ReconstructionError`."""
    if frame.source.get("calibration_sha256") != sha256:
        raise ReconstructionError(
            f"the world frame of the {which} pair was found with another calibration than the one given",
            remedy="Give world frames and calibrations in the same order, that of --pair.",
        )


def _fit(shared: Sequence[tuple[BoardCorners, BoardCorners]]) -> RigidMotion:
    view = np.repeat(np.arange(len(shared)), [one.indices.size for one, _ in shared])
    target, target_covariance = _stacked([one for one, _ in shared])
    source, source_covariance = _stacked([other for _, other in shared])
    return fit_rigid_motion(source, target, source_covariance, target_covariance, view)


def _with_scales(
    motion: RigidMotion, shared: Sequence[tuple[BoardCorners, BoardCorners]], scales: tuple[float, float]
) -> RigidMotion:
    """With what the uncertain scales of both pairs add to the covariance of the translation."""
    from_first = np.concatenate([one.points_m for one, _ in shared]).mean(axis=0)
    from_second = from_first - motion.translation_m
    covariance = motion.covariance.copy()
    for scale, arm in zip(scales, (from_first, from_second), strict=True):
        covariance[3:, 3:] += scale**2 * np.outer(arm, arm)
    return dataclasses.replace(motion, covariance=covariance)


def _stacked(views: Sequence[BoardCorners]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.concatenate([one.points_m for one in views]), np.concatenate([one.covariance for one in views])


def _misfit(one: BoardCorners, other: BoardCorners, motion: RigidMotion) -> float:
    off = one.points_m - motion.apply(other.points_m)
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _place(
    first: WorldFrame, second: WorldFrame, rotation: NDArray[np.float64], translation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """x, y, z of the second camera in the first frame, and yaw of the first frame's X in the second."""
    ahead = second.rotation @ rotation.T @ first.rotation[0]
    camera = first.rotation @ translation + first.translation_m
    return np.append(camera, np.arctan2(ahead[1], ahead[0]))


def _moved(first: WorldFrame, second: WorldFrame, motion: RigidMotion, axis: int) -> NDArray[np.float64]:
    """`_place` with one of the six parameters of the motion moved by a small step."""
    step = np.zeros(6)
    step[axis] = _STEP
    x, y, z = step[:3]
    turn = np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return _place(first, second, turn @ motion.rotation, motion.translation_m + step[3:])
