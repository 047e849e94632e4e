"""Figures of the report: matplotlib drawings as SVG that lives inside the page and follows its colours.

Text and axes are drawn in one marker colour that becomes ``currentColor``, so that a figure is legible on a
light and on a dark page. No text that comes from a file enters a figure.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.report.data import Picture, Place, Quantisation, Series, Surface

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from thermacq.evaluation import Comparison, Flatness

INK = "#010203"
# Okabe and Ito's colours, distinguishable with every kind of colour vision.
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#888888"
# Colour of cells and pixels that hold no value; in none of the colour maps.
NOTHING = "#B5B5B5"
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "thermacq",
    "font.family": "sans-serif",
    "font.size": 10.0,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GREY,
    "grid.alpha": 0.25,
    "axes.grid": True,
    "legend.frameon": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
}
_MAX_LINE_POINTS = 3000
_MAX_SCATTER_POINTS = 2000
_HISTORY_PERIODS = 12


def time_histories(comparisons: Sequence[Comparison]) -> str:
    """Elevation against time of every pair of series, one panel each, and their difference below."""
    with drawing(9.5, 2.9 * len(comparisons), rows=len(comparisons)) as (figure, axes):
        for axis, comparison in zip(axes, comparisons, strict=True):
            shown = np.flatnonzero(comparison.time_s <= _until(comparison))[:_MAX_LINE_POINTS]
            time = comparison.time_s[shown]
            reference, measured = 1000 * comparison.reference_m[shown], 1000 * comparison.measured_m[shown]
            axis.plot(time, reference, color=BLUE, linewidth=1.4, label=role(comparison.reference_name))
            axis.plot(time, measured, ".", color=ORANGE, markersize=3.5, label=role(comparison.measured_name))
            axis.plot(time, measured - reference, color=GREY, linewidth=0.9, label="difference")
            axis.set_ylabel("elevation (mm)")
            axis.legend(loc="upper right", ncols=3, bbox_to_anchor=(1.0, 1.14))
            axis.margins(x=0.01)
        axes[-1].set_xlabel("time since the start of the recording (s)")
        return svg(figure, "history")


def is_cut(comparison: Comparison) -> bool:
    """Whether `time_histories` shows only the beginning."""
    return bool(comparison.time_s[-1] > _until(comparison) or comparison.time_s.size > _MAX_LINE_POINTS)


def scatter(comparison: Comparison) -> str:
    """Measured against reference elevations with the linear fit and the line y = x (paper, Fig. 14e)."""
    reference, measured = _pairs_mm(comparison)
    reach = 1.08 * float(np.max(np.abs([reference, measured])))
    line = np.array([-reach, reach])
    found = comparison.agreement
    with drawing(4.6, 4.2) as (figure, (axis,)):
        axis.plot(reference, measured, ".", color=BLUE, markersize=3, alpha=0.5, rasterized=True)
        axis.plot(line, line, "--", color=INK, linewidth=1, label="y = x")
        fit = found.slope * line + 1000 * found.intercept_m
        axis.plot(line, fit, color=ORANGE, linewidth=1.6, label=f"fit, slope {found.slope:.4f}")
        axis.set(
            xlabel=f"{role(comparison.reference_name)} (mm)",
            ylabel=f"{role(comparison.measured_name)} (mm)",
            xlim=line,
            ylim=line,
            aspect="equal",
        )
        axis.legend(loc="upper left")
        return svg(figure, "scatter")


def differences(comparison: Comparison) -> str:
    """Difference against mean of each pair with bias and limits of agreement (Bland and Altman)."""
    reference, measured = _pairs_mm(comparison)
    found = comparison.agreement
    with drawing(4.6, 4.2) as (figure, (axis,)):
        mean, difference = (reference + measured) / 2, measured - reference
        axis.plot(mean, difference, ".", color=BLUE, markersize=3, alpha=0.5, rasterized=True)
        axis.axhline(1000 * found.bias_m, color=ORANGE, linewidth=1.6)
        for limit in found.limits_m:
            axis.axhline(1000 * limit, color=ORANGE, linewidth=1.2, linestyle="--")
        axis.set(xlabel="mean of both (mm)", ylabel="difference (mm)")
        return svg(figure, "differences")


def surface_3d(surface: Surface) -> str:
    """Perspective view of one frame, as a picture: a drawing of every facet would be megabytes."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    stride = max(1, int(np.ceil(max(surface.eta_m.shape) / 110)))
    x, y = np.meshgrid(surface.x_m[::stride], surface.y_m[::stride])
    eta = 1000 * surface.eta_m[::stride, ::stride]
    reach = _reach(eta)
    with rc_context({"font.size": 9.0, "axes.grid": True}):
        figure = Figure(figsize=(7.2, 5.0), layout="constrained")
        axis: Any = figure.add_subplot(projection="3d")
        drawn = axis.plot_surface(
            x,
            y,
            eta,
            cmap="cividis",
            vmin=-reach,
            vmax=reach,
            rcount=110,
            ccount=110,
            linewidth=0,
            antialiased=False,
        )
        span_x, span_y = np.ptp(surface.x_m), np.ptp(surface.y_m)
        axis.set_box_aspect((span_x, span_y, 0.35 * max(span_x, span_y)), zoom=1.15)
        axis.set(xlabel="x (m)", ylabel="y (m)", zlabel="η (mm)", zlim=(-1.3 * reach, 1.3 * reach))
        axis.view_init(elev=32, azim=-62)
        figure.colorbar(drawn, shrink=0.6, label="elevation (mm)", pad=0.1)
        return _png(figure)


def elevation_map(surface: Surface, places: Sequence[Place] = ()) -> str:
    """Plan view of one frame with numbered places."""
    with drawing(5.6, 4.2, grid=False) as (figure, (axis,)):
        reach = _reach(1000 * surface.eta_m)
        _map(
            figure,
            axis,
            surface.x_m,
            surface.y_m,
            1000 * surface.eta_m,
            "elevation (mm)",
            "RdBu_r",
            (-reach, reach),
        )
        for number, place in enumerate(places, start=1):
            axis.plot(
                place.x_m, place.y_m, "o", markerfacecolor="white", markeredgecolor="black", clip_on=False
            )
            axis.annotate(
                str(number), (place.x_m, place.y_m), (6, 4), textcoords="offset points", clip_on=False
            )
        return svg(figure, "map")


def flatness_maps(flat: Flatness) -> str:
    """Mean deviation of still water from the world plane, and its spread over time (paper, Fig. 11)."""
    with drawing(9.5, 3.8, columns=2, grid=False) as (figure, (left, right)):
        deviation, spread = 1000 * flat.mean_deviation_m, 1000 * flat.cell_sd_m
        reach = _reach(deviation)
        _map(figure, left, flat.x_m, flat.y_m, deviation, "mean deviation (mm)", "RdBu_r", (-reach, reach))
        top = float(np.nanpercentile(spread, 99)) if np.isfinite(spread).any() else 1.0
        _map(figure, right, flat.x_m, flat.y_m, spread, "standard deviation (mm)", "cividis", (0.0, top))
        return svg(figure, "flat")


def disparity_map(disparity: Picture) -> str:
    """Disparity of the left rectified picture; grey where there is none."""
    with drawing(5.6, 4.4, grid=False) as (figure, (axis,)):
        low, high = np.nanpercentile(disparity, [1, 99])
        axis.set_facecolor(NOTHING)
        drawn = axis.imshow(
            _thinned(disparity),
            cmap="cividis",
            vmin=low,
            vmax=high,
            interpolation="nearest",
            extent=_pixel_extent(disparity),
        )
        axis.set(xlabel="column (px)", ylabel="row (px)")
        figure.colorbar(drawn, ax=axis, label="disparity (px)", shrink=0.85)
        return svg(figure, "disparity")


def quantisation_plot(quantisation: Quantisation) -> str:
    """Largest quantisation error against distance (paper, Fig. 16)."""
    curve = quantisation.curve
    with drawing(6.4, 3.6) as (figure, (axis,)):
        axis.plot(
            curve.distance_m, 1000 * curve.depth_error_m, color=BLUE, label="camera frame, $e_z$ (eq. 5)"
        )
        axis.plot(
            curve.distance_m,
            1000 * curve.vertical_error_m,
            "--",
            color=ORANGE,
            label="world frame, $e_Z$ (eq. 8)",
        )
        axis.axvline(quantisation.working_distance_m, color=GREY, linestyle=":", label="working distance")
        axis.set(
            xlabel="distance along the optical axis (m)", ylabel="error for one pixel (mm)", ylim=(0, None)
        )
        axis.legend(loc="upper left")
        return svg(figure, "quantisation")


def picture(counts: Picture) -> str:
    """A frame as PNG, stretched from its 1st to its 99th percentile, as a data address."""
    import cv2

    done, encoded = cv2.imencode(".png", stretched(counts))
    if not done:
        raise ValueError("the picture cannot be encoded as PNG")
    return data_address(encoded.tobytes())


def stretched(counts: Picture) -> NDArray[np.uint8]:
    """A frame in 8 bit, from its 1st to its 99th percentile."""
    low, high = np.percentile(counts, [1, 99])
    scaled = (np.asarray(counts, np.float64) - low) / max(high - low, 1e-9)
    return np.asarray(np.clip(255 * scaled, 0, 255), np.uint8)


@contextmanager
def drawing(
    width_in: float, height_in: float, *, rows: int = 1, columns: int = 1, grid: bool = True
) -> Iterator[tuple[Figure, list[Axes]]]:
    """A figure and its axes in the style of the pages; it must be saved inside, while the style is in force."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({**_STYLE, "axes.grid": grid}):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        yield figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


def _map(
    figure: Figure,
    axis: Axes,
    x_m: Series,
    y_m: Series,
    values: Series,
    label: str,
    colours: str,
    limits: tuple[float, float],
) -> None:
    axis.set_facecolor(NOTHING)
    half_x, half_y = _half_step(x_m), _half_step(y_m)
    extent = (x_m[0] - half_x, x_m[-1] + half_x, y_m[0] - half_y, y_m[-1] + half_y)
    drawn = axis.imshow(
        values,
        origin="lower",
        extent=extent,
        cmap=colours,
        vmin=limits[0],
        vmax=limits[1],
        interpolation="nearest",
    )
    axis.set(xlabel="x (m)", ylabel="y (m)")
    figure.colorbar(drawn, ax=axis, label=label, shrink=0.85)


def _pairs_mm(comparison: Comparison) -> tuple[Series, Series]:
    """Reference and measured elevations, millimetres; a fixed random choice when there are many."""
    paired = np.flatnonzero(np.isfinite(comparison.measured_m) & np.isfinite(comparison.reference_m))
    if paired.size > _MAX_SCATTER_POINTS:
        paired = np.random.default_rng(0).choice(paired, _MAX_SCATTER_POINTS, replace=False)
    return 1000 * comparison.reference_m[paired], 1000 * comparison.measured_m[paired]


def _until(comparison: Comparison) -> float:
    return float(comparison.time_s[0]) + _HISTORY_PERIODS * comparison.reference_waves.mean_period_s


def _half_step(values: Series) -> float:
    return float(np.median(np.diff(values))) / 2 if values.size > 1 else 0.5


def _thinned(values: Picture) -> Picture:
    stride = max(1, int(np.ceil(max(values.shape) / 700)))
    return values[::stride, ::stride]


def _pixel_extent(values: Picture) -> tuple[float, float, float, float]:
    return -0.5, values.shape[1] - 0.5, values.shape[0] - 0.5, -0.5


def _reach(values: Series) -> float:
    """Symmetric colour limit that a few outliers do not move."""
    finite = np.abs(values[np.isfinite(values)])
    return max(float(np.percentile(finite, 99.5)), 1e-6) if finite.size else 1.0


def role(name: str) -> str:
    """What a series is, without any text that came from a file."""
    for role in ("truth", "stereo", "probe"):
        if role in name:
            return role
    return "series"


def svg(figure: Figure, prefix: str) -> str:
    """The drawing as an ``svg`` element: no prolog, no metadata, names of its own, the page's text colour."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", dpi=110)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r'<svg ([^>]*?)width="[^"]*" height="[^"]*"', r'<svg role="img" \1', text, count=1)
    text = re.sub(r'\bid="', f'id="{prefix}-', text)
    text = re.sub(r'xlink:href="#', f'href="#{prefix}-', text)
    text = text.replace("xlink:href=", "href=").replace("url(#", f"url(#{prefix}-")
    return text.replace(INK, "currentColor")


def _png(figure: Figure) -> str:
    buffer = io.BytesIO()
    # Where a surface has holes, matplotlib projects vertices that it never set before it masks them.
    with np.errstate(over="ignore", invalid="ignore"):
        figure.savefig(buffer, format="png", dpi=150, facecolor="white", bbox_inches="tight")
    return data_address(buffer.getvalue())


def data_address(content: bytes, kind: str = "png") -> str:
    """A picture file as an address that needs no other file."""
    return f"data:image/{kind};base64," + base64.b64encode(content).decode("ascii")
