"""A noise report in words and numbers: rows of tables, for the terminal and for the page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thermacq_calibration.infrared.noise import COMPONENTS

if TYPE_CHECKING:
    from thermacq.imaging.noise_report import CameraNoise
    from thermacq_calibration.infrared.noise_figures import Figure

_MEANING = {
    "t": "whole frames",
    "v": "fixed rows",
    "h": "fixed columns",
    "tv": "rows, frame by frame",
    "th": "columns, frame by frame",
    "vh": "fixed pixels (RNU)",
    "tvh": "the rest (NETD)",
}


def camera_rows(camera: CameraNoise) -> list[tuple[str, str]]:
    """Figures of one camera: name and value."""
    times, rows, columns = camera.noise.shape
    view = "" if camera.temperature_k is None else f" of a view at {camera.temperature_k:g} K"
    found = [("frames", f"{times} of {columns} x {rows}{view}")]
    found.append(("corrections", ", ".join(camera.corrected) or "none: raw counts"))
    if camera.sitf is None:
        found.append(("SiTF", "not known, so all figures are in counts"))
    else:
        slope, error = camera.sitf.counts_per_kelvin, camera.sitf.standard_error
        found.append(("SiTF", f"{slope:.2f}{f' ± {error:.2f}' if error else ''} counts/K, {_origin(camera)}"))
    for name, figure in (
        ("NETD", camera.netd_k),
        ("NETD from differences", camera.netd_from_differences_k),
        ("RNU", camera.rnu_k),
    ):
        if figure is not None:
            found.append((name, millikelvin(figure)))
    found.append(("RNU / mean", f"{camera.rnu_per_cent:.4f} %"))
    found.append(("spatial, all", in_unit(camera, camera.noise.spatial_sigma)))
    found.append(("large scale, p-p", in_unit(camera, camera.large_scale_counts)))
    bad = camera.bad_counts()
    listed = ", ".join(f"{count} {name}" for name, count in bad.items() if count) or "none"
    found.append(("bad pixels", f"{listed} (from {camera.bad_pixels_from}); left out"))
    return found


def component_rows(camera: CameraNoise) -> list[tuple[str, str, str, str]]:
    """3-D noise of one camera: name, standard deviation, interval, meaning."""
    found = []
    for name in COMPONENTS:
        one = camera.noise.component(name)
        sigma = "0 (negative)" if one.is_negative else in_unit(camera, one.sigma)
        low, high = in_unit(camera, one.low), in_unit(camera, one.high)
        found.append((name, sigma, f"{low.rpartition(' ')[0]} to {high}", _MEANING[name]))
    return found


def in_unit(camera: CameraNoise, counts: float) -> str:
    """A difference of counts in mK, or in counts where the scale is not known."""
    if camera.sitf is None:
        return f"{counts:.3f} counts"
    return f"{1000 * counts / camera.sitf.counts_per_kelvin:.2f} mK"


def millikelvin(figure: Figure) -> str:
    """A figure with its standard error."""
    return f"{1000 * figure.value:.2f} ± {1000 * figure.standard_error:.2f} mK"


def _origin(camera: CameraNoise) -> str:
    if camera.sitf is None or not camera.sitf.temperatures_k:
        return camera.sitf_from if camera.sitf_from == "given" else f"from {camera.sitf_from}"
    low, high = min(camera.sitf.temperatures_k), max(camera.sitf.temperatures_k)
    worst = in_unit(camera, camera.sitf.largest_residual_counts)
    return f"from {camera.sitf_from}, {low:g} to {high:g} K, at most {worst} off the line"
