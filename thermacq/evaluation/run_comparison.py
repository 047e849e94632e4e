"""A product against the probes of its run, and, for a simulated run, both against the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from thermacq.errors import ReconstructionError, StoreError, ThermacqError
from thermacq.evaluation.comparison import Comparison, compare_series
from thermacq.evaluation.probes import ProbeRecord, probe_label, probe_record
from thermacq.evaluation.series import Detrend, Series
from thermacq.evaluation.waves import Crossing
from thermacq.hooks import TruthRequest
from thermacq.plugins import plugins
from thermacq.reconstruction import virtual_probe

if TYPE_CHECKING:
    import xarray as xr

    from thermacq.store import RunFile


SURFACE = "stereo"
"""Name of the measured surface in comparisons."""

_Result = TypeVar("_Result")


class TruthError(ThermacqError):
    """A plugin failed to tell the truth of a simulated scene."""


@dataclass(frozen=True)
class CompareSettings:
    """How series are compared.

    Parameters
    ----------
    crossing, detrend, dead_band_m
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
    dead_band_m: float = 0.0
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
        The surface could not be compared with anything; the reason of the first failure.
    """
    settings = settings or CompareSettings()
    if product.attrs.get("run_id") != run.header.run_id:
        raise StoreError(
            f"the product was not made from '{run.path}': it names run {product.attrs.get('run_id')}, "
            f"the file is run {run.header.run_id}",
            remedy="Give the run that the product was reconstructed from.",
        )
    outcome = _Outcome()
    for name in [probe] if probe else run.probes:
        _compare_at_probe(outcome, product, run, name, place, settings)
    if not run.probes:
        outcome.notes.append("the run has no wave probe")
        if settings.truth:
            _compare_without_probe(outcome, product, run, place, settings)
    if not any(comparison.measured_name == SURFACE for comparison in outcome.comparisons):
        raise next(
            iter(outcome.failures), ReconstructionError(f"'{run.path}' has no wave probe to compare with")
        )
    outcome.notes += _noise_notes(outcome.comparisons)
    notes = tuple(dict.fromkeys(outcome.notes))
    return RunComparison(tuple(outcome.comparisons), tuple(outcome.probes), notes)


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

    Raises
    ------
    TruthError
        The run was recorded in real time, or the plugin failed.
    """
    if not run.header.simulated:
        return None
    if run.header.clock != "virtual":
        raise TruthError(
            "recorded in real time, whose zero is not that of the scene: no comparison with the simulated truth"
            " (`thermacq simulate truth` writes it, by the cameras' own clocks)"
        )
    request = TruthRequest(run.rig.scene, np.asarray(time_s, np.float64), np.array([x_m]), np.array([y_m]))
    try:
        truth = plugins().truth(request)
        return None if truth is None else np.asarray(truth.eta_m, np.float64).reshape(len(time_s))
    # The truth comes from a plugin: whatever it raises must cost the truth only.
    except Exception as error:
        raise TruthError(f"the truth of the simulated scene is not known: {error}") from None


@dataclass(frozen=True)
class _Measured:
    """A named series, (times,) seconds and metres."""

    name: str
    time_s: Series
    eta_m: Series


@dataclass
class _Outcome:
    """What was compared so far; a failure costs only the comparison in which it happened."""

    comparisons: list[Comparison] = field(default_factory=list)
    probes: list[ProbeRecord] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    failures: list[ThermacqError] = field(default_factory=list)

    def attempt(self, what: str, action: Callable[[], _Result]) -> _Result | None:
        """Result of an action; None, and a note, when it failed."""
        try:
            return action()
        except ThermacqError as error:
            self.failures.append(error)
            self.notes.append(f"{what} is not compared: {error.what.removeprefix(f'{what}: ')}")
            return None

    def compare(self, what: str, action: Callable[[], Comparison | None]) -> None:
        """Keep the comparison that an action makes, if it makes one."""
        if (found := self.attempt(what, action)) is not None:
            self.comparisons.append(found)


def _compare_at_probe(
    outcome: _Outcome,
    product: xr.Dataset,
    run: RunFile,
    name: str,
    place: tuple[float, float] | None,
    settings: CompareSettings,
) -> None:
    label = probe_label(name)
    record = outcome.attempt(label, lambda: probe_record(run, name))
    if record is not None:
        outcome.probes.append(record)
        outcome.notes += _notes(record, place)
    table = run.rig.probes.get(name)
    if table is None:
        return
    at = place or (table.x_m, table.y_m)
    probe = None if record is None else _Measured(label, record.time_s, record.eta_m)
    stereo = outcome.attempt("the surface", lambda: _surface_at(product, at))
    if stereo and probe:
        outcome.compare(label, lambda: _compare(stereo, probe, settings))
    there = f"truth (simulated) at {label}"
    if settings.truth and stereo:
        outcome.compare(there, lambda: _against_truth(run, stereo, at, there, settings))
    if settings.truth and probe:
        own = (table.x_m, table.y_m)
        outcome.compare(there, lambda: _against_truth(run, probe, own, there, settings))


def _compare_without_probe(
    outcome: _Outcome,
    product: xr.Dataset,
    run: RunFile,
    place: tuple[float, float] | None,
    settings: CompareSettings,
) -> None:
    """A simulated run without probes: the surface against the truth at a place, else at its middle."""
    at = place or (float(product["x"].mean()), float(product["y"].mean()))
    there = f"truth (simulated) at x = {at[0]:.3f} m, y = {at[1]:.3f} m"
    stereo = outcome.attempt("the surface", lambda: _surface_at(product, at))
    if stereo:
        outcome.compare(there, lambda: _against_truth(run, stereo, at, there, settings))


def _surface_at(product: xr.Dataset, at: tuple[float, float]) -> _Measured:
    found = virtual_probe(product, *at)
    return _Measured(SURFACE, found.time_s, found.eta_m)


def _against_truth(
    run: RunFile, measured: _Measured, at: tuple[float, float], label: str, settings: CompareSettings
) -> Comparison | None:
    truth = simulated_truth(run, measured.time_s, *at)
    if truth is None:
        return None
    return _compare(measured, _Measured(label, measured.time_s, truth), settings)


def _compare(measured: _Measured, reference: _Measured, settings: CompareSettings) -> Comparison:
    return compare_series(
        measured.time_s,
        measured.eta_m,
        reference.time_s,
        reference.eta_m,
        measured_name=measured.name,
        reference_name=reference.name,
        crossing=settings.crossing,
        detrend=settings.detrend,
        dead_band_m=settings.dead_band_m,
        apply_lag=settings.apply_lag,
        resamples=settings.resamples,
        seed=settings.seed,
    )


def _noise_notes(comparisons: Sequence[Comparison]) -> Iterator[str]:
    """Series that cross zero where their reference does not: noise, which spoils counts and mean period."""
    for comparison in comparisons:
        least = comparison.reference_waves.mean_period_s / 4
        if comparison.measured_waves.shortest_period_s < least < comparison.reference_waves.shortest_period_s:
            yield (
                f"{comparison.measured_name}: noise makes waves as short as "
                f"{comparison.measured_waves.shortest_period_s:.3f} s; a dead band leaves them out"
            )


def _notes(probe: ProbeRecord, place: tuple[float, float] | None) -> Iterator[str]:
    label = probe_label(probe.name)
    if probe.zero_source != "rig":
        yield (
            f"zero of {label}: {probe.zero_source}, so the bias against it holds no information "
            "about the level of the water"
        )
    if probe.clock.method != "pulses":
        yield (
            f"clock of {label}: fitted to times of receipt ({probe.clock.method}); an unknown "
            "shortest delay stays in the lag"
        )
    if probe.lost_samples:
        yield f"{label} lost {probe.lost_samples} samples"
    if place is not None:
        yield (
            f"the surface was read at x = {place[0]:.3f} m, y = {place[1]:.3f} m, {label} stands at "
            f"x = {probe.x_m:.3f} m, y = {probe.y_m:.3f} m"
        )
