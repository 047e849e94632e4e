"""``thermacq waves``, ``compare``, ``export`` and ``report``: judging and handing on what was measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from thermacq.cli.common import AsJson, err, out, print_json, warn

if TYPE_CHECKING:
    from thermacq.evaluation import Comparison

ProductPath = Annotated[Path, typer.Argument(metavar="PRODUCT", help="Elevation product (NetCDF).")]
CrossingOption = Annotated[
    Literal["up", "down"], typer.Option("--crossing", help="Zero crossings between waves.")
]
DetrendOption = Annotated[
    Literal["mean", "linear", "none"],
    typer.Option("--detrend", help="What is removed before crossings are sought."),
]

DeadBand = Annotated[
    float,
    typer.Option("--dead-band-mm", min=0, help="Zero crossings by less than this are noise, not waves."),
]


def waves(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Text series: time and elevation, or one column.")
    ],
    time_column: Annotated[str, typer.Option("--time-column", help="Name, or number from 1.")] = "",
    value_column: Annotated[str, typer.Option("--value-column", help="Name, or number from 1.")] = "",
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", help="Sampling rate of a file without times.")
    ] = None,
    unit: Annotated[str, typer.Option("--unit", help="Unit of the elevations: m, cm or mm.")] = "m",
    crossing: CrossingOption = "up",
    detrend: DetrendOption = "mean",
    crest: Annotated[
        Literal["parabola", "sample"],
        typer.Option("--crest", help="Interpolate crests, or take the extreme sample."),
    ] = "parabola",
    dead_band_mm: DeadBand = 0.0,
    as_json: AsJson = False,
) -> None:
    """Wave statistics of a series in a text file: zero-crossing waves and spectral moments."""
    from thermacq.evaluation import wave_statistics
    from thermacq.evaluation.textseries import read_series
    from thermacq.report.tables import statistics_table

    time_s, elevation_m = read_series(
        file, time_column=time_column, value_column=value_column, rate_hz=rate_hz, unit=unit
    )
    found = wave_statistics(
        time_s, elevation_m, crossing=crossing, detrend=detrend, crest=crest, dead_band_m=dead_band_mm / 1000
    )
    if as_json:
        print_json(_plain({"file": str(file), **asdict(found)}))
        return
    _show_table(*statistics_table({"value": found}))


def compare(
    product: ProductPath,
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run that the product was made from.")],
    probe: Annotated[str, typer.Option("--probe", help="One probe; default: all.")] = "",
    at: Annotated[
        tuple[float, float] | None,
        typer.Option("--at", metavar="X Y", help="Read the surface here (m) instead of at the probe."),
    ] = None,
    truth: Annotated[
        bool, typer.Option("--truth/--no-truth", help="Compare a simulated run with its truth too.")
    ] = True,
    apply_lag: Annotated[
        bool, typer.Option("--apply-lag", help="Take the estimated lag out first; the output says so.")
    ] = False,
    crossing: CrossingOption = "up",
    detrend: DetrendOption = "mean",
    dead_band_mm: DeadBand = 0.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the bootstrap.")] = 0,
    csv: Annotated[
        Path | None, typer.Option("--csv", help="Also write the paired series to this file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare a product with the wave probes of its run: Table IV, agreement with intervals, truth."""
    from thermacq.evaluation.run_comparison import CompareSettings, compare_run
    from thermacq.reconstruction import open_product
    from thermacq.report import tables
    from thermacq.store import open_run

    settings = CompareSettings(
        crossing=crossing,
        detrend=detrend,
        apply_lag=apply_lag,
        truth=truth,
        dead_band_m=dead_band_mm / 1000,
        seed=seed,
    )
    with open_product(product) as dataset, open_run(run) as opened:
        result = compare_run(dataset, opened, probe=probe, place=at, settings=settings)
        simulated = opened.header.simulated
    if csv is not None:
        _write_pairs(csv, result.comparisons)
    if as_json:
        print_json(
            _plain(
                {
                    "product": str(product),
                    "run": str(run),
                    "simulated": simulated,
                    "comparisons": [_comparison_values(comparison) for comparison in result.comparisons],
                    "notes": list(result.notes),
                }
            )
        )
        return
    if simulated:
        out.print("simulated run: these numbers judge the method and the program, not a laboratory\n")
    _show_table(tables.WAVE_COLUMNS, [tables.wave_row(comparison) for comparison in result.comparisons])
    out.print("ref.: the second of the two names; ±: twice the standard error between waves\n")
    _show_table(*tables.agreement_table(result.comparisons))
    out.print(tables.bootstrap_note(result.comparisons[0]))
    for note in result.notes:
        out.print(f"note: {note}", markup=False)


def export(
    product: ProductPath,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write.")],
    file_format: Annotated[
        str, typer.Option("--format", help="Format of one frame; `thermacq plugins` lists the exporters.")
    ] = "",
    frame: Annotated[int, typer.Option("--frame", help="Frame to export; negative counts from the end.")] = 0,
    probe: Annotated[
        tuple[float, float] | None,
        typer.Option("--probe", metavar="X Y", help="Export the time history at this place (m) as CSV."),
    ] = None,
) -> None:
    """Export one frame of a product, or the time history of a virtual wave probe."""
    from thermacq.errors import StoreError
    from thermacq.plugins import plugins
    from thermacq.reconstruction import open_product, virtual_probe

    if (probe is None) == (not file_format):
        raise typer.BadParameter("give either --format (one frame) or --probe X Y (a time history)")
    _must_be_new(output)
    if probe is None:
        exporter = plugins().exporter(file_format)
        if output.suffix.lower() != exporter.suffix:
            raise StoreError(
                f"'{output}' should end in '{exporter.suffix}': programs choose how to read it by that",
                remedy="Give the output another name.",
            )
        exporter.write(product, output, frame)
    else:
        with open_product(product) as dataset:
            series = virtual_probe(dataset, *probe)
        rows = zip(series.time_s, series.eta_m, series.sd_m, series.points, strict=True)
        _write_csv(output, ("time_s", "eta_m", "sd_m", "points"), rows)
    err.print(f"written: {output}", markup=False)


def report(
    product: ProductPath,
    output: Annotated[Path, typer.Option("--output", "-o", help="Page to write (HTML).")],
    run: Annotated[Path | None, typer.Option("--run", help="Run that the product was made from.")] = None,
    still: Annotated[Path | None, typer.Option("--still", help="Product of still water.")] = None,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", "-c", help="Calibration record; default: the one stored in the run."),
    ] = None,
    correction: Annotated[
        list[Path] | None,
        typer.Option("--correction", help="Correction file that the product was made with; repeatable."),
    ] = None,
    title: Annotated[str, typer.Option("--title", help="Heading of the page.")] = "",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing page.")] = False,
) -> None:
    """Write one self-contained HTML page about a product."""
    from thermacq.report import write_report

    if not overwrite:
        _must_be_new(output)
    with err.status("making the report"):
        notes = write_report(
            product,
            output,
            run=run,
            still=still,
            calibration=calibration,
            correction_files=correction or (),
            title=title,
        )
    for note in notes:
        warn(note)
    out.print(f"report: {output} ({output.stat().st_size / 1e6:.1f} MB)", markup=False)


def _must_be_new(path: Path) -> None:
    from thermacq.errors import StoreError

    if path.exists():
        raise StoreError(f"'{path}' exists", kept="It was not touched.", remedy="Choose another name.")


def _show_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.measure import Measurement
    from rich.table import Table

    table = Table(*(escape(column) for column in columns), box=None, pad_edge=False)
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    # A table is never squeezed: in a file or a narrow terminal, long lines read better than broken cells.
    width = Measurement.get(out, out.options.update(max_width=10_000), table).maximum
    Console(highlight=False, width=width).print(table)


def _comparison_values(comparison: Comparison) -> dict[str, Any]:
    return {
        "measured": comparison.measured_name,
        "reference": comparison.reference_name,
        "height_error": comparison.height_error,
        "period_error": comparison.period_error,
        "amplitude_ratio": comparison.amplitude_ratio,
        "missing_fraction": comparison.missing_fraction,
        "agreement": asdict(comparison.agreement),
        "lag": asdict(comparison.lag),
        "measured_waves": asdict(comparison.measured_waves),
        "reference_waves": asdict(comparison.reference_waves),
    }


def _plain(value: Any) -> Any:
    """The same without NaN, which JSON does not know."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _write_pairs(path: Path, comparisons: Sequence[Comparison]) -> None:
    _must_be_new(path)
    rows = (
        (comparison.measured_name, comparison.reference_name, time, measured, reference)
        for comparison in comparisons
        for time, measured, reference in zip(
            comparison.time_s, comparison.measured_m, comparison.reference_m, strict=True
        )
    )
    _write_csv(path, ("measured", "reference", "time_s", "measured_m", "reference_m"), rows)


def _write_csv(path: Path, columns: Sequence[str], rows: Any) -> None:
    """Write rows with six decimals; missing values are empty cells."""
    import csv

    def text(value: Any) -> str:
        if not isinstance(value, float):
            return str(value)
        return "" if math.isnan(value) else f"{value:.6f}"

    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([text(value) for value in row] for row in rows)
