"""``thermacq calibrate probe`` and ``probe-drift``: static calibration of a wave probe, and its drift."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermacq.cli.common import AsJson, err, out, print_json, warn

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from thermacq.evaluation.probe_steps import ProbeSteps
    from thermacq_calibration.probes.probe_record import CoefficientSpread, ProbeCalibration

_LEAST_HISTORY = 3
_RUN_SUFFIXES = (".h5", ".hdf5", ".nxs")


def probe(
    source: Annotated[
        Path, typer.Argument(metavar="RUN|TABLE", help="Run file, or a text file with columns of numbers.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Probe calibration to write (JSON); must not exist yet.")
    ],
    immersion: Annotated[
        str | None,
        typer.Option(help="Depths of the steps in metres, in their order: 0,0.05,0.1 (deeper is larger)."),
    ] = None,
    immersion_column: Annotated[
        str | None,
        typer.Option(help="Text file: column of the immersions, one row for each reading or sample."),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--probe", help="Probe of the run; default: its only one.")
    ] = None,
    channel: Annotated[
        str | None, typer.Option(help="Channel of the probe, or column of the raw values in a text file.")
    ] = None,
    rate_hz: Annotated[
        float | None, typer.Option(min=0, help="Text file without times: samples a second.")
    ] = None,
    history: Annotated[
        Path | None, typer.Option(help="Folder of earlier calibrations: prints the spread of coefficients.")
    ] = None,
    toml: Annotated[Path | None, typer.Option(help="Rig table [probes.NAME] to write as well.")] = None,
    as_json: AsJson = False,
) -> None:
    """Calibrate a wave probe by static immersion: straight line from raw values to metres, with its errors."""
    from thermacq.outputs import check_new_file
    from thermacq_calibration.probes.probe_line import fit_probe_line, judge_line
    from thermacq_calibration.probes.probe_record import ProbeCalibration

    for path in (output, toml):
        if path is not None:
            check_new_file(path)
    found = _readings(source, immersion, immersion_column, name, channel, rate_hz)
    made = ProbeCalibration(
        probe=found.probe,
        serial=found.serial,
        channel=found.channel,
        unit=found.unit,
        steps=tuple(found.steps),
        line=fit_probe_line(found.steps),
        source=found.source,
        created=found.created,
    )
    records = [] if history is None else _earlier(history, made)
    spread = _spread([*records, made])
    table = _rig_table(made, spread)
    made.save(output)
    if toml is not None:
        toml.write_text(table, encoding="utf-8")
    if as_json:
        print_json({**made.to_dict(), "spread": spread and vars(spread), "rig_table": table})
    else:
        _show(made)
        if history is not None:
            _show_history([*records, made], spread)
        out.print("\nfor the rig file:\n")
        out.print(table, markup=False, end="")
    for sentence in judge_line(made.line):
        warn(sentence)
    err.print(f"wrote {output}")


def probe_drift(
    before: Annotated[Path, typer.Argument(help="Probe calibration made before the run.")],
    after: Annotated[Path, typer.Argument(help="Probe calibration made after it.")],
    as_json: AsJson = False,
) -> None:
    """Compare two calibrations of a probe: whether its zero or its coefficient drifted.

    Exit status 3 when either changed by more than twice the standard uncertainty of the change.
    """
    from thermacq.cli.common import EXIT_FINDINGS
    from thermacq_calibration.probes.probe_record import load_probe_calibration, probe_drift

    drift = probe_drift(load_probe_calibration(before), load_probe_calibration(after))
    drifted = drift.zero_significant or drift.coefficient_significant
    if as_json:
        flags = {
            "zero_significant": drift.zero_significant,
            "coefficient_significant": drift.coefficient_significant,
        }
        print_json({**vars(drift), **flags})
    else:
        for what, change, uncertainty, unit, significant in (
            ("zero", 1000 * drift.zero_m, 1000 * drift.zero_u_m, "mm", drift.zero_significant),
            (
                "coefficient",
                100 * drift.coefficient_rel,
                100 * drift.coefficient_u_rel,
                "%",
                drift.coefficient_significant,
            ),
        ):
            verdict = "drifted" if significant else "no drift that could be told"
            out.print(
                f"{what:>12}  {change:+.3f} ± {uncertainty:.3f} {unit} (standard uncertainty): {verdict}"
            )
    if drifted:
        raise typer.Exit(EXIT_FINDINGS)


def _readings(
    source: Path,
    immersion: str | None,
    immersion_column: str | None,
    name: str | None,
    channel: str | None,
    rate_hz: float | None,
) -> ProbeSteps:
    from thermacq.errors import ImportDataError
    from thermacq.evaluation import probe_steps

    if (immersion is None) == (immersion_column is None):
        raise typer.BadParameter("give the immersions: --immersion 0,0.05,0.1 or --immersion-column NAME")
    if not source.is_file():
        raise ImportDataError(f"there is no file '{source}'", kept="No file was written.")
    if immersion_column is not None:
        return probe_steps.steps_of_table(source, immersion_column, channel)
    depths = _depths(immersion or "")
    if source.suffix.lower() in _RUN_SUFFIXES:
        return probe_steps.steps_of_run(source, depths, name, channel)
    return probe_steps.steps_of_series(source, depths, channel, rate_hz)


def _depths(text: str) -> np.ndarray:
    import numpy as np

    try:
        return np.array([float(word) for word in text.split(",")])
    except ValueError:
        raise typer.BadParameter(f"--immersion {text}: write depths in metres like 0,0.05,0.1") from None


def _earlier(folder: Path, made: ProbeCalibration) -> list[ProbeCalibration]:
    """Earlier calibrations of the same probe in a folder, oldest first; other files are passed over."""
    from thermacq.errors import StoreError
    from thermacq_calibration import CalibrationError
    from thermacq_calibration.probes.probe_record import load_probe_calibration, probe_drift

    if not folder.is_dir():
        raise StoreError(f"there is no folder '{folder}'", kept="No file was written.")
    found = {}
    for path in sorted(folder.glob("*.json")):
        try:
            record = load_probe_calibration(path)
            probe_drift(record, made)
        except CalibrationError as error:
            warn(f"not in the history: {path.name}: {error.what}")
            continue
        # The same readings calculated twice are one calibration.
        found[record.steps] = record
    found.pop(made.steps, None)
    return sorted(found.values(), key=lambda record: record.created)


def _spread(records: Sequence[ProbeCalibration]) -> CoefficientSpread | None:
    from thermacq_calibration.probes.probe_record import coefficient_spread

    return coefficient_spread(records) if len(records) >= _LEAST_HISTORY else None


def _rig_table(made: ProbeCalibration, spread: CoefficientSpread | None) -> str:
    """The rig's table; its uncertainty is that of the line, or the spread from time to time if that is larger."""
    line = made.line
    uncertainty = max(line.coefficient_u_rel, spread.sd_rel if spread else 0.0)
    channel = f'channel = "{made.channel}"\n' if made.channel.isidentifier() else ""
    return (
        f"[probes.{made.probe or 'NAME'}]\n{channel}"
        f"coefficient_m_per_unit = {line.coefficient_m_per_unit:.8g}\n"
        f"coefficient_u_rel = {uncertainty:.3g}\n"
        f"zero_raw = {line.zero_raw:.8g}\n"
    )


def _show(made: ProbeCalibration) -> None:
    from rich.table import Table

    line, unit = made.line, made.unit or "units"
    table = Table("step", "immersion mm", f"raw {unit}", "± raw", "residual mm", "seconds", box=None)
    for number, (step, residual) in enumerate(zip(made.steps, line.residuals_m, strict=True), start=1):
        seconds = f"{step.start_s:.1f} - {step.stop_s:.1f}" if step.stop_s > step.start_s else ""
        table.add_row(
            str(number),
            f"{1000 * step.immersion_m:.2f}",
            f"{step.raw:.6g}",
            f"{step.raw_u:.2g}",
            f"{1000 * residual:+.3f}",
            seconds,
        )
    out.print(table)
    coefficient = line.coefficient_m_per_unit
    out.print(
        f"coefficient {coefficient:.8g} m per {unit}, standard uncertainty {100 * line.coefficient_u_rel:.3g} % "
        f"(95 %: ± {100 * line.interval:.3g} %)"
    )
    zero_u_mm = 1000 * abs(coefficient) * line.zero_u_raw
    out.print(f"zero {line.zero_raw:.8g} {unit} ± {line.zero_u_raw:.2g} ({zero_u_mm:.3f} mm)")
    bend = "" if line.curvature is None else f", bends by {100 * line.curvature:+.3f} % of the span"
    out.print(
        f"residuals {1000 * line.rms_residual_m:.3f} mm RMS, linearity {100 * line.linearity:.3f} % of the span{bend}"
    )
    if line.hysteresis_m is not None:
        out.print(f"raised less lowered: {1000 * line.hysteresis_m:+.3f} mm")


def _show_history(records: Sequence[ProbeCalibration], spread: CoefficientSpread | None) -> None:
    from rich.table import Table

    table = Table("calibrated", "coefficient", "± %", "zero", "source", box=None)
    for record in records:
        table.add_row(
            record.created,
            f"{record.line.coefficient_m_per_unit:.8g}",
            f"{100 * record.line.coefficient_u_rel:.3g}",
            f"{record.line.zero_raw:.6g}",
            record.source,
        )
    out.print()
    out.print(table)
    if spread is None:
        out.print(f"{len(records)} calibrations: a spread needs {_LEAST_HISTORY}")
        return
    out.print(
        f"spread of {spread.count} coefficients: standard deviation {100 * spread.sd_rel:.3g} %, "
        f"range {100 * spread.range_rel:.3g} %; mean {spread.mean_m_per_unit:.8g}"
    )
