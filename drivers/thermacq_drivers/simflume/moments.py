"""Quantities that are cheap for many points at one moment, asked at times that differ from point to point.

The rows of a rolling read-out are a few milliseconds apart: there a polynomial through a few moments in between
is exact enough. Other times (samples of a probe, frames of a truth file) are taken one by one.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from thermacq_drivers.simflume.surfaces import Floats

_ERROR_M = 1e-8
_MOST_NODES = 8
_FEW_POINTS = 128


def nodes_in_time(time_s: Floats, amplitude_m: Floats, omega_rad_s: Floats) -> Floats | None:
    """Chebyshev nodes through which waves can be interpolated to these times within 1e-8 m.

    Parameters
    ----------
    time_s
        Times, any shape.
    amplitude_m, omega_rad_s
        (waves,) amplitudes and angular frequencies.

    Returns
    -------
    numpy.ndarray or None
        (nodes,) float64 seconds; None when the times are too far apart, or too few to be worth it.
    """
    low, high = float(time_s.min()), float(time_s.max())
    if time_s.size < _FEW_POINTS:
        return None
    if low == high:
        return np.array([low])
    turn = np.abs(omega_rad_s) * (high - low) / 2
    for count in range(2, _MOST_NODES + 1):
        error_m = float(np.abs(amplitude_m) @ turn**count) / (math.factorial(count) * 2 ** (count - 1))
        if error_m < _ERROR_M:
            angle = (np.arange(count) + 0.5) * math.pi / count
            return np.asarray((low + high) / 2 + (high - low) / 2 * np.cos(angle), np.float64)
    return None


def interpolate_in_time(at_moment: Callable[[float], Floats], nodes_s: Floats, time_s: Floats) -> Floats:
    """Values at times (...), from `at_moment`, which gives all points (...) at one moment."""
    total = np.zeros(time_s.shape)
    for place, node in enumerate(nodes_s):
        others = np.delete(nodes_s, place)
        weight = np.ones(time_s.shape)
        for other in others:
            weight *= (time_s - other) / (node - other)
        total += weight * at_moment(float(node))
    return total


def one_by_one(
    at_moment: Callable[[Floats, Floats, float], Floats], x_m: Floats, y_m: Floats, time_s: Floats
) -> Floats:
    """Values at points and times of one shape, moment by moment; `at_moment` takes points (points,)."""
    values = np.empty(time_s.shape)
    moments, member = np.unique(time_s, return_inverse=True)
    order = np.argsort(member, axis=None, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(member.ravel()))[:-1])
    for moment, group in zip(moments, groups, strict=True):
        values.flat[group] = at_moment(x_m.ravel()[group], y_m.ravel()[group], float(moment))
    return values
