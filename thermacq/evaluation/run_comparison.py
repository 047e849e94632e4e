"""A product against the probes of its run, and, for a simulated run, both against the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from thermacq.errors import ReconstructionError, StoreError, ThermacqError
from thermacq.evaluation.comparison import Comparison, compare_series
from thermacq.evaluation.probes import ProbeRecord, probe_record
from thermacq.evaluation.series import Detrend, Series
from thermacq.evaluation.waves import Crossing
from thermacq.hooks import TruthRequest
from thermacq.plugins import plugins
from thermacq.reconstruction import virtual_probe

if TYPE_CHECKING:
    import xarray as xr

    from thermacq.store import RunFile


@dataclass(frozen=True)
class CompareSettings:
    """How series are compared.

    Parameters
    ----------
    crossing, detrend
        As in `wave_statistics`.
    apply_lag
        Take the estimated lag out first; the result says so.
    truth
        Compare with the truth too where a plugin knows it.
    resamples, seed
        Of the bootstrap.
    """

    crossing: Crossing = "up"
    detrend: Detrend = "mean"
    apply_lag: bool = False
    truth: bool = True
    resamples: int = 1000
    seed: int = 0


@dataclass(frozen=True)
class RunComparison:
    """What came out: comparisons in the order stereo/probe, stereo/truth, probe/truth, place by place.

    `notes` say what could not be compared and why, and what a reader has to know.
    """

    comparisons: tuple[Comparison, ...]
    probes: tuple[ProbeRecord, ...]
    notes: tuple[str, ...]


def compare_run(
    product: xr.Dataset,
    run: RunFile,
    *,
    probe: str = "",
    place: tuple[float, float] | None = None,
    settings: CompareSettings | None = None,
) -> RunComparison:
    """Compare a product with the probes of the run that it was made from.

    Parameters
    ----------
    product
        From `thermacq.reconstruction.open_product`.
    run
        The run, open.
    probe
        Name of one probe; empty: all.
    place
        World coordinates at which the surface is read instead of at the probe: for a probe that stands
        beside the view in long-crested waves.
    settings
        How to compare.

    Raises
    ------
    StoreError
        Product and run do not belong together.
    ThermacqError
        Nothing could be compared; the reason of the first failure.
    """
    settings = settings or CompareSettings()
    if product.attrs.get("run_id") != run.header.run_id:
        raise StoreError(
            f"the product was not made from '{run.path}': it names run {product.attrs.get('run_id')}, "
            f"the file is run {run.header.run_id}",
            remedy="Give the run that the product was reconstructed from.",
        )
    comparisons: list[Comparison] = []
    probes: list[ProbeRecord] = []
    notes: list[str] = []
    failures: list[ThermacqError] = []
    for name in [probe] if probe else run.probes:
        try:
            record = probe_record(run, name)
            at = place or (record.x_m, record.y_m)
            comparisons += list(_at_probe(product, run, record, at, settings))
        except ThermacqError as error:
            failures.append(error)
            notes.append(f"probe {name} is not compared: {error.what}")
            continue
        probes.append(record)
        notes += _notes(record, place)
    if not run.probes:
        notes.append("the run has no wave probe")
        failures.append(
            ReconstructionError(f"'{run.path}' has no wave probe and no known truth to compare with")
        )
        if settings.truth:
            comparisons += _without_probe(product, run, place, settings)
    if not comparisons:
        raise failures[0]
    return RunComparison(tuple(comparisons), tuple(probes), tuple(notes))


def simulated_truth(run: RunFile, time_s: Series, x_m: float, y_m: float) -> Series | None:
    """Elevation that a simulation knows at one place, (times,) metres; None for anything else.

    Parameters
    ----------
    run
        The run whose scene is asked about.
    time_s
        (times,) seconds of the recording.
    x_m, y_m
        World coordinates.
    """
    if not run.header.simulated:
        return None
    request = TruthRequest(run.rig.scene, np.asarray(time_s, np.float64), np.array([x_m]), np.array([y_m]))
    truth = plugins().truth(request)
    return None if truth is None else np.asarray(truth.eta_m, np.float64)[:, 0, 0]


def _at_probe(
    product: xr.Dataset, run: RunFile, probe: ProbeRecord, at: tuple[float, float], settings: CompareSettings
) -> Iterator[Comparison]:
    stereo = virtual_probe(product, *at)
    name = f"probe {probe.name}"
    yield _compare(stereo.time_s, stereo.eta_m, probe.time_s, probe.eta_m, "stereo", name, settings)
    if not settings.truth:
        return
    truth = simulated_truth(run, stereo.time_s, *at)
    if truth is not None:
        label = f"truth (simulated) at {name}"
        yield _compare(stereo.time_s, stereo.eta_m, stereo.time_s, truth, "stereo", label, settings)
    at_probe = simulated_truth(run, probe.time_s, probe.x_m, probe.y_m)
    if at_probe is not None:
        label = f"truth (simulated) at {name}"
        yield _compare(probe.time_s, probe.eta_m, probe.time_s, at_probe, name, label, settings)


def _without_probe(
    product: xr.Dataset, run: RunFile, place: tuple[float, float] | None, settings: CompareSettings
) -> Iterator[Comparison]:
    """A simulated run without probes: the surface against the truth at a place, else at its middle."""
    at = place or (float(product["x"].mean()), float(product["y"].mean()))
    stereo = virtual_probe(product, *at)
    truth = simulated_truth(run, stereo.time_s, *at)
    if truth is not None:
        label = f"truth (simulated) at x = {at[0]:.3f} m, y = {at[1]:.3f} m"
        yield _compare(stereo.time_s, stereo.eta_m, stereo.time_s, truth, "stereo", label, settings)


def _compare(
    time_s: Series,
    measured_m: Series,
    reference_time_s: Series,
    reference_m: Series,
    measured_name: str,
    reference_name: str,
    settings: CompareSettings,
) -> Comparison:
    return compare_series(
        time_s,
        measured_m,
        reference_time_s,
        reference_m,
        measured_name=measured_name,
        reference_name=reference_name,
        crossing=settings.crossing,
        detrend=settings.detrend,
        apply_lag=settings.apply_lag,
        resamples=settings.resamples,
        seed=settings.seed,
    )


def _notes(probe: ProbeRecord, place: tuple[float, float] | None) -> Iterator[str]:
    if probe.zero_source != "rig":
        yield (
            f"zero of probe {probe.name}: {probe.zero_source}, so the bias against it holds no information "
            "about the level of the water"
        )
    if probe.clock.method != "pulses":
        yield (
            f"clock of probe {probe.name}: fitted to times of receipt ({probe.clock.method}); an unknown "
            "shortest delay stays in the lag"
        )
    if probe.lost_samples:
        yield f"probe {probe.name} lost {probe.lost_samples} samples"
    if place is not None:
        yield (
            f"the surface was read at x = {place[0]:.3f} m, y = {place[1]:.3f} m, probe {probe.name} stands at "
            f"x = {probe.x_m:.3f} m, y = {probe.y_m:.3f} m"
        )
