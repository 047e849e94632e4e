"""Drawings of a noise report and of a warm-up: matplotlib figures, and one HTML page that needs nothing else."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import CorrectionError
from thermacq.imaging.noise_tables import camera_rows, component_rows
from thermacq.outputs import check_new_file
from thermacq_calibration.infrared.noise import COMPONENTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from thermacq.imaging.noise_report import CameraNoise, NoiseReport, Spectrum

# Okabe and Ito's colours, distinguishable with every kind of colour vision.
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#888888"
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}
_BAD_COLOURS = {"dead": "#000000", "noisy": ORANGE, "blinking": BLUE, "outlier": GREEN}

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Noise of {{ report.run.name }}</title>
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1150px; margin: 0 auto; padding: 20px; color: #1c2630; }
table { border-collapse: collapse; margin: 12px 0; font-variant-numeric: tabular-nums; }
td, th { padding: 3px 14px 3px 0; text-align: left; border-bottom: 1px solid #d9dfe5; }
img { width: 100%; height: auto; }
.warning { background: #fff4d6; border: 1px solid #e3b341; border-radius: 8px; padding: 8px 12px; }
.faint { color: #5d6b78; }
</style></head><body>
<h1>Noise of {{ report.run.name }}</h1>
<p class="faint">run {{ report.run_id }}{{ ", simulated cameras" if report.simulated }}</p>
{% for camera, rows, components, picture in cameras %}
<h2>{{ camera.camera }} {{ camera.serial }}</h2>
{% for warning in camera.warnings %}<p class="warning">{{ warning }}</p>{% endfor %}
<table>{% for name, value in rows %}<tr><th>{{ name }}</th><td>{{ value }}</td></tr>{% endfor %}</table>
<table>{% for line in components %}<tr>{% for cell in line %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
<img alt="Drawing of the noise of camera {{ camera.camera }}" src="data:image/png;base64,{{ picture }}">
{% endfor %}
</body></html>
"""


def save_report(report: NoiseReport, output: Path) -> None:
    """Draw a report into a new ``.png`` or ``.html`` file.

    Raises
    ------
    CorrectionError, StoreError
        The name ends otherwise, or the file exists or cannot be made.
    """
    check_output(output)
    if output.suffix.lower() == ".png":
        output.write_bytes(_png(draw(report.cameras)))
        return
    from jinja2 import Environment

    pictures = [base64.b64encode(_png(draw([camera]))).decode() for camera in report.cameras]
    page = (
        Environment(autoescape=True)
        .from_string(_PAGE)
        .render(
            report=report,
            cameras=[
                (camera, camera_rows(camera), component_rows(camera), picture)
                for camera, picture in zip(report.cameras, pictures, strict=True)
            ],
        )
    )
    output.write_text(page, encoding="utf-8")


def check_output(output: Path) -> None:
    """Refuse a file that is neither ``.png`` nor ``.html`` (`CorrectionError`) or cannot be made (`StoreError`)."""
    if output.suffix.lower() not in (".png", ".html"):
        raise CorrectionError(f"'{output}' is neither .png nor .html", remedy="Name it report.html.")
    check_new_file(output)


def draw(cameras: Sequence[CameraNoise]) -> Figure:
    """One figure with two rows of panels per camera."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(13.0, 7.4 * len(cameras)), layout="constrained")
        parts = figure.subfigures(len(cameras), 1, squeeze=False)[:, 0]
        for part, camera in zip(parts, cameras, strict=True):
            part.suptitle(f"{camera.camera}  {camera.serial}", fontweight="bold")
            (picture, bad, components), (rows, columns, warm_up) = part.subplots(2, 3)
            _draw_mean(picture, camera)
            draw_bad_pixels(bad, camera.bad_pixels, f", from {camera.bad_pixels_from}")
            _draw_components(components, camera)
            _draw_spectrum(rows, camera, camera.along_rows, "along rows")
            _draw_spectrum(columns, camera, camera.along_columns, "along columns")
            draw_warm_up(warm_up, camera.time_s, camera.fpa_temperature_k, *_level(camera))
        return figure


def draw_warm_up(axis: Axes, time_s: Any, fpa_temperature_k: Any, level: Any, unit: str) -> None:
    """Temperature of the focal plane and mean level against time."""
    minutes = np.ptp(time_s) > 300
    time, label = (time_s / 60, "time (min)") if minutes else (time_s, "time (s)")
    axis.plot(time, level, color=BLUE, linewidth=1.0)
    axis.set_title("warm-up")
    axis.set_xlabel(label)
    axis.set_ylabel(f"mean level ({unit})", color=BLUE)
    if np.isfinite(fpa_temperature_k).any():
        other = axis.twinx()
        other.plot(time, fpa_temperature_k, color=ORANGE, linewidth=1.0)
        other.set_ylabel("focal plane (K)", color=ORANGE)
        other.ticklabel_format(useOffset=False)
        other.grid(visible=False)


def _level(camera: CameraNoise) -> tuple[Any, str]:
    factor, unit = _unit(camera)
    return factor * (camera.level_counts - camera.level_counts[0]), f"{unit} above the first"


def _unit(camera: CameraNoise) -> tuple[float, str]:
    """Factor from counts, and the unit."""
    return (1.0, "counts") if camera.sitf is None else (1000 / camera.sitf.counts_per_kelvin, "mK")


def _draw_mean(axis: Axes, camera: CameraNoise) -> None:
    factor, unit = _unit(camera)
    shown = factor * (camera.mean_picture - camera.noise.mean)
    low, high = np.percentile(shown, [1, 99])
    image = axis.imshow(shown, cmap="gray", vmin=low, vmax=high)
    axis.figure.colorbar(image, ax=axis, label=f"{unit} from the mean", shrink=0.85)
    axis.set_title(f"mean of {camera.noise.shape[0]} frames")
    axis.grid(visible=False)


def draw_bad_pixels(axis: Axes, bad_pixels: NDArray[np.uint8], note: str = "") -> None:
    """Where pixels are bad, by their reason; (rows, columns), bits of `BadPixel`."""
    from thermacq_calibration import BadPixel

    rows, columns = bad_pixels.shape
    for kind in BadPixel:
        name = str(kind.name).lower()
        row, column = np.nonzero(bad_pixels & kind)
        axis.scatter(
            column, row, s=3, marker="s", linewidths=0, color=_BAD_COLOURS[name], label=f"{name} {len(row)}"
        )
    share = np.count_nonzero(bad_pixels) / bad_pixels.size
    axis.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5), aspect="equal")
    axis.set_title(f"bad pixels: {share:.3%}{note}")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=4, markerscale=3, columnspacing=1.0)
    axis.grid(visible=False)


def _draw_components(axis: Axes, camera: CameraNoise) -> None:
    factor, unit = _unit(camera)
    found = [camera.noise.component(name) for name in COMPONENTS]
    sigma = factor * np.array([one.sigma for one in found])
    low, high = (factor * np.array([getattr(one, end) for one in found]) for end in ("low", "high"))
    colours = [GREY if one.is_negative else BLUE for one in found]
    axis.bar(COMPONENTS, sigma, color=colours, width=0.65)
    # An interval that does not hold the estimate does not occur: the bar is 0 where the variance is negative.
    errors = np.maximum(0, [sigma - low, high - sigma])
    axis.errorbar(COMPONENTS, sigma, yerr=errors, fmt="none", ecolor=ORANGE, capsize=4)
    positive = sigma[sigma > 0]
    if positive.size and positive.max() > 30 * positive.min():
        axis.set_yscale("log")
        axis.set_ylim(bottom=positive.min() / 3)
    axis.set_title(f"3-D noise, {camera.noise.confidence:.0%} intervals")
    axis.set_ylabel(f"standard deviation ({unit})")


def _draw_spectrum(axis: Axes, camera: CameraNoise, spectrum: Spectrum, where: str) -> None:
    factor, unit = _unit(camera)
    frames = camera.noise.shape[0]
    axis.semilogy(spectrum.frequency, factor**2 * spectrum.fixed, color=BLUE, linewidth=0.9, label="fixed")
    axis.semilogy(
        spectrum.frequency, factor**2 * spectrum.temporal, color=ORANGE, linewidth=0.9, label="temporal"
    )
    axis.semilogy(
        spectrum.frequency,
        factor**2 * spectrum.temporal / frames,
        color=GREY,
        linewidth=0.8,
        label=f"temporal / {frames}",
    )
    axis.set_title(f"power spectrum {where}")
    axis.set_xlabel("frequency (cycles/px)")
    axis.set_ylabel(f"density ({unit}² px)")
    top = factor**2 * max(float(spectrum.fixed.max()), float(spectrum.temporal.max()))
    if math.isfinite(top) and top > 0:
        axis.set_ylim(top=3 * top)
    axis.legend(ncols=3, loc="upper right", handlelength=1.0, columnspacing=0.8, fontsize="small")


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
