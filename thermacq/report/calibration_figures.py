"""Figures of the page about a calibration, in the style of the other pages. No text from a file enters them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.report.figures import (
    BLUE,
    GREEN,
    GREY,
    INK,
    NOTHING,
    ORANGE,
    data_address,
    drawing,
    stretched,
    svg,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from thermacq_calibration import StereoCalibration
    from thermacq_calibration.geometry.residuals import Residuals

_CELLS = (8, 6)
_MAX_ARROWS = 1200
MEAN_ENLARGED = 5
"""Means of cells are drawn so many times longer than single residuals."""
# Cells of a camera picture in which the mean residual is shown need so many corners.
_LEAST_CORNERS = 5


def coverage(found: Sequence[Residuals], image_size: tuple[int, int]) -> str:
    """Corners of the used views in both pictures; cells without any are shaded."""
    with drawing(9.5, 3.9, columns=2, grid=False) as (figure, axes):
        for axis, side in zip(axes, ("left", "right"), strict=True):
            points = np.vstack([getattr(view, side) for view in found if view.used])
            limits = [(0, length) for length in image_size]
            counts, u, v = np.histogram2d(points[:, 0], points[:, 1], bins=_CELLS, range=limits)
            empty = np.where(counts.T > 0, np.nan, 1.0)
            axis.pcolormesh(u, v, empty, cmap="Greys", vmin=0, vmax=3, edgecolor=GREY, linewidth=0.3)
            axis.plot(*points.T, ".", color=BLUE, markersize=2, alpha=0.6, rasterized=True)
            _picture_axes(axis, image_size, side)
        return svg(figure, "coverage")


def residual_arrows(found: Sequence[Residuals], image_size: tuple[int, int]) -> tuple[str, float]:
    """Residuals of the used views as arrows, their mean by cell as thick ones; and how much they are enlarged."""
    used = [view for view in found if view.used]
    places = {side: np.vstack([getattr(view, side) for view in used]) for side in ("left", "right")}
    errors = {side: np.vstack([getattr(view, f"{side}_error_px") for view in used]) for side in places}
    typical = float(np.percentile([np.hypot(*error.T) for error in errors.values()], 95))
    # The longest common arrows span half a cell of the coverage map; a round factor is easier to read.
    enlarged = _round(image_size[0] / _CELLS[0] / 2 / max(typical, 1e-6))
    chosen = np.random.default_rng(0).permutation(len(places["left"]))[:_MAX_ARROWS]
    with drawing(9.5, 3.9, columns=2, grid=False) as (figure, axes):
        for axis, side in zip(axes, places, strict=True):
            _arrows(axis, places[side][chosen], errors[side][chosen] * enlarged, GREY, 0.0012)
            cells, means = _cell_means(places[side], errors[side], image_size)
            _arrows(axis, cells, means * MEAN_ENLARGED * enlarged, ORANGE, 0.005)
            _picture_axes(axis, image_size, side)
        return svg(figure, "residuals"), enlarged


def uncertainty_map(calibration: StereoCalibration) -> str:
    """Standard uncertainty of depth over the rectified left picture."""
    known = calibration.uncertainty or {}
    values = np.array(known["depth_map_m"], np.float64) * 1000
    columns, rows = np.array(known["columns_px"]), np.array(known["rows_px"])
    with drawing(5.4, 3.9, grid=False) as (figure, (axis,)):
        axis.set_facecolor(NOTHING)
        drawn = axis.pcolormesh(columns, rows, values, cmap="cividis", vmin=0, shading="nearest")
        figure.colorbar(drawn, ax=axis, label="σ of depth (mm)", shrink=0.85)
        _picture_axes(axis, calibration.image_size, "")
        return svg(figure, "uncertainty")


def poses(calibration: StereoCalibration) -> str:
    """Tilt of the board against its distance."""
    used = [view for view in calibration.views if view.used]
    distance, tilt = (
        np.array([getattr(view, key) for view in used], float) for key in ("distance_m", "tilt_deg")
    )
    with drawing(4.6, 3.9) as (figure, (axis,)):
        axis.plot(distance, tilt, "o", color=BLUE, markersize=5)
        for limit in (20, 25):
            axis.axhline(limit, color=GREEN, linewidth=1, linestyle="--")
        if calibration.working_distance_m:
            axis.axvline(calibration.working_distance_m, color=GREY, linestyle=":")
        axis.set(xlabel="distance of the board (m)", ylabel="tilt (degrees)")
        axis.set_ylim(bottom=0)
        return svg(figure, "poses")


def corners_picture(counts: NDArray[Any], corners: NDArray[np.float64] | None) -> str:
    """Camera picture with the corners that were found in it, as an address of data; the first corner is larger."""
    import cv2

    colour = cv2.cvtColor(stretched(counts), cv2.COLOR_GRAY2BGR)
    for index, (u, v) in enumerate(() if corners is None else corners):
        place = (round(float(u) * 8), round(float(v) * 8))
        cv2.circle(colour, place, (6 if index == 0 else 3) * 8, (0, 94, 213), 1, cv2.LINE_AA, 3)
    # JPEG: the noise of a thermal picture makes PNGs ten times larger.
    done, encoded = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 80])
    if not done:
        raise ValueError("the picture cannot be encoded as JPEG")
    return data_address(encoded.tobytes(), "jpeg")


def _arrows(
    axis: Axes, places: NDArray[np.float64], steps: NDArray[np.float64], colour: str, width: float
) -> None:
    axis.quiver(
        *places.T,
        *steps.T,
        color=colour,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=width,
        rasterized=width < 0.002,
    )


def _cell_means(
    places: NDArray[np.float64], errors: NDArray[np.float64], image_size: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres of cells with enough corners, and the mean residual there."""
    cells = (places / image_size * _CELLS).astype(int).clip(0, np.array(_CELLS) - 1)
    number = cells[:, 1] * _CELLS[0] + cells[:, 0]
    enough = np.flatnonzero(np.bincount(number, minlength=_CELLS[0] * _CELLS[1]) >= _LEAST_CORNERS)
    means = np.array([errors[number == one].mean(axis=0) for one in enough]).reshape(-1, 2)
    centres = (np.column_stack([enough % _CELLS[0], enough // _CELLS[0]]) + 0.5) / _CELLS * image_size
    return centres, means


def _picture_axes(axis: Axes, image_size: tuple[int, int], title: str) -> None:
    axis.set(
        xlim=(-0.5, image_size[0] - 0.5),
        ylim=(image_size[1] - 0.5, -0.5),
        aspect="equal",
        xlabel="u (px)",
        ylabel="v (px)",
    )
    axis.set_title(title, color=INK)


def _round(value: float) -> float:
    """Down to 1, 2 or 5 times a power of ten."""
    power = 10 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value) * power)
