"""How ``thermacq calibrate`` and ``thermacq calibration`` show records, differences and checks."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from thermacq.cli.common import out, warn

if TYPE_CHECKING:
    from thermacq.reconstruction.calibration_check import CalibrationCheck
    from thermacq_calibration import StereoCalibration
    from thermacq_calibration.geometry.differences import Change, Difference

_COLOURS = {"excellent": "green", "pass": "green", "fail": "bold red", "unknown": "yellow"}


def record_values(calibration: StereoCalibration, still_water_sigma_m: float | None = None) -> dict[str, Any]:
    """The record and its acceptance table as plain values, for JSON."""
    from thermacq_calibration.geometry.acceptance import acceptance, table_values

    return {**calibration.to_dict(), "acceptance": table_values(acceptance(calibration, still_water_sigma_m))}


def show_record(calibration: StereoCalibration, still_water_sigma_m: float | None = None) -> None:
    """Print a record: its views, its figures, and the acceptance table."""
    from rich.markup import escape
    from rich.table import Table

    table = Table("view", "left px", "right px", "rows px", "held out px", "tilt", "distance", "", box=None)
    for view in calibration.views:
        numbers = (view.left_rms_px, view.right_rms_px, view.vertical_rms_px, view.held_out_vertical_rms_px)
        table.add_row(
            escape(view.name),
            *(_number(value, ".3f") for value in numbers),
            _number(view.tilt_deg, ".0f", " deg"),
            _number(view.distance_m, ".3f", " m"),
            "used" if view.used else "not used",
        )
    if calibration.views:
        out.print(table)
    for view in calibration.views:
        if view.reason:
            out.print(f"view {escape(view.name)} not used: {escape(view.reason)}")
    for name, value in _figures(calibration) + _uncertainties(calibration):
        out.print(f"{name:>24}  {escape(value)}")
    _show_acceptance(calibration, still_water_sigma_m)


def _show_acceptance(calibration: StereoCalibration, still_water_sigma_m: float | None) -> None:
    from thermacq_calibration.geometry.acceptance import acceptance, verdict

    rows = acceptance(calibration, still_water_sigma_m)
    if not rows:
        return
    cells = [("acceptance", "value", "pass", "excellent")]
    cells += [(row.measure, row.value, row.passes, row.excels) for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    verdicts = ["verdict", *(_coloured(row.verdict.value) for row in rows)]
    out.print()
    for cell, said in zip(cells, verdicts, strict=True):
        padded = (text.ljust(width) for text, width in zip(cell, widths, strict=True))
        out.print("  ".join([*padded, said]))
    out.print(f"as a whole: {_coloured(verdict(rows).value)}")


def _coloured(said: str) -> str:
    return f"[{_COLOURS[said]}]{said}[/]"


def _uncertainties(calibration: StereoCalibration) -> list[tuple[str, str]]:
    """Standard uncertainties in words; empty while they are not known."""
    if calibration.uncertainty is None:
        return []
    known = calibration.uncertainty
    sigma = calibration.standard_uncertainty

    def said(quantity: str, scale: float = 1.0) -> str:
        return _number(None if (value := sigma(quantity)) is None else scale * value, ".3g")

    focal = ", ".join(said(f"{side}_{axis}_px") for side in ("left", "right") for axis in ("fx", "fy"))
    centre = ", ".join(said(f"{side}_{axis}_px") for side in ("left", "right") for axis in ("cx", "cy"))
    turn = ", ".join(said(f"rotation_{axis}_deg") for axis in "xyz")
    return [
        ("standard uncertainties", f"{known['method']}, {known['replicates']} times"),
        ("of the baseline", f"{said('baseline_m', 1e3)} mm"),
        ("of focal lengths", f"{focal} px (left fx, fy, right fx, fy)"),
        ("of principal points", f"{centre} px (left u, v, right u, v)"),
        ("of the rotation", f"{turn} deg (about x, y, z)"),
        (
            f"of depth at {known['working_distance_m']:g} m",
            f"{said('depth_m', 1e3)} mm in the mean, {said('depth_point_m', 1e3)} mm at a point",
        ),
        ("of elevation", f"{said('elevation_m', 1e3)} mm at a crest {1000 * known['crest_m']:g} mm high"),
    ]


def show_difference(changes: list[Change], difference: Difference) -> None:
    """Print how two calibrations differ."""
    from rich.table import Table

    table = Table("quantity", "first", "second", "difference", "in σ", box=None)
    for change in changes:
        table.add_row(
            change.quantity,
            f"{change.first:.6g}",
            f"{change.second:.6g}",
            f"{change.second - change.first:+.3g}",
            _number(change.in_sigmas, "+.1f"),
        )
    out.print(table)
    out.print()
    for side, values in (("left", difference.left_px), ("right", difference.right_px)):
        out.print(f"distance of projections over the {side} picture, px:")
        for row in values[::3, ::3]:
            out.print("  " + " ".join(f"{value:6.3f}" if isfinite(value) else "     -" for value in row))
    out.print(f"projections differ by {difference.rms_px:.3f} px (RMS), {difference.worst_px:.3f} px at most")
    out.print(f"depth at the working distance differs by {1000 * difference.depth_m:+.3f} mm")


def show_check(check: CalibrationCheck) -> None:
    """Print whether rows still agree."""
    found = check.agreement
    low, high = found.disparities_px
    difference = f"{found.median_px:+.3f} px (median), ± {found.standard_error_px:.3f}"
    trend = f"{found.across_px:+.3f} px from left to right, {found.down_px:+.3f} px from top to bottom"
    rows = [
        ("matches", f"{found.matches} in {check.pairs} pair(s), disparity {low:.1f} to {high:.1f} px"),
        ("rows, left less right", f"{difference}; scatter {found.mad_px:.3f} px (MAD)"),
        ("trend", trend),
        ("over the picture", f"{found.systematic_px:.3f} px (RMS of median and trend), 0.25 px will do"),
        (
            "cameras",
            "temperature against the calibration is not known"
            if check.warmer_k is None
            else "left {:+.1f} K, right {:+.1f} K against the calibration".format(*check.warmer_k),
        ),
    ]
    for name, value in rows:
        out.print(f"{name:>24}  {value}")
    out.print(f"{'':>24}  " + ("[green]fits[/]" if found.fits else "[bold red]does not fit[/]"))


def _figures(calibration: StereoCalibration) -> list[tuple[str, str]]:
    left, right = calibration.left, calibration.right
    used = sum(view.used for view in calibration.views)
    board = calibration.board
    translation = ", ".join(f"{value:.5f}" for value in calibration.translation_m)
    figures = [
        ("pictures", "{} x {} px".format(*calibration.image_size)),
        ("baseline", f"{calibration.baseline_m:.6g} m"),
        ("translation", f"({translation}) m"),
        ("focal lengths", f"{left.matrix[0, 0]:.2f}, {right.matrix[0, 0]:.2f} px (left, right)"),
        (
            "cameras",
            ", ".join(calibration.serials) + " (left, right)" if calibration.serials else "not known",
        ),
        ("distortion", str((calibration.distortion or {}).get("model", "as given"))),
        ("source", calibration.source),
        ("created", calibration.created),
        ("sha256", calibration.sha256),
    ]
    if board is None:
        return figures
    coverage = calibration.coverage or (0.0, 0.0)
    stereo, left_alone, right_alone, rows, held_out = (
        _number(value, ".3f", " px")
        for value in (
            calibration.rms_px,
            left.rms_px,
            right.rms_px,
            calibration.vertical_rms_px,
            calibration.held_out_vertical_rms_px,
        )
    )
    return [
        ("board", f"{board.columns} x {board.rows} inner corners, {board.square_m:g} m squares"),
        ("views used", f"{used} of {len(calibration.views)}, {calibration.poses or used} different poses"),
        ("RMS", f"{stereo} stereo, {left_alone} left alone, {right_alone} right alone"),
        ("rows after rectification", f"{rows}, {held_out} held out"),
        ("coverage", f"{coverage[0]:.0%} left, {coverage[1]:.0%} right"),
        *figures,
    ]


def advise(calibration: StereoCalibration) -> None:
    """Warn of what looks wrong or weak."""
    from thermacq_calibration import findings

    for sentence in findings(calibration):
        warn(sentence)


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"
