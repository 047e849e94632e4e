"""Which views show the same pose of the board: repeating a pose averages noise and teaches nothing else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.models import Float

# Two poses are the same when the board turned by less than this and its middle moved by less than this part of
# its distance (at 0.65 m: 2 cm), which moves its corners by a few of their spacings at most.
SAME_TURN_DEG = 3.0
SAME_SHIFT = 0.03


def groups_of_poses(rotations: Float, middles_m: Float) -> NDArray[np.intp]:
    """Number of the first view that shows the same pose, for each view.

    Parameters
    ----------
    rotations
        (views, 3, 3), board to left camera.
    middles_m
        (views, 3) middle of the board in the left camera's frame.

    Returns
    -------
    numpy.ndarray
        (views,) indices; so many different ones, so many poses.
    """
    groups = np.arange(len(rotations))
    for view in range(1, len(rotations)):
        traces = np.einsum("nij,ij->n", rotations[:view], rotations[view])
        turns_deg = np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))
        shifts = np.linalg.norm(middles_m[:view] - middles_m[view], axis=1) / np.linalg.norm(middles_m[view])
        same = np.flatnonzero((turns_deg < SAME_TURN_DEG) & (shifts < SAME_SHIFT))
        if same.size:
            groups[view] = groups[same[0]]
    return groups
