"""One figure of a run: thermal frame, elevation from above, and the wave at the probe.

Run the demo first, then ``python examples/plot_surface.py demo-output``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from thermacq.evaluation.run_comparison import compare_run
from thermacq.reconstruction import open_product
from thermacq.store import open_run


def plot(folder: Path, output: Path, frame: int = 100) -> None:
    """Draw one frame of ``wave.h5`` and ``wave.nc`` and the comparison with the probe."""
    with open_run(folder / "wave.h5") as run, open_product(folder / "wave.nc") as product:
        counts = run.counts("left", frame)
        eta_mm = 1000 * product["eta"].isel(time=frame).load()
        comparison = compare_run(product, run).comparisons[0]
        title = f"simulated, t = {float(eta_mm['time']):.2f} s" if run.header.simulated else run.header.title
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 3.6), width_ratios=[1, 1, 1.4])
    left.imshow(counts, cmap="gray", vmin=np.percentile(counts, 1), vmax=np.percentile(counts, 99))
    left.set(title="left thermal frame", xticks=[], yticks=[])
    picture = middle.pcolormesh(eta_mm["x"], eta_mm["y"], eta_mm, cmap="RdBu_r", vmin=-50, vmax=50)
    middle.set(title=title, xlabel="x (m)", ylabel="y (m)", aspect="equal")
    figure.colorbar(picture, ax=middle, label="elevation (mm)")
    right.plot(comparison.time_s, 1000 * comparison.reference_m, label=comparison.reference_name)
    right.plot(comparison.time_s, 1000 * comparison.measured_m, ".", ms=3, label=comparison.measured_name)
    right.set(title=f"slope {comparison.agreement.slope:.4f}", xlabel="time (s)", ylabel="elevation (mm)")
    right.legend(loc="lower right")
    figure.tight_layout()
    figure.savefig(output, dpi=80)


if __name__ == "__main__":
    where = Path(sys.argv[1] if len(sys.argv) > 1 else "demo-output")
    plot(where, where / "surface.png")
    print(where / "surface.png")
