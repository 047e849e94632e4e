"""Corrections of all cameras of a rig, made from recorded runs of uniform views and written together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thermacq.errors import CorrectionError
from thermacq.imaging.references import Reference, middle_time, serials_of, views_of

if TYPE_CHECKING:
    from thermacq_calibration import CameraCorrection, ReferenceView, Uniformity


@dataclass(frozen=True)
class Made:
    """A new correction, and how uniform the held-out view becomes with it; None without such a view."""

    correction: CameraCorrection
    checked: Uniformity | None


def make_corrections(
    cold: Reference,
    hot: Reference | None = None,
    *,
    check: Reference | None = None,
    uniform: Reference | None = None,
    shutter: Reference | None = None,
) -> dict[str, Made]:
    """Make the correction of every camera of a run.

    Parameters
    ----------
    cold, hot
        Uniform views at two temperatures (two-point); without `hot`, offsets only (one-point).
    check
        A view at a third temperature: it judges the result, and outlying pixels show in it.
    uniform
        A view from which shading is found after that.
    shutter
        The cameras' internal shutters at the time of the views, for later updates of the offsets.

    Returns
    -------
    dict
        By name of the camera in the run of the cold view.

    Raises
    ------
    CorrectionError, StoreError
        A run cannot be read, was taken with other cameras, or has no such frames.
    thermacq_calibration.CalibrationError
        The views cannot make a correction; says why.
    """
    from thermacq_calibration import make_correction, uniformity, with_shading

    if check is not None and check in (cold, hot):
        raise CorrectionError(
            f"--check names the same frames of '{check.path}' as --cold or --hot: what is left there is nothing, "
            "by construction",
            kept="Nothing was written.",
            remedy="Give a view that was not used, at a third temperature.",
        )
    serials = serials_of(cold.path)
    given = {"cold": cold, "hot": hot, "check": check, "uniform": uniform, "shutter": shutter}
    references = {what: reference for what, reference in given.items() if reference is not None}
    seen = {what: _views_of_cameras(reference, serials, cold.path) for what, reference in references.items()}
    made = {}
    for camera, serial in serials.items():
        views = {what: by_camera[camera] for what, by_camera in seen.items()}
        if "hot" in views:
            _check_order(views["cold"], views["hot"])
        correction = make_correction(
            [views[what] for what in ("cold", "hot") if what in views],
            views.get("check"),
            serial=serial,
            camera=camera,
            shutter=views.get("shutter"),
            made_from=_sources(references),
        )
        if "uniform" in views:
            correction = with_shading(correction, views["uniform"])
        checked = None
        if "check" in views:
            checked = uniformity(correction, views["check"])
            figures = {**correction.made_from, "check": checked.as_dict()}
            correction = replace(correction, made_from=figures)
        made[camera] = Made(correction, checked)
    return made


def update_correction(
    correction: CameraCorrection, shutter: Reference, *, behind_lens: bool
) -> CameraCorrection:
    """New offsets from a later run of a uniform view; raises as `make_corrections`."""
    from thermacq_calibration import update_offset

    view = view_of_camera(shutter, correction.serial, correction.camera)
    updated = update_offset(correction, view, behind_lens=behind_lens)
    origin = _sources({"shutter": shutter})["runs"]["shutter"]
    return replace(updated, made_from={**updated.made_from, "offset_run": origin})


def save_together(corrections: Mapping[Path, CameraCorrection]) -> None:
    """Write all files or none.

    Raises
    ------
    CorrectionError
        One of them exists.
    thermacq_calibration.CalibrationError
        One cannot be written; those written before are removed.
    """
    for path in corrections:
        if path.exists():
            raise CorrectionError(
                f"'{path}' exists already", kept="Nothing was written.", remedy="Choose another name."
            )
    written: list[Path] = []
    try:
        for path, correction in corrections.items():
            correction.save(path)
            written.append(path)
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        raise


def view_of_camera(reference: Reference, serial: str, camera: str) -> ReferenceView:
    """What a reference shows to one camera, found by its serial number; raises as `make_corrections`."""
    return _views_of_cameras(reference, {camera: serial}, None)[camera]


def _views_of_cameras(
    reference: Reference, serials: Mapping[str, str], made_with: Path | None
) -> dict[str, ReferenceView]:
    """Views by the names in `serials`, whatever the cameras are called in the reference's run."""
    there = serials_of(reference.path)
    names = {}
    for camera, serial in serials.items():
        found = next((name for name, other in there.items() if serial and other == serial), None)
        if found is None and camera in there and not (serial and there[camera]):
            found = camera
        if found is None:
            known = ", ".join(f"{name} is {other or 'unknown'}" for name, other in there.items())
            origin = f" of '{made_with}'" if made_with else ""
            raise CorrectionError(
                f"camera '{camera}' (serial {serial or 'unknown'}){origin} did not take part in "
                f"'{reference.path}' ({known})",
                kept="Nothing was written.",
                remedy="Use views of one and the same cameras.",
            )
        names[camera] = found
    views = views_of(reference, list(names.values()))
    return {camera: views[name] for camera, name in names.items()}


def _check_order(cold: ReferenceView, hot: ReferenceView) -> None:
    import numpy as np

    # Views that are hardly apart have no order; why they make no gains is said elsewhere.
    apart = 10 * float(np.median(cold.noise))
    warmer_k = None
    if cold.temperature_k is not None and hot.temperature_k is not None:
        warmer_k = hot.temperature_k - cold.temperature_k
    if (warmer_k is None and np.median(hot.mean) < np.median(cold.mean) - apart) or (
        warmer_k is not None and warmer_k < 0
    ):
        raise CorrectionError(
            f"{cold.label}, given as the cold one, is warmer than {hot.label}",
            kept="Nothing was written.",
            remedy="Exchange --cold and --hot.",
        )


def _sources(references: Mapping[str, Reference]) -> dict[str, Any]:
    from thermacq.store import open_run

    runs = {}
    for what, reference in references.items():
        with open_run(reference.path) as run:
            runs[what] = {
                "run": run.path.name,
                "run_id": run.header.run_id,
                "middle_time": middle_time(reference),
                "simulated": run.header.simulated,
                "temperature_k": reference.temperature_k,
            }
    return {"runs": runs}
