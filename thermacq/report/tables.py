"""Numbers as a person reads them: rows of text for the command line and the page, units included."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from thermacq.evaluation import Comparison, Flatness, WaveStatistics

WAVE_COLUMNS = ("comparison", "H̄ (cm)", "H̄ ref. (cm)", "error", "T̄ (s)", "T̄ ref. (s)", "error", "R²")
FLATNESS_COLUMNS = ("measure", "value", "paper")


class AgreementRow(NamedTuple):
    """One measure of agreement: its name, value, bootstrap interval, and the paper's figure."""

    measure: str
    value: str
    interval: str = ""
    paper: str = ""


def title_of(comparison: Comparison) -> str:
    """What was compared with what."""
    return f"{comparison.measured_name} / {comparison.reference_name}"


def wave_row(comparison: Comparison) -> tuple[str, ...]:
    """One row of the paper's Table IV or V; errors carry their sign, ± is twice the standard error."""
    measured, reference = comparison.measured_waves, comparison.reference_waves
    return (
        title_of(comparison),
        _with_spread(measured.mean_height_m, measured.mean_height_sem_m, 100, 2),
        _with_spread(reference.mean_height_m, reference.mean_height_sem_m, 100, 2),
        f"{100 * comparison.height_error:+.2f} %",
        _with_spread(measured.mean_period_s, measured.mean_period_sem_s, 1, 4),
        _with_spread(reference.mean_period_s, reference.mean_period_sem_s, 1, 4),
        f"{100 * comparison.period_error:+.2f} %",
        f"{100 * comparison.agreement.r_squared:.2f} %",
    )


def agreement_rows(comparison: Comparison) -> list[AgreementRow]:
    """Measures of agreement with their intervals."""
    found, lag = comparison.agreement, comparison.lag
    low, high = found.limits_m
    return [
        AgreementRow(
            "slope (least squares)",
            f"{found.slope:.4f}",
            _span(found.intervals["slope"], 1, 4),
            "0.979, 0.985",
        ),
        AgreementRow(
            "slope (orthogonal)",
            f"{found.orthogonal_slope:.4f}",
            _span(found.intervals["orthogonal_slope"], 1, 4),
        ),
        AgreementRow("intercept", f"{1000 * found.intercept_m:+.2f} mm"),
        AgreementRow(
            "R² (eq. 4)",
            f"{100 * found.r_squared:.2f} %",
            _span(found.intervals["r_squared"], 100, 2, " %"),
            "98.96 – 99.53 %",
        ),
        AgreementRow(
            "bias", f"{1000 * found.bias_m:+.2f} mm", _span(found.intervals["bias_m"], 1000, 2, " mm")
        ),
        AgreementRow(
            "RMSE", f"{1000 * found.rmse_m:.2f} mm", _span(found.intervals["rmse_m"], 1000, 2, " mm")
        ),
        AgreementRow("limits of agreement (95 %)", f"{1000 * low:+.2f} … {1000 * high:+.2f} mm"),
        AgreementRow("first-harmonic amplitude ratio", f"{comparison.amplitude_ratio:.4f}"),
        AgreementRow("mean height error", f"{100 * comparison.height_error:+.2f} %", "", "0.38 – 2.91 %"),
        AgreementRow("mean period error", f"{100 * comparison.period_error:+.2f} %", "", "0.05 – 0.80 %"),
        AgreementRow("lag, by cross-correlation", f"{1000 * lag.lag_s:+.2f} ms"),
        AgreementRow("lag, by first harmonic", f"{lag.phase_deg:+.2f}°"),
        AgreementRow("lag taken out before comparing", "yes" if lag.applied else "no"),
        AgreementRow("missing samples", f"{100 * comparison.missing_fraction:.1f} %"),
        AgreementRow("pairs of samples", str(found.samples)),
    ]


def agreement_table(comparisons: Sequence[Comparison]) -> tuple[list[str], list[list[str]]]:
    """Columns and rows with one column for each comparison, intervals in brackets."""
    columns = ["measure", *map(title_of, comparisons), "paper"]
    rows = [
        [group[0].measure, *(_with_interval(row) for row in group), group[0].paper]
        for group in zip(*map(agreement_rows, comparisons), strict=True)
    ]
    return columns, rows


def statistics_table(series: Mapping[str, WaveStatistics]) -> tuple[list[str], list[list[str]]]:
    """Columns and rows with one column for each series; definitions are those of the first one."""
    groups = zip(*map(statistics_rows, series.values()), strict=True)
    return ["measure", *series, "definition"], [
        [group[0][0], *(row[1] for row in group), group[0][2]] for group in groups
    ]


def bootstrap_note(comparison: Comparison) -> str:
    """How the intervals were made."""
    found = comparison.agreement
    if math.isnan(found.intervals["slope"][0]):
        return "No intervals: the record is shorter than two bootstrap blocks."
    return (
        f"Intervals: moving-block bootstrap, blocks of {found.block_s:.3f} s (one mean wave), "
        f"{found.resamples} resamples, seed {found.seed}."
    )


def statistics_rows(waves: WaveStatistics) -> list[tuple[str, str, str]]:
    """All statistics of one series with their definitions."""
    dead_band = f", dead band {1000 * waves.dead_band_m:g} mm" if waves.dead_band_m else ""
    crests = "parabola through crest and trough" if waves.crest == "parabola" else "extreme samples"
    return [
        ("waves", str(waves.waves), f"between zero {waves.crossing}-crossings{dead_band}"),
        ("waves left out", str(waves.waves_lost_to_gaps), "they touch a gap"),
        (
            "mean height H̄",
            _metres(waves.mean_height_m, waves.mean_height_sem_m),
            f"crest to trough, {crests}",
        ),
        ("significant height H1/3", _metres(waves.significant_height_m), "mean of the highest third"),
        ("Hrms", _metres(waves.rms_height_m), "root mean square of the heights"),
        ("Hmax", _metres(waves.max_height_m), "highest wave"),
        ("Hm0", _metres(waves.spectral_height_m), "4 √m0, variance weighted by time"),
        (
            "mean period T̄",
            _with_spread(waves.mean_period_s, waves.mean_period_sem_s, 1, 4) + " s",
            "interpolated crossings",
        ),
        ("Tm02", f"{waves.spectral_period_s:.4f} s", "√(m0/m2), up to ten times the mean frequency"),
        ("Tp", f"{waves.peak_period_s:.4f} s", "peak of Welch's spectrum"),
        ("first-harmonic amplitude", _metres(waves.first_harmonic_amplitude_m), "least squares at T̄"),
        ("mean level", _metres(waves.mean_m), f"removed first: {waves.detrend}"),
        (
            "samples",
            f"{waves.samples}, {waves.duration_s:.2f} s",
            "finite samples and the time from first to last",
        ),
        ("missing, gaps", f"{waves.missing}, {waves.gaps}", "NaN samples; steps too long to be bridged"),
    ]


def flatness_rows(flat: Flatness) -> list[tuple[str, str, str]]:
    """Figures of the still-water map, for a table under `FLATNESS_COLUMNS`."""
    drift = f"{1000 * flat.offset_drift_m:+.3f} mm, {1000 * flat.tilt_drift_rad:.3f} mrad"
    return [
        ("standard deviation, all cells and frames", _mm(flat.overall_sd_m), "0.3 mm, 1.1 mm"),
        ("of it, fixed over time", _mm(flat.fixed_sd_m), ""),
        ("of it, changing over time", _mm(flat.temporal_sd_m), ""),
        ("median of the cells, over time", _mm(flat.median_cell_sd_m), ""),
        ("after taking out the mean plane", _mm(flat.plane_sd_m), ""),
        ("mean height above the world plane", f"{1000 * flat.mean_m:+.3f} mm", ""),
        ("drift of the plane", drift, ""),
        ("frames", str(flat.frames), ""),
    ]


def sync_rows(sync: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Pairs, skew and late triggers of a run's synchronisation report."""
    if not sync:
        return []
    rows = [("trigger", str(sync.get("trigger_mode", ""))), ("clock", str(sync.get("clock", "")))]
    if "pairs" in sync:
        rows += [
            ("pairs", f"{sync['pairs']}, by {sync.get('paired_by', '')}"),
            ("frames without a partner", _by_name(sync.get("unpaired", {}))),
        ]
    if skew := sync.get("skew_ns"):
        figures = ", ".join(
            f"{name} {float(skew[name]) / 1000:.3g} µs" for name in ("p50", "p99", "max") if name in skew
        )
        rows += [("skew", figures), ("skew is taken from", str(sync.get("skew_source", "")))]
    if line := sync.get("line"):
        from thermacq.timing import line_rows

        rows += [(f"trigger line, {what}", words) for what, words in line_rows(line)]
    return [*rows, ("late triggers, skipped", _by_name(sync.get("late_triggers", {})))]


def clock_rows(sync: dict[str, Any] | None) -> list[tuple[str, ...]]:
    """Clock model of each device that has one."""
    models = (sync or {}).get("clocks", {})
    return [
        (
            name,
            f"{model['drift_ppm']:+.2f}",
            f"{model['residual_ns'] / 1000:.3g}",
            model["method"],
            str(model["points"]),
        )
        for name, model in models.items()
        if model
    ]


def loss_rows(sync: dict[str, Any] | None) -> list[tuple[str, ...]]:
    """Received, written and lost of each device."""
    devices = (sync or {}).get("devices", {})
    return [
        (
            name,
            str(counts.get("received", "")),
            str(counts.get("written", "")),
            _by_name(counts.get("lost", {})),
        )
        for name, counts in devices.items()
    ]


def _by_name(counts: dict[str, Any]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count) or "none"


def _with_interval(row: AgreementRow) -> str:
    return f"{row.value} [{row.interval}]" if row.interval else row.value


def _mm(value_m: float) -> str:
    return f"{1000 * value_m:.3f} mm"


def _metres(value_m: float, error_m: float = math.nan) -> str:
    """A length in the unit that suits it: millimetres below a decimetre, else metres."""
    if abs(value_m) < 0.1:
        return _with_spread(value_m, error_m, 1000, 2) + " mm"
    return _with_spread(value_m, error_m, 1, 4) + " m"


def _with_spread(value: float, standard_error: float, factor: float, digits: int) -> str:
    """``value ± 2 standard errors``; the second part is left out when unknown."""
    text = f"{factor * value:.{digits}f}"
    return text if math.isnan(standard_error) else f"{text} ± {2 * factor * standard_error:.{digits}f}"


def _span(interval: tuple[float, float], factor: float, digits: int, unit: str = "") -> str:
    low, high = interval
    return "" if math.isnan(low) else f"{factor * low:.{digits}f} … {factor * high:.{digits}f}{unit}"
