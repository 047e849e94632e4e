"""Wave-probe records of a run, in metres and on the cameras' time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from thermacq.errors import StoreError
from thermacq.evaluation.series import Series, WaveError, prepare
from thermacq.evaluation.waves import single_waves
from thermacq.timing import NS_PER_S, DeviceTimes, fit_clock, fit_device_clock, fit_stretches

if TYPE_CHECKING:
    from thermacq.store import ProbeSamples, RunFile


@dataclass(frozen=True)
class ProbeRecord:
    """One probe of a run.

    Parameters
    ----------
    name
        Name in the rig.
    time_s
        (samples,) float64, seconds of the recording, by the clock model.
    eta_m
        (samples,) float64, elevation: coefficient * (raw - zero).
    x_m, y_m
        Where the probe stands in the world frame, as the rig says.
    channel, unit
        Channel that was used and the unit of its raw values.
    zero_raw, zero_source
        Raw value taken for still water, and where it comes from.
    coefficient_m_per_unit, coefficient_u_rel
        From the rig; the second is its relative standard uncertainty.
    clock
        Model that mapped the probe's ticks to host time.
    lost_samples
        Samples missing in the device's own count.
    """

    name: str
    time_s: Series
    eta_m: Series
    x_m: float
    y_m: float
    channel: str
    unit: str
    zero_raw: float
    zero_source: str
    coefficient_m_per_unit: float
    coefficient_u_rel: float
    clock: DeviceTimes
    lost_samples: int


def probe_label(name: str) -> str:
    """A probe's name as it reads in a sentence: ``probe P1``, but not ``probe probe``."""
    return name if name.startswith("probe") else f"probe {name}"


def probe_record(run: RunFile, name: str) -> ProbeRecord:
    """Read a probe of a run: raw values to metres, its clock to the cameras' time.

    Parameters
    ----------
    run
        An open run file.
    name
        Name of the probe in the rig.

    Raises
    ------
    StoreError
        There is no such probe, it holds no samples, or the rig names a channel that it has not.
    """
    samples = run.probe(name)
    if len(samples) < 3:
        raise StoreError(f"probe '{name}' of '{run.path}' holds {len(samples)} samples: too few to use")
    table = run.rig.probes[name]
    channel = table.channel or samples.channels[0]
    if channel not in samples.channels:
        raise StoreError(
            f"the rig of '{run.path}' takes channel '{channel}' of probe '{name}', which has "
            f"{', '.join(samples.channels)}"
        )
    raw = samples.values[:, samples.channels.index(channel)]
    clock = probe_clock(samples, _fired_triggers(run))
    stamps = samples.ticks if samples.tick_rate_hz > 0 else samples.index
    time_s = (clock.times_of(stamps, samples.host_ns) - run.header.host_anchor_ns) / NS_PER_S
    zero, source = (table.zero_raw, "rig") if table.zero_raw is not None else still_level(time_s, raw)
    return ProbeRecord(
        name=name,
        time_s=time_s,
        eta_m=table.coefficient_m_per_unit * (raw - zero),
        x_m=table.x_m,
        y_m=table.y_m,
        channel=channel,
        unit=samples.unit,
        zero_raw=zero,
        zero_source=source,
        coefficient_m_per_unit=table.coefficient_m_per_unit,
        coefficient_u_rel=table.coefficient_u_rel,
        clock=clock,
        lost_samples=int(samples.index[-1] - samples.index[0] + 1 - len(samples)),
    )


def probe_clock(samples: ProbeSamples, trigger_ns: np.ndarray[tuple[int], np.dtype[np.int64]]) -> DeviceTimes:
    """Clock model of a probe: from the cameras' pulses that it stamped, else from the times of receipt.

    Parameters
    ----------
    samples
        Samples of the probe; one without a clock is taken to sample evenly.
    trigger_ns
        (triggers,) int64, host times of the triggers that made frames.

    Raises
    ------
    StoreError
        The samples carry no times and came all at once.
    """
    # Samples come in blocks; only the last one of a block was received about when it was taken.
    last = np.append(samples.host_ns[1:] != samples.host_ns[:-1], True)
    host_ns = samples.host_ns[last]
    if samples.tick_rate_hz > 0:
        return fit_device_clock(
            samples.ticks[last],
            host_ns,
            samples.tick_rate_hz,
            samples.restarts_ns,
            samples.pulse_ticks,
            trigger_ns,
        )
    index = samples.index[last]
    restarts_ns = np.unique(np.array(samples.restarts_ns, np.int64))
    rate_hz = _sample_rate(index, host_ns, restarts_ns)
    return fit_stretches(
        restarts_ns, host_ns, lambda points, _: fit_clock(index[points], host_ns[points], rate_hz)
    )


def _sample_rate(
    index: np.ndarray[tuple[int], np.dtype[np.int64]],
    host_ns: np.ndarray[tuple[int], np.dtype[np.int64]],
    restarts_ns: np.ndarray[tuple[int], np.dtype[np.int64]],
) -> float:
    """Samples per second while the probe was there; raises `StoreError` when that cannot be known."""
    there = np.diff(np.searchsorted(restarts_ns, host_ns, side="right")) == 0
    seconds = float(np.sum(np.diff(host_ns)[there])) / NS_PER_S
    if seconds <= 0:
        raise StoreError(
            "the probe's samples carry no times and came in one block: their rate is unknown",
            remedy="Record for longer, or use a driver that stamps its samples.",
        )
    return float(np.sum(np.diff(index)[there])) / seconds


def still_level(time_s: Series, raw: Series) -> tuple[float, str]:
    """Raw value of still water from the record itself: its mean over whole waves.

    The mean over the whole record would be off by up to a third of an amplitude divided by the number of
    waves, because of the unfinished one.
    """
    try:
        waves = single_waves(prepare(time_s, raw))
    except WaveError:
        return float(np.nanmean(raw)), "mean of the record"
    whole = (time_s >= waves.start_s[0]) & (time_s < waves.start_s[-1] + waves.period_s[-1])
    return float(np.nanmean(raw[whole])), "mean over the whole waves of the record"


def _fired_triggers(run: RunFile) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    from thermacq.store import trigger_line

    line = trigger_line(run)
    if line is not None:
        return line.pulse_ns
    stamps = [run.frames(camera).trigger_ns for camera in run.cameras]
    fired = np.concatenate(stamps) if stamps else np.empty(0, np.int64)
    return np.unique(fired[fired >= 0])
