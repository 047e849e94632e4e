"""The report page: one HTML file that needs nothing from anywhere else.

All text goes through Jinja's escaping; only the figures, which `thermacq.report.figures` made without any text
from a file, are marked as safe. A content security policy in the page forbids scripts and outside sources.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from thermacq.evaluation.quantisation import depth_error_m
from thermacq.report import figures, tables
from thermacq.report.data import ReportData

if TYPE_CHECKING:
    from thermacq.evaluation import Comparison, WaveStatistics


@dataclass(frozen=True)
class Headline:
    """One of the large numbers at the top: what, how much, and what to hold it against."""

    name: str
    value: str
    beside: str = ""


def render(data: ReportData) -> str:
    """The page as HTML text.

    Parameters
    ----------
    data
        What to show; every part may be missing.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("thermacq.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    main = main_comparison(data)
    return environment.get_template("report.html").render(
        data=data,
        tables=tables,
        headlines=headlines(data),
        main=main,
        figures=_figures(data, main),
        history_cut=any(map(figures.is_cut, _shown(data))),
        history_names="; ".join(
            f"panel {number}: {tables.title_of(comparison)}"
            for number, comparison in enumerate(_shown(data), 1)
        ),
        wave_rows=[tables.wave_row(comparison) for comparison in data.comparisons],
        agreement_table=tables.agreement_table(data.comparisons) if main else None,
        statistics_table=tables.statistics_table(_series(data)) if main else None,
        place_names=", ".join(f"{number} {place.name}" for number, place in enumerate(data.places, start=1)),
        sync_rows=tables.sync_rows(data.sync),
        clock_rows=tables.clock_rows(data.sync),
        loss_rows=tables.loss_rows(data.sync),
        event_rows=[(f"{e.time_s:.3f}", e.device, e.kind, e.index, e.detail) for e in data.events],
        quantum_mm=_quantum_mm(data),
    )


def main_comparison(data: ReportData) -> Comparison | None:
    """The comparison that the report is about: stereo against the first probe, else against the truth."""
    return data.comparisons[0] if data.comparisons else None


def headlines(data: ReportData) -> list[Headline]:
    """The large numbers, as far as they are known."""
    found: list[Headline] = []
    if comparison := main_comparison(data):
        measured, reference = comparison.measured_waves, comparison.reference_waves
        against = figures.role(comparison.reference_name)
        found += [
            Headline(
                "mean wave height",
                f"{100 * measured.mean_height_m:.2f} cm",
                f"{against} {100 * reference.mean_height_m:.2f} cm ({100 * comparison.height_error:+.2f} %)",
            ),
            Headline(
                "mean period",
                f"{measured.mean_period_s:.4f} s",
                f"{against} {reference.mean_period_s:.4f} s ({100 * comparison.period_error:+.2f} %)",
            ),
            Headline("R²", f"{100 * comparison.agreement.r_squared:.2f} %", f"against the {against}, eq. 4"),
            Headline(
                "slope",
                f"{comparison.agreement.slope:.4f}",
                f"orthogonal {comparison.agreement.orthogonal_slope:.4f}",
            ),
            Headline(
                "RMSE",
                f"{1000 * comparison.agreement.rmse_m:.2f} mm",
                f"bias {1000 * comparison.agreement.bias_m:+.2f} mm",
            ),
        ]
    if data.flatness:
        found.append(
            Headline(
                "still-water σ",
                f"{1000 * data.flatness.overall_sd_m:.2f} mm",
                f"{data.flatness.frames} frames",
            )
        )
    if data.sync and data.sync.get("skew_ns"):
        skew = data.sync["skew_ns"]
        pairs = f"{data.sync.get('pairs', 0)} pairs"
        virtual = data.sync.get("clock") == "virtual"
        skew_us = "virtual clock" if virtual else f"{skew['p99'] / 1000:.3g} µs"
        found.append(Headline("skew p99", skew_us, pairs))
    if data.coverage:
        found.append(
            Headline(
                "cells missing",
                f"{100 * data.coverage.seen_missing_fraction:.1f} %",
                f"of those ever seen, {data.coverage.frames} frames",
            )
        )
    return found


def _shown(data: ReportData) -> list[Comparison]:
    """Comparisons whose time histories are drawn: those of the measured surface."""
    surface = [
        comparison for comparison in data.comparisons if figures.role(comparison.measured_name) == "stereo"
    ]
    return surface or list(data.comparisons)


def _series(data: ReportData) -> dict[str, WaveStatistics]:
    """Every series once, in the order in which the comparisons name them."""
    found: dict[str, WaveStatistics] = {}
    for comparison in data.comparisons:
        found.setdefault(comparison.measured_name, comparison.measured_waves)
        found.setdefault(comparison.reference_name, comparison.reference_waves)
    return found


def _quantum_mm(data: ReportData) -> float:
    if data.quantisation is None:
        return float("nan")
    rig = data.quantisation
    return 1000 * float(depth_error_m(rig.working_distance_m, rig.baseline_m, rig.focal_px))


def _figures(data: ReportData, main: Comparison | None) -> dict[str, str]:
    """Figures by name, as far as their data are there."""
    drawn: dict[str, str] = {}
    pictures: dict[str, str] = {}
    if data.sample:
        if data.sample.left is not None:
            pictures["left"] = figures.picture(data.sample.left)
        if data.sample.right is not None:
            pictures["right"] = figures.picture(data.sample.right)
        if data.sample.disparity is not None:
            drawn["disparity"] = figures.disparity_map(data.sample.disparity)
    if data.surface:
        pictures["surface"] = figures.surface_3d(data.surface)
        drawn["map"] = figures.elevation_map(data.surface, data.places)
    if main:
        drawn["history"] = figures.time_histories(_shown(data))
        drawn["scatter"] = figures.scatter(main)
        drawn["differences"] = figures.differences(main)
    if data.flatness:
        drawn["flatness"] = figures.flatness_maps(data.flatness)
    if data.quantisation:
        drawn["quantisation"] = figures.quantisation_plot(data.quantisation)
    return pictures | {name: _markup(svg) for name, svg in drawn.items()}


def _markup(svg: str) -> str:
    """An SVG that the template need not escape; safe because no text from a file is in it."""
    from markupsafe import Markup

    return Markup(svg)
