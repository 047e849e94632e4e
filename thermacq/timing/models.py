"""Models of device clocks: from ticks of a camera or probe to host time.

A device clock has an offset and a drift against the host. Two kinds of evidence exist: trigger pulses that
the device stamped itself and whose host time is known (exact on both sides), and the host times at which
its data was received, which are only ever late. `fit_clock_to_pulses` uses the first, `fit_clock` the
second. A device that was unplugged and came back counts anew: its clock is never fitted across that
(`thermacq.timing.restarts`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermacq.timing.clock import NS_PER_S

_MAX_SLOPE_SIGMA_PPM = 100.0
_MAX_DRIFT_PPM = 1000.0
_MAX_PULSE_LATENESS_NS = 100_000_000
_ROBUST_ROUNDS = 20
# Normal-consistent factor of the median absolute deviation, and the inlier bound in such units.
_MAD_TO_SIGMA = 1.4826
_INLIER_SIGMAS = 4.0


@dataclass(frozen=True)
class ClockModel:
    """Linear model of a device clock.

    Parameters
    ----------
    reference_ticks, reference_ns
        A point of the line; near the data, so that no digits are lost.
    ns_per_tick
        Slope of the line, host nanoseconds per tick.
    tick_rate_hz
        Nominal rate of the device clock.
    residual_ns
        Pulses: standard deviation of their residuals. Receipt times: median lateness above the line.
    method
        ``pulses``, ``envelope``, or ``offset only`` (too little evidence for a drift; the nominal rate
        is used).
    points
        Number of points that carried the fit.
    """

    reference_ticks: int
    reference_ns: int
    ns_per_tick: float
    tick_rate_hz: float
    residual_ns: float
    method: str
    points: int

    @property
    def offset_ns(self) -> int:
        """Host time when the device clock read 0."""
        return self.reference_ns - round(self.reference_ticks * self.ns_per_tick)

    @property
    def drift_ppm(self) -> float:
        """How much faster than nominal the device clock runs, parts per million of host time."""
        return (NS_PER_S / (self.ns_per_tick * self.tick_rate_hz) - 1.0) * 1e6

    def to_host_ns(self, ticks: ArrayLike) -> NDArray[np.int64]:
        """Host time of device ticks: (n,) integers to (n,) int64 nanoseconds."""
        since = np.asarray(ticks, np.int64) - self.reference_ticks
        elapsed: NDArray[np.int64] = np.rint(since * self.ns_per_tick).astype(np.int64)
        return self.reference_ns + elapsed

    def times_of(self, ticks: ArrayLike, received_ns: ArrayLike) -> NDArray[np.int64]:
        """As `to_host_ns`; for a clock that was never restarted, times of receipt tell nothing more."""
        del received_ns
        return self.to_host_ns(ticks)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a summary, offset and drift included."""
        return {**asdict(self), "offset_ns": self.offset_ns, "drift_ppm": self.drift_ppm}


def fit_clock(device_ticks: ArrayLike, host_ns: ArrayLike, tick_rate_hz: float) -> ClockModel:
    """Fit a device clock to receipt times, which are late by unknown, never negative, delays.

    The line lies below every point and as close to them as possible: it is the edge of the lower convex
    hull above the mean of the ticks (the minimum of the summed delays; Zhang, Liu & Xia 2002, "Clock
    synchronization algorithms for network measurements"). What stays unknown is the shortest delay.

    Parameters
    ----------
    device_ticks, host_ns
        (n,) integers: device clock at an event, host time when news of the event came.
    tick_rate_hz
        Nominal rate of the device clock.

    Raises
    ------
    ValueError
        No points, unequal lengths, or a rate that is not positive.
    """
    ticks, host = _points(device_ticks, host_ns, tick_rate_hz)
    reference_ticks, reference_ns = int(ticks[ticks.size // 2]), int(host[ticks.size // 2])
    x, y = (ticks - reference_ticks).astype(float), (host - reference_ns).astype(float)
    nominal = NS_PER_S / tick_rate_hz
    slope, method = nominal, "offset only"
    if np.ptp(x) > 0:
        candidate = _envelope_slope(x, y)
        lateness = _lateness(x, y, candidate)
        sigma_ppm = float(np.median(lateness)) / (np.ptp(x) * nominal) * 1e6
        drift_ppm = abs(candidate / nominal - 1.0) * 1e6
        if sigma_ppm <= _MAX_SLOPE_SIGMA_PPM and drift_ppm <= _MAX_DRIFT_PPM:
            slope, method = candidate, "envelope"
    intercept = float(np.min(y - slope * x))
    return ClockModel(
        reference_ticks=reference_ticks,
        reference_ns=reference_ns + round(intercept),
        ns_per_tick=slope,
        tick_rate_hz=tick_rate_hz,
        residual_ns=float(np.median(_lateness(x, y, slope))),
        method=method,
        points=ticks.size,
    )


def fit_clock_to_pulses(
    pulse_ticks: ArrayLike, trigger_ns: ArrayLike, receipt_model: ClockModel
) -> ClockModel | None:
    """Fit a device clock to the trigger pulses that it stamped.

    Parameters
    ----------
    pulse_ticks
        (m,) device clock at the pulses that the device saw; some may be lost.
    trigger_ns
        (n,) host times of the triggers that were really fired.
    receipt_model
        Model of the same clock from receipt times (`fit_clock`); tells which pulse is which trigger.

    Returns
    -------
    ClockModel or None
        None when fewer than three pulses could be matched.
    """
    ticks = np.unique(np.asarray(pulse_ticks, np.int64))
    triggers = np.unique(np.asarray(trigger_ns, np.int64))
    seen, fired = _match_pulses(receipt_model.to_host_ns(ticks), triggers)
    if seen.size < 3:
        return None
    ticks, host = ticks[seen], triggers[fired]
    reference_ticks, reference_ns = int(ticks[ticks.size // 2]), int(host[ticks.size // 2])
    x, y = (ticks - reference_ticks).astype(float), (host - reference_ns).astype(float)
    inlier = np.ones(x.size, bool)
    slope, intercept, sigma = _median_line(x, y)
    for _ in range(_ROBUST_ROUNDS):
        residual = y - slope * x - intercept
        # Ticks are whole: an error of half a tick is none, nor is one of a nanosecond, however small sigma is.
        bound = _INLIER_SIGMAS * max(sigma, 1.0, NS_PER_S / receipt_model.tick_rate_hz / np.sqrt(12))
        now = np.abs(residual) <= bound
        if now.sum() < 3:
            break
        slope, intercept = np.polyfit(x[now], y[now], 1)
        sigma = float(np.std(y[now] - slope * x[now] - intercept))
        if np.array_equal(now, inlier):
            break
        inlier = now
    return ClockModel(
        reference_ticks=reference_ticks,
        reference_ns=reference_ns + round(float(intercept)),
        ns_per_tick=float(slope),
        tick_rate_hz=receipt_model.tick_rate_hz,
        residual_ns=sigma,
        method="pulses",
        points=int(inlier.sum()),
    )


def _points(
    device_ticks: ArrayLike, host_ns: ArrayLike, tick_rate_hz: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    ticks, host = np.asarray(device_ticks, np.int64).ravel(), np.asarray(host_ns, np.int64).ravel()
    if ticks.size == 0 or ticks.size != host.size or not tick_rate_hz > 0:
        raise ValueError("a clock model needs ticks, as many host times, and a positive tick rate")
    order = np.argsort(ticks, kind="stable")
    return ticks[order], host[order]


def _lateness(x: NDArray[np.float64], y: NDArray[np.float64], slope: float) -> NDArray[np.float64]:
    """How far the points lie above the lowest line of that slope that touches them."""
    above = y - slope * x
    return np.asarray(above - above.min())


def _envelope_slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Slope of the lower hull's edge that spans the mean abscissa; `x` is sorted."""
    hull: list[int] = []
    for i in range(x.size):
        while len(hull) >= 2:
            a, b = hull[-2], hull[-1]
            if (y[b] - y[a]) * (x[i] - x[b]) < (y[i] - y[b]) * (x[b] - x[a]):
                break
            hull.pop()
        if hull and x[i] == x[hull[-1]]:
            if y[i] < y[hull[-1]]:
                hull[-1] = i
            continue
        hull.append(i)
    corners = np.array(hull)
    right = int(np.clip(np.searchsorted(x[corners], x.mean()), 1, corners.size - 1))
    a, b = corners[right - 1], corners[right]
    return float((y[b] - y[a]) / (x[b] - x[a]))


def _match_pulses(
    guess_ns: NDArray[np.int64], triggers: NDArray[np.int64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Match pulses, placed in host time by a guess that is late by at most 0.1 s, to fired triggers.

    Latenesses of 0, 1, 2... trigger periods are tried; the one that explains most pulses wins, the
    smallest of equals.
    """
    nothing = np.empty(0, np.intp)
    if guess_ns.size == 0 or triggers.size < 2:
        return nothing, nothing
    period = float(np.median(np.diff(triggers)))
    best = (nothing, nothing)
    for lateness in np.arange(0.0, max(period, _MAX_PULSE_LATENESS_NS), period):
        # Between whole periods the guess may be late by up to one more: look back, not forward.
        place = guess_ns - round(lateness)
        candidates = _nearest(place, triggers, period)
        if candidates[0].size > best[0].size:
            best = candidates
    return best


def _nearest(
    place: NDArray[np.int64], triggers: NDArray[np.int64], period: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    right = np.clip(np.searchsorted(triggers, place), 1, triggers.size - 1)
    nearest = right - (place - triggers[right - 1] < triggers[right] - place)
    close = np.flatnonzero(np.abs(place - triggers[nearest]) < period / 2)
    _, first = np.unique(nearest[close], return_index=True)
    return close[first], nearest[close[first]]


def _median_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float, float]:
    """Slope, intercept and robust sigma from medians of pairwise slopes between the two halves."""
    half = x.size // 2
    slope = float(np.median((y[-half:] - y[:half]) / (x[-half:] - x[:half])))
    residual = y - slope * x
    intercept = float(np.median(residual))
    sigma = _MAD_TO_SIGMA * float(np.median(np.abs(residual - intercept)))
    return slope, intercept, sigma
