"""Clocks of devices that were unplugged and came back: one model for each stretch, none across a restart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermacq.timing.models import ClockModel, fit_clock, fit_clock_to_pulses


@dataclass(frozen=True)
class RestartedClock:
    """Models of a clock that began anew during the recording, one for each stretch between restarts.

    Parameters
    ----------
    starts_ns
        Host times at which the second and later stretches begin, increasing.
    models
        The model of each stretch; one more than `starts_ns`.
    """

    starts_ns: tuple[int, ...]
    models: tuple[ClockModel, ...]

    @property
    def longest(self) -> ClockModel:
        """Model that rests on most points: what is best known of the clock."""
        return max(self.models, key=lambda model: model.points)

    @property
    def method(self) -> str:
        """Method of the longest stretch."""
        return self.longest.method

    @property
    def drift_ppm(self) -> float:
        """Drift in the longest stretch."""
        return self.longest.drift_ppm

    @property
    def residual_ns(self) -> float:
        """Residual of the longest stretch."""
        return self.longest.residual_ns

    def times_of(self, ticks: ArrayLike, received_ns: ArrayLike) -> NDArray[np.int64]:
        """Host time of device ticks, (n,) integers, received at these host times: (n,) int64 nanoseconds."""
        ticks = np.asarray(ticks, np.int64)
        stretch = np.searchsorted(np.array(self.starts_ns, np.int64), np.asarray(received_ns), side="right")
        times = np.empty(ticks.shape, np.int64)
        for number, model in enumerate(self.models):
            times[stretch == number] = model.to_host_ns(ticks[stretch == number])
        return times

    def to_dict(self) -> dict[str, Any]:
        """Values of the longest stretch, and all of them under ``stretches``."""
        starts = (None, *self.starts_ns)
        stretches = [
            {"from_ns": start, **model.to_dict()} for start, model in zip(starts, self.models, strict=True)
        ]
        return {**self.longest.to_dict(), "stretches": stretches}


DeviceTimes: TypeAlias = ClockModel | RestartedClock
"""What is known of a device clock."""


def fit_device_clock(
    device_ticks: ArrayLike,
    received_ns: ArrayLike,
    tick_rate_hz: float,
    restarts_ns: ArrayLike = (),
    pulse_ticks: ArrayLike = (),
    trigger_ns: ArrayLike = (),
) -> DeviceTimes:
    """Fit a device clock that may have begun anew, from its pulses where it stamped any, else from receipt times.

    Parameters
    ----------
    device_ticks, received_ns
        (n,) integers: device clock at an event, and the host time at which news of it came; at least one.
    tick_rate_hz
        Nominal rate of the device clock.
    restarts_ns
        (restarts,) host times from which it counted anew.
    pulse_ticks
        (m,) device clock at the trigger pulses that it stamped, in the order of receipt.
    trigger_ns
        (k,) host times of the triggers.

    Raises
    ------
    ValueError
        As `fit_clock`.
    """
    ticks, received = np.asarray(device_ticks, np.int64), np.asarray(received_ns, np.int64)
    edges = np.unique(np.asarray(restarts_ns, np.int64))
    pulses = _pulses_by_stretch(np.asarray(pulse_ticks, np.int64), edges.size)

    def fit(points: NDArray[np.bool_], number: int) -> ClockModel:
        receipt = fit_clock(ticks[points], received[points], tick_rate_hz)
        return fit_clock_to_pulses(pulses[number], trigger_ns, receipt) or receipt

    return fit_stretches(edges, received, fit)


def pulse_times_ns(clock: DeviceTimes, pulse_ticks: ArrayLike) -> NDArray[np.int64]:
    """Host times of the pulses that a device stamped, (pulses,) int64 each; none when they cannot be placed.

    Parameters
    ----------
    clock
        Model of its clock.
    pulse_ticks
        Its clock at the pulses, in the order of receipt.
    """
    models = clock.models if isinstance(clock, RestartedClock) else (clock,)
    pulses = _pulses_by_stretch(np.asarray(pulse_ticks, np.int64), len(models) - 1)
    return np.concatenate([model.to_host_ns(part) for model, part in zip(models, pulses, strict=True)])


def fit_stretches(
    restarts_ns: NDArray[np.int64],
    received_ns: NDArray[np.int64],
    fit: Callable[[NDArray[np.bool_], int], ClockModel],
) -> DeviceTimes:
    """Fit each stretch between two restarts by itself.

    Parameters
    ----------
    restarts_ns
        (restarts,) int64, increasing.
    received_ns
        (n,) int64, host times of receipt of all points, at least one.
    fit
        Fits the points of a mask, (n,) bool; also told the number of the stretch, counted from 0.
    """
    stretch = np.searchsorted(restarts_ns, received_ns, side="right")
    # A stretch without a point needs no model: what came before it ends where the next one begins.
    present = [int(number) for number in np.unique(stretch)] or [0]
    models = tuple(fit(stretch == number, number) for number in present)
    if len(models) == 1:
        return models[0]
    return RestartedClock(tuple(int(restarts_ns[number - 1]) for number in present[1:]), models)


def _pulses_by_stretch(pulse_ticks: NDArray[np.int64], restarts: int) -> list[NDArray[np.int64]]:
    """Pulses carry no host time: they are told apart where their ticks go back, once for each restart.

    Where that does not fit the number of restarts, nothing is known of which pulse is whose.
    """
    if restarts == 0:
        return [pulse_ticks]
    runs = np.split(pulse_ticks, np.flatnonzero(np.diff(pulse_ticks) < 0) + 1)
    return runs if len(runs) == restarts + 1 else [pulse_ticks[:0]] * (restarts + 1)
