"""Whether a correction still serves: residual non-uniformity, age, temperature, and how fast it grows old.

Fixed-pattern noise grows with the time since the correction, as a power law and a linear part (SPIE
12533-0T), whose coefficients belong to the single camera. Views at four ages or more give them. With fewer,
what has grown since the correction was made is extended in proportion to time, which is too much rather than
too little where the power is below one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from thermacq.errors import CorrectionError
from thermacq.imaging.corrections import LARGEST_WARMING_K
from thermacq.imaging.making import view_of_camera
from thermacq.imaging.references import Reference, middle_time

if TYPE_CHECKING:
    from thermacq_calibration import CameraCorrection, Uniformity

LARGEST_RESIDUAL_NETD = 0.5
LARGEST_GROWTH_NETD = 0.5
_YOUNGEST_S = 60.0
"""Growth within less time than this says nothing about a recording."""


@dataclass(frozen=True)
class Condition:
    """State of a correction at the time of a run.

    Parameters
    ----------
    uniformity
        Residual non-uniformity of the run's uniform view.
    age_s
        From the views behind the offsets to the run; None where either time is unknown.
    warming_k
        Focal plane now less that at the time of the views; None where unknown.
    new_bad_pixels
        Pixels that became bad since.
    growth_netd
        What has been added to the residual since it was made (in quadrature), over the temporal noise; None
        where the residual then is not known.
    predicted_netd
        The same for the recording that is planned; None where it cannot be told.
    planned_s
        Length of that recording.
    warnings
        Why the correction should be made anew; empty when it serves.
    """

    uniformity: Uniformity
    age_s: float | None
    warming_k: float | None
    new_bad_pixels: int
    growth_netd: float | None
    predicted_netd: float | None
    planned_s: float
    warnings: tuple[str, ...]

    def lines(self) -> list[str]:
        """What there is to say, for a person."""
        age = "unknown" if self.age_s is None else _duration(self.age_s)
        warming = "unknown" if self.warming_k is None else f"{self.warming_k:+.2f} K"
        grown = "unknown" if self.growth_netd is None else f"{self.growth_netd:.2f} of the temporal noise"
        predicted = "cannot be predicted"
        if self.predicted_netd is not None:
            predicted = f"about {self.predicted_netd:.2f} of it"
        return [
            f"age {age}, focal plane {warming} since; {self.new_bad_pixels} new bad pixels",
            f"grown since it was made: {grown}; in {_duration(self.planned_s)} more: {predicted}",
        ]


def judge_correction(
    correction: CameraCorrection, references: Sequence[Reference], planned_s: float
) -> Condition:
    """Judge a correction by runs of a uniform view.

    Parameters
    ----------
    correction
        The correction.
    references
        Frames of a uniform view of the same camera, at several times if the growth is to be measured. The
        last one is judged.
    planned_s
        Length of the recording that is planned.

    Raises
    ------
    CorrectionError, StoreError, thermacq_calibration.CalibrationError
        The run cannot be read, is one of another camera, or its frames cannot be judged.
    """
    from thermacq_calibration import CalibrationError, uniformity, with_outliers

    views = [view_of_camera(reference, correction.serial, correction.camera) for reference in references]
    view, all_found = views[-1], [uniformity(correction, one) for one in views]
    found = all_found[-1]
    try:
        worse = with_outliers(correction, view)
    except CalibrationError as error:
        raise CorrectionError(
            f"with this correction {view.label} is far from uniform: {error.what}",
            remedy="Record a uniform view: a blackbody, a cap, or even water without texture.",
        ) from None
    new_bad = int(np.count_nonzero((worse.bad_pixels > 0) & (correction.bad_pixels == 0)))
    ages_s = [_age_s(correction, reference) for reference in references]
    warming_k = None
    if view.fpa_temperature_k is not None and correction.fpa_temperature_k is not None:
        warming_k = view.fpa_temperature_k - correction.fpa_temperature_k
    growth_netd = _growth_netd(correction, found)
    age_s = ages_s[-1]
    predicted_netd = _measured_growth_netd(ages_s, all_found, planned_s)
    if predicted_netd is None and growth_netd is not None and age_s is not None and age_s >= _YOUNGEST_S:
        predicted_netd = growth_netd * planned_s / age_s
    warnings = _warnings(found, warming_k, predicted_netd, planned_s)
    return Condition(
        found, age_s, warming_k, new_bad, growth_netd, predicted_netd, planned_s, tuple(warnings)
    )


def _warnings(
    found: Uniformity, warming_k: float | None, predicted_netd: float | None, planned_s: float
) -> list[str]:
    warnings = []
    if found.sigma_vh_per_netd > LARGEST_RESIDUAL_NETD:
        warnings.append(
            f"the residual non-uniformity is {found.sigma_vh_per_netd:.2f} of the temporal noise, more than "
            f"{LARGEST_RESIDUAL_NETD:g}: update the offsets by a view near the water's temperature, or make "
            "the correction from two views closer together around it"
        )
    if warming_k is not None and abs(warming_k) > LARGEST_WARMING_K:
        warnings.append(
            f"the focal plane is {warming_k:+.2f} K from where it was: let the camera settle, then update"
        )
    if predicted_netd is not None and predicted_netd > LARGEST_GROWTH_NETD:
        warnings.append(
            f"within {_duration(planned_s)} it may grow by {predicted_netd:.2f} of the temporal noise, more "
            f"than {LARGEST_GROWTH_NETD:g}: update the offsets right before and between recordings"
        )
    return warnings


def _age_s(correction: CameraCorrection, reference: Reference) -> float | None:
    """From the views behind the offsets to the middle of the frames; None where either time is unknown."""
    views = correction.made_from.get("offset_run") or _source(correction, "cold")
    seen = str(views.get("middle_time") or correction.offset_updated or correction.created)
    try:
        return (datetime.fromisoformat(middle_time(reference)) - datetime.fromisoformat(seen)).total_seconds()
    except (TypeError, ValueError):
        return None


def _measured_growth_netd(
    ages_s: Sequence[float | None], found: Sequence[Uniformity], planned_s: float
) -> float | None:
    """Growth by the law that views at several ages give, over the temporal noise; None with too few of them."""
    from thermacq_calibration.infrared.pattern_growth import FEWEST_AGES, fit_growth

    known: dict[float, float] = {}
    for age_s, one in zip(ages_s, found, strict=True):
        sigma_k = one.kelvin(one.sigma_vh_counts)
        if age_s is not None and age_s >= 0 and sigma_k is not None:
            known[age_s] = sigma_k
    noise_k = found[-1].kelvin(found[-1].noise_counts)
    if len(known) < FEWEST_AGES or not noise_k:
        return None
    return fit_growth(list(known), list(known.values())).growth_k(max(known), planned_s) / noise_k


def _growth_netd(correction: CameraCorrection, found: Uniformity) -> float | None:
    """Growth since the check that was made with the correction; none is known after an update."""
    then = correction.made_from.get("check")
    before = then.get("sigma_vh_counts") if isinstance(then, dict) else None
    if correction.offset_updated or not isinstance(before, int | float):
        return None
    return math.sqrt(max(0.0, found.sigma_vh_counts**2 - before**2)) / found.noise_counts


def _source(correction: CameraCorrection, what: str) -> dict[str, Any]:
    runs = correction.made_from.get("runs")
    found = runs.get(what) if isinstance(runs, dict) else None
    return found if isinstance(found, dict) else {}


def _duration(seconds: float) -> str:
    if abs(seconds) < 120:
        return f"{seconds:.0f} s"
    if abs(seconds) < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if abs(seconds) < 2 * 86400 else f"{seconds / 86400:.1f} days"
