"""Drawing of a warm-up: temperature and level, rates with their limits, and when the go came."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thermacq.imaging.noise_drawing import BLUE, GREEN, ORANGE, STYLE, check_output, draw_warm_up
from thermacq.imaging.preheat import PreheatMonitor, PreheatStatus
from thermacq_calibration.infrared.preheat import preheat_history

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from thermacq_calibration.infrared.preheat import Preheat


def save_warm_up(monitor: PreheatMonitor, status: PreheatStatus, output: Path) -> None:
    """Draw the warm-up of all cameras to a new picture file; raises as `check_output`."""
    check_output(output)
    draw(monitor, status).savefig(output)


def draw(monitor: PreheatMonitor, status: PreheatStatus) -> Figure:
    """One row of panels per camera."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(11.0, 3.8 * len(status.cameras)), layout="constrained")
        rows = figure.subplots(len(status.cameras), 2, squeeze=False)
        for (curve, rates), name in zip(rows, status.cameras, strict=True):
            seen, scale = monitor.warm_up(name), monitor.scale(name)
            above = seen.level_counts - seen.level_counts[0]
            level, unit = (
                (above, "counts above the first") if scale is None else (above / scale, "K above the first")
            )
            draw_warm_up(curve, seen.time_s, seen.fpa_temperature_k, level, unit)
            curve.set_title(f"{name}: warm-up")
            _draw_rates(rates, preheat_history(seen, scale, monitor.limits))
            rates.set_title(f"{name}: rates with two standard errors, and their limits")
        return figure


def _draw_rates(axis: Axes, history: list[Preheat]) -> None:
    time_min = np.array([one.time_s for one in history]) / 60
    for name, colour, label in (("fpa", ORANGE, "focal plane"), ("drift", BLUE, "drift of the picture")):
        found = [getattr(one, name) for one in history]
        bound = 1000 * np.array([abs(one.value) + 2 * one.standard_error for one in found])
        if np.isfinite(bound).any():
            axis.semilogy(time_min, bound, color=colour, linewidth=1.3, label=label)
            axis.axhline(1000 * found[0].limit, color=colour, linewidth=0.8, linestyle="--")
    go_min = next((one.time_s / 60 for one in history if one.is_go), None)
    if go_min is not None:
        axis.axvline(go_min, color=GREEN, linewidth=1.3, label=f"go at {go_min:.1f} min")
    axis.set_xlabel("time (min)")
    axis.set_ylabel("rate (mK/min)")
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="upper right")
