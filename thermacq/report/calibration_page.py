"""The page about a calibration: one HTML file that needs nothing from anywhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import StoreError
from thermacq.report import calibration_figures as drawings

if TYPE_CHECKING:
    from thermacq_calibration import StereoCalibration

_REJECTED, _WORST, _BEST = 3, 2, 1
"""So many pictures of each kind of view are shown."""


@dataclass(frozen=True, eq=False)
class ShownView:
    """Both pictures of a view, (rows, columns) counts."""

    name: str
    left: NDArray[Any]
    right: NDArray[Any]


def views_to_show(calibration: StereoCalibration) -> list[str]:
    """Names of views worth a look: some that were left out, the worst and the best of the others."""
    used = [view for view in calibration.views if view.used]
    by_error = sorted(used, key=lambda view: -max(view.left_rms_px or 0.0, view.right_rms_px or 0.0))
    left_out = [view.name for view in calibration.views if not view.used][:_REJECTED]
    kept = by_error[:_WORST] + by_error[_WORST:][-_BEST:]
    return left_out + [view.name for view in kept]


def write_calibration_page(
    calibration: StereoCalibration, output: Path, shown: Sequence[ShownView] = ()
) -> None:
    """Write the page about a calibration.

    Parameters
    ----------
    calibration
        The record.
    output
        HTML file to write; it appears only when it is complete.
    shown
        Pictures to show with their corners.

    Raises
    ------
    StoreError
        The page cannot be written.
    """
    page = render(calibration, shown)
    unfinished = output.with_name(output.name + ".part")
    try:
        unfinished.write_text(page, encoding="utf-8")
        unfinished.replace(output)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise StoreError(f"'{output}' cannot be written: {error.strerror}") from None


def render(calibration: StereoCalibration, shown: Sequence[ShownView] = ()) -> str:
    """The page as HTML text; all text of the record passes through Jinja's escaping."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from thermacq_calibration import findings
    from thermacq_calibration.geometry.acceptance import acceptance, verdict

    environment = Environment(
        loader=PackageLoader("thermacq.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    rows = acceptance(calibration)
    figures, enlarged = _figures(calibration)
    return environment.get_template("calibration.html").render(
        calibration=calibration,
        findings=findings(calibration),
        acceptance=[(row.measure, row.value, row.passes, row.excels, row.verdict.value) for row in rows],
        verdict=verdict(rows).value,
        headlines=_headlines(calibration),
        figures=figures,
        enlarged=enlarged,
        uncertainties=_uncertainties(calibration),
        scores=_scores(calibration),
        views=[_view_row(view) for view in calibration.views],
        pictures=[_pictures(calibration, view) for view in shown],
    )


def _headlines(calibration: StereoCalibration) -> list[tuple[str, str, str]]:
    """Name, value and what stands beside it."""
    baseline, depth, elevation = (
        _plus_minus(calibration.standard_uncertainty(key)) for key in ("baseline_m", "depth_m", "elevation_m")
    )
    distance = "the working distance"
    if calibration.working_distance_m:
        distance = f"{calibration.working_distance_m:g} m"
    return [
        ("baseline", f"{1000 * calibration.baseline_m:.3f} mm", baseline),
        ("stereo RMS", _pixels(calibration.rms_px), "alone it judges nothing"),
        ("rows, held out", _pixels(calibration.held_out_vertical_rms_px), "after rectification"),
        (f"depth at {distance}", depth, "standard uncertainty of the mean"),
        ("elevation", elevation, "standard uncertainty at a crest"),
    ]


def _figures(calibration: StereoCalibration) -> tuple[dict[str, Any], float]:
    """Figures by name, as far as the record has their data; and how much arrows are enlarged."""
    from markupsafe import Markup

    from thermacq_calibration.geometry.residuals import residuals

    drawn, enlarged = {}, 1.0
    found = residuals(calibration)
    if any(view.used for view in found):
        drawn["coverage"] = drawings.coverage(found, calibration.image_size)
        drawn["residuals"], enlarged = drawings.residual_arrows(found, calibration.image_size)
    if calibration.uncertainty:
        drawn["uncertainty"] = drawings.uncertainty_map(calibration)
    if any(view.used and view.tilt_deg is not None for view in calibration.views):
        drawn["poses"] = drawings.poses(calibration)
    # Safe because no text from a file is in a figure.
    return {name: Markup(text) for name, text in drawn.items()}, enlarged


def _uncertainties(calibration: StereoCalibration) -> list[tuple[str, str, str]]:
    """Quantity, standard uncertainty by bootstrap and by the covariance of the fit."""
    known = calibration.uncertainty or {}
    by_fit = known.get("from_covariance") or {}
    return [
        (quantity, f"{value:.3g}", f"{by_fit[quantity]:.3g}" if quantity in by_fit else "-")
        for quantity, value in (known.get("standard") or {}).items()
    ]


def _scores(calibration: StereoCalibration) -> list[tuple[str, str, str, str]]:
    """Candidate, held-out error, excess with its standard error, and whether it was chosen."""
    known = calibration.distortion or {}
    return [
        (
            score["model"],
            f"{score['held_out_rms_px']:.4f} px",
            f"{score['excess_px2']:.2e} ± {score['excess_se_px2']:.1e} px²",
            "chosen"
            if score["model"] == known["model"]
            else ("" if score["determined"] else "not determined by these views"),
        )
        for score in known.get("scores") or []
    ]


def _view_row(view: Any) -> tuple[str, ...]:
    numbers = (view.left_rms_px, view.right_rms_px, view.vertical_rms_px, view.held_out_vertical_rms_px)
    tilt = "-" if view.tilt_deg is None else f"{view.tilt_deg:.0f}°"
    distance = "-" if view.distance_m is None else f"{view.distance_m:.3f} m"
    return (view.name, *map(_pixels, numbers), tilt, distance, "used" if view.used else view.reason)


def _pictures(calibration: StereoCalibration, view: ShownView) -> dict[str, Any]:
    report = next(one for one in calibration.views if one.name == view.name)
    corners = (calibration.corners or {}).get(view.name, {})
    addresses = [
        drawings.corners_picture(picture, np.array(corners[side], np.float64) if corners else None)
        for side, picture in (("left", view.left), ("right", view.right))
    ]
    said = "used" if report.used else f"not used: {report.reason}"
    return {"name": view.name, "said": said, "addresses": addresses}


def _plus_minus(value_m: float | None) -> str:
    return "σ not known" if value_m is None else f"σ {1000 * value_m:.3g} mm"


def _pixels(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f} px"
