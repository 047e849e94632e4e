"""A correction drawn: gain, offset, shading, and the bad pixels by their reason."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.imaging.condition import bad_pixel_counts

if TYPE_CHECKING:
    from thermacq_calibration import CameraCorrection

_COLOURS = {"dead": "#d62728", "noisy": "#1f77b4", "blinking": "#2ca02c", "outlier": "#9467bd"}


def draw_correction(correction: CameraCorrection, path: Path) -> None:
    """Draw gain, offset, shading where there is one, and the bad-pixel map; writes a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), layout="constrained")
    FigureCanvasAgg(figure)
    gain, offset, shading, bad = figure.subplots(2, 2).flat
    good = correction.bad_pixels == 0
    _picture(figure, gain, correction.gain, good, "gain", "")
    _picture(figure, offset, correction.offset, good, "offset", "counts")
    if correction.shading is None:
        shading.axis("off")
        shading.text(0.5, 0.5, "no shading in this correction", ha="center", va="center")
    else:
        _picture(figure, shading, correction.shading, good, "shading", "counts")
    _bad_pixels(bad, correction)
    updated = f", offsets of {correction.offset_updated}" if correction.offset_updated else ""
    figure.suptitle(
        f"camera {correction.camera} ({correction.serial or 'no serial'}), made {correction.created}{updated}"
    )
    figure.savefig(path, dpi=100)


def _picture(
    figure: Any, axes: Any, values: NDArray[np.float32], good: NDArray[np.bool_], name: str, unit: str
) -> None:
    low, high = np.percentile(values[good], (0.5, 99.5))
    image = axes.imshow(values, vmin=low, vmax=high, cmap="viridis", interpolation="nearest")
    axes.set_title(f"{name}: spread {values[good].std():.3g} {unit}".rstrip())
    figure.colorbar(image, ax=axes, label=unit, shrink=0.8)


def _bad_pixels(axes: Any, correction: CameraCorrection) -> None:
    from thermacq_calibration import BadPixel

    rows, columns = correction.shape
    counts = bad_pixel_counts(correction)
    for reason in BadPixel:
        name = str(reason.name).lower()
        down, right = np.nonzero(correction.bad_pixels & np.uint8(reason))
        axes.plot(right, down, ".", markersize=2.5, color=_COLOURS[name], label=f"{name} {counts[name]}")
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5), aspect="equal")
    axes.set_title(f"bad pixels: {counts['all']} ({100 * counts['all'] / (rows * columns):.3f} %)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=4, markerscale=4, fontsize="small")
