"""A correction drawn: gain, offset, shading, and the bad pixels by their reason."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.imaging.noise_drawing import draw_bad_pixels

if TYPE_CHECKING:
    from thermacq_calibration import CameraCorrection


def draw_correction(correction: CameraCorrection, path: Path) -> None:
    """Draw gain, offset, shading where there is one, and the bad-pixel map; writes a PNG file."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), layout="constrained")
    gain, offset, shading, bad = figure.subplots(2, 2).flat
    good = correction.bad_pixels == 0
    _picture(figure, gain, correction.gain, good, "gain", "")
    _picture(figure, offset, correction.offset, good, "offset", "counts")
    if correction.shading is None:
        shading.axis("off")
        shading.text(0.5, 0.5, "no shading in this correction", ha="center", va="center")
    else:
        _picture(figure, shading, correction.shading, good, "shading", "counts")
    draw_bad_pixels(bad, correction.bad_pixels)
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
