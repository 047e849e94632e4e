"""Makes the correction of a camera from uniform views, and brings its offsets up to date.

Two-point correction, with <> the mean over good pixels and Y1, Y2 the temporal means of the two views:
G = (<Y2> - <Y1>) / (Y2 - Y1), O = <Y1> - G Y1, Z = G Y + O (Budzier and Gerlach, J. Sens. Sens. Syst. 4:187,
2015). One-point: G = 1. Bad pixels are searched after each stage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.infrared.bad_pixels import (
    Mask,
    blinking_pixels,
    dead_pixels,
    noisy_pixels,
    outlying_pixels,
    stuck_pixels,
)
from thermacq_calibration.infrared.correction import BadPixel, CameraCorrection, Picture
from thermacq_calibration.infrared.radiometry import radiometric_scale
from thermacq_calibration.infrared.reference_view import ReferenceView
from thermacq_calibration.infrared.uniformity import correct_mean

SMALLEST_SPAN_K = 1.0
_SMALLEST_SPAN_NOISE = 30.0
# Two views without known temperature must differ by so many times the temporal noise: about 1 K.
_LARGEST_BAD_SHARE = 0.05


def make_correction(
    views: Sequence[ReferenceView],
    check: ReferenceView | None = None,
    *,
    serial: str,
    camera: str,
    shutter: ReferenceView | None = None,
    made_from: Mapping[str, Any] | None = None,
) -> CameraCorrection:
    """Make the correction of one camera.

    Parameters
    ----------
    views
        One uniform view (one-point: offsets only) or two at different temperatures (two-point).
    check
        A third view at another temperature, best between the two: outlying pixels show there only. It does
        not go into gains and offsets.
    serial, camera
        Of the camera that took the views.
    shutter
        The camera's internal shutter at the time of the views, for later updates of the offsets.
    made_from
        Further plain values to keep in the record.

    Raises
    ------
    CalibrationError
        The views do not fit each other, are at equal or swapped temperatures, or too many pixels are bad.
    """
    if len(views) not in (1, 2):
        raise CalibrationError(
            f"a correction is made from one or two uniform views, not {len(views)}",
            remedy="Give further views for the check.",
        )
    extra = [view for view in (check, shutter) if view is not None]
    _check_sizes([*views, *extra])
    bad = _bad_in_time([*views, *extra])
    if len(views) == 1:
        gain = np.ones(views[0].mean.shape, np.float32)
    else:
        cold, hot = sorted(views, key=lambda view: float(np.median(view.mean)))
        _check_temperatures(cold, hot)
        response = hot.mean - cold.mean
        bad |= dead_pixels(response)
        gain = _gain(response, bad)
    _check_share(bad)
    level = float(views[0].mean[bad == 0].mean(dtype=np.float64))
    offset = np.where(_responds(bad), level - gain * views[0].mean, 0).astype(np.float32)
    correction = CameraCorrection(
        serial,
        camera,
        gain,
        offset,
        bad,
        shutter=None if shutter is None else shutter.mean,
        made_from={**(made_from or {}), "views": [view.facts for view in views]},
        fpa_temperature_k=_mean_or_none([view.fpa_temperature_k for view in views]),
    )
    correction = _with_scale(correction, [*views, *([] if check is None else [check])])
    if check is not None:
        correction = with_outliers(correction, check)
    return correction


def update_offset(
    correction: CameraCorrection, shutter: ReferenceView, behind_lens: bool = False
) -> CameraCorrection:
    """New offsets from a later uniform view; gains and bad pixels stay, new bad pixels are added.

    A cap, plate or blackbody before the lens shows all that changed: the corrected picture of it becomes flat.
    Where the temperature of the view and the radiometric scale are known, its level becomes right too,
    otherwise it stays.

    A shutter between lens and sensor is not seen through the lens. What changed since the shutter frames of
    the record is taken away, without its mean. The shutter is as warm as the housing, so a change of the
    housing's radiation is in it as well.

    Either way shading starts anew from none at the present temperature, with the growth per kelvin that it had;
    shading that did not depend on temperature is contained in the offsets now and dropped.

    Parameters
    ----------
    correction
        The record so far; it is left as it is.
    shutter
        The view.
    behind_lens
        Whether the shutter is one between lens and sensor.

    Raises
    ------
    CalibrationError
        Another size, or no shutter frames in the record where they are needed.
    """
    if shutter.mean.shape != correction.shape:
        raise CalibrationError(f"{shutter.label} has another size than the correction")
    bad = correction.bad_pixels | _bad_in_time([shutter])
    _check_share(bad)
    if behind_lens:
        change = _change_of_shutter(correction, shutter, bad == 0)
    else:
        change = _deviation_from_level(correction, shutter, bad == 0)
    return replace(
        correction,
        offset=np.where(_responds(bad), correction.offset - change, 0),
        bad_pixels=bad,
        # A shutter frame of another moment no longer belongs to offsets from a view before the lens.
        shutter=shutter.mean if behind_lens else None,
        fpa_temperature_k=shutter.fpa_temperature_k,
        made_from={**correction.made_from, "offset_view": {**shutter.facts, "behind_lens": behind_lens}},
        offset_updated=datetime.now(UTC).isoformat(timespec="seconds"),
        **_shading_from(correction, shutter.fpa_temperature_k),
    )


def _change_of_shutter(
    correction: CameraCorrection, shutter: ReferenceView, good: NDArray[np.bool_]
) -> Picture:
    """What the internal shutter shows differently than when the record was made, without the mean."""
    if correction.shutter is None:
        raise CalibrationError(
            f"the correction of camera '{correction.camera}' does not know its shutter when it was made",
            remedy="Make it again with shutter frames, or update from a uniform view before the lens.",
        )
    change = correction.gain * (shutter.mean - correction.shutter)
    change -= change[good].mean(dtype=np.float64)
    return change


def _deviation_from_level(
    correction: CameraCorrection, view: ReferenceView, good: NDArray[np.bool_]
) -> Picture:
    """What a corrected uniform view has beyond its true level, or beyond its mean where that is not known."""
    seen = correction.gain * view.mean + correction.offset
    level = float(seen[good].mean(dtype=np.float64))
    per_k, zero_k = correction.counts_per_kelvin, correction.kelvin_at_zero
    if view.temperature_k is not None and per_k is not None and zero_k is not None:
        level = (view.temperature_k - zero_k) * per_k
    return seen - np.float32(level)


def _shading_from(correction: CameraCorrection, now_k: float | None) -> dict[str, Any]:
    """The shading with its growth per kelvin, but none at the present temperature."""
    then_k, zero_k = correction.shading_temperature_k, correction.shading_zero_k
    if then_k is None or zero_k is None or now_k is None:
        return {"shading": None, "shading_temperature_k": None, "shading_zero_k": None}
    return {"shading_temperature_k": now_k + then_k - zero_k, "shading_zero_k": now_k}


def with_outliers(correction: CameraCorrection, view: ReferenceView) -> CameraCorrection:
    """The correction with pixels added that stay noisy, blink or lie apart in a corrected uniform view.

    Parameters
    ----------
    correction
        The record so far.
    view
        A uniform view at a temperature that did not go into the offsets.

    Raises
    ------
    CalibrationError
        The view has another size, or too many pixels are bad.
    """
    bad = correction.bad_pixels | _bad_in_time([view])
    correction = replace(correction, bad_pixels=bad)
    corrected = correct_mean(correction, view)
    bad = bad | outlying_pixels(corrected, bad)
    _check_share(bad)
    return replace(correction, bad_pixels=bad)


def _check_sizes(views: Sequence[ReferenceView]) -> None:
    for view in views[1:]:
        if view.mean.shape != views[0].mean.shape:
            raise CalibrationError(
                f"{view.label} and {views[0].label} have pictures of different sizes",
                remedy="Give views of one camera in one format.",
            )


def _check_temperatures(cold: ReferenceView, hot: ReferenceView) -> None:
    """Two views, ordered by their counts, must be far enough apart and ordered alike by temperature."""
    rise = float(np.median(hot.mean - cold.mean))
    if cold.temperature_k is not None and hot.temperature_k is not None:
        span_k = hot.temperature_k - cold.temperature_k
        if abs(span_k) < SMALLEST_SPAN_K:
            raise CalibrationError(
                f"{cold.label} and {hot.label} are less than {SMALLEST_SPAN_K:g} K apart: gains would be noise",
                remedy="Record the two at temperatures a few kelvin apart, around that of the water.",
            )
    noise = max(float(np.median(view.noise)) for view in (cold, hot))
    if rise < _SMALLEST_SPAN_NOISE * noise:
        raise CalibrationError(
            f"{cold.label} and {hot.label} differ by {abs(rise):.0f} counts only, at a noise of {noise:.1f}: "
            "gains would be noise",
            remedy="Check that both views were really taken, and are at temperatures a few kelvin apart.",
        )
    if (
        cold.temperature_k is not None
        and hot.temperature_k is not None
        and hot.temperature_k < cold.temperature_k
    ):
        raise CalibrationError(
            f"{hot.label} has {rise:.0f} counts more than {cold.label}, which is warmer",
            remedy="The temperatures of the two views may be swapped; correct them.",
        )


def _bad_in_time(views: Sequence[ReferenceView]) -> Mask:
    bad = np.zeros(views[0].mean.shape, np.uint8)
    for view in views:
        bad |= stuck_pixels(view) | noisy_pixels(view) | blinking_pixels(view)
    return bad


def _gain(response: Picture, bad: Mask) -> Picture:
    mean = response[bad == 0].mean(dtype=np.float64)
    gain = np.ones(response.shape, np.float32)
    np.divide(mean, response, out=gain, where=_responds(bad), casting="same_kind")
    return gain


def _responds(bad: Mask) -> NDArray[np.bool_]:
    """Where gain and offset mean something."""
    responds: NDArray[np.bool_] = (bad & BadPixel.DEAD) == 0
    return responds


def _check_share(bad: Mask) -> None:
    share = float((bad > 0).mean())
    if share > _LARGEST_BAD_SHARE:
        reasons = ", ".join(
            f"{((bad & reason) > 0).mean():.1%} {str(reason.name).lower()}" for reason in BadPixel
        )
        raise CalibrationError(
            f"{share:.1%} of the pixels would be bad ({reasons}): the views are hardly uniform or steady",
            remedy="Fill the whole picture with the reference, let it settle, and record again.",
        )


def _with_scale(correction: CameraCorrection, views: Sequence[ReferenceView]) -> CameraCorrection:
    """Add counts per kelvin and NETD where temperatures are known."""
    known = [view for view in views if view.temperature_k is not None]
    if len({view.temperature_k for view in known}) < 2:
        return correction
    good = correction.bad_pixels == 0
    levels = [float(correct_mean(correction, view)[good].mean(dtype=np.float64)) for view in known]
    scale = radiometric_scale([view.temperature_k or math.nan for view in known], levels)
    noise = float(np.median([np.median((correction.gain * view.noise)[good]) for view in known]))
    return replace(
        correction,
        counts_per_kelvin=scale.counts_per_kelvin,
        kelvin_at_zero=scale.kelvin_at_zero,
        netd_k=noise / scale.counts_per_kelvin,
        made_from={**correction.made_from, "scale": asdict(scale)},
    )


def _mean_or_none(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None
