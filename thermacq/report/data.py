"""Everything that a report shows, as one frozen record; a part that is missing is None or empty."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from thermacq.evaluation import Comparison, Flatness, QuantisationCurve

Picture: TypeAlias = NDArray[np.floating[Any] | np.integer[Any]]
Series: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class SampleFrame:
    """One pair on its way to the surface.

    Parameters
    ----------
    index
        Position of the frame in the product.
    time_s
        Seconds of the recording.
    left, right
        (rows, columns) counts, corrected as for the product; None when the run was not given.
    disparity
        (rows, columns) pixels of the left rectified picture, NaN where unknown; None when it could not be
        made.
    """

    index: int
    time_s: float
    left: Picture | None = None
    right: Picture | None = None
    disparity: Picture | None = None


@dataclass(frozen=True)
class Surface:
    """Elevation of the sample frame: `eta_m` (y, x) metres, NaN where unsupported, and its coordinates."""

    x_m: Series
    y_m: Series
    eta_m: Series
    time_s: float


@dataclass(frozen=True)
class Place:
    """A named point of the surface in world coordinates."""

    name: str
    x_m: float
    y_m: float


@dataclass(frozen=True)
class Coverage:
    """How much of the grid was supported by points.

    Parameters
    ----------
    frames
        Frames in the product.
    missing_fraction
        Part of all cells and frames that is NaN.
    seen_missing_fraction
        The same, among the cells that were ever supported: the picture does not fill the grid.
    points_per_cell
        Median number of points in a supported cell.
    cell_sd_m
        Median standard deviation of the points inside a cell.
    """

    frames: int
    missing_fraction: float
    seen_missing_fraction: float
    points_per_cell: float
    cell_sd_m: float


@dataclass(frozen=True)
class EventLine:
    """One event of the run, times in seconds of the recording."""

    time_s: float
    device: str
    kind: str
    index: int
    detail: str


@dataclass(frozen=True)
class Quantisation:
    """Fig. 16 for this rig: the curve, and the working distance it is read at."""

    curve: QuantisationCurve
    working_distance_m: float
    baseline_m: float
    focal_px: float


@dataclass(frozen=True)
class ReportData:
    """All parts of a report.

    Parameters
    ----------
    title
        Heading.
    created
        When the report was made, ISO 8601.
    simulated
        Whether any device of the run was simulated.
    sample, surface, coverage
        See there.
    comparisons
        Stereo against probes first, then, for a simulated run, stereo and probes against the truth.
    places
        Points to mark on the map, such as the probes.
    flatness
        Of the still-water product, with the name of that product.
    quantisation
        See there.
    sync
        Synchronisation report of the run, as `thermacq.timing.sync_report` made it.
    events, event_count
        The first events, and how many there are in all.
    notes
        What is missing from the report and why; caveats.
    provenance
        Sections of name and value, in the order of printing.
    """

    title: str
    created: str
    simulated: bool = False
    sample: SampleFrame | None = None
    surface: Surface | None = None
    coverage: Coverage | None = None
    comparisons: tuple[Comparison, ...] = ()
    places: tuple[Place, ...] = ()
    flatness: Flatness | None = None
    flatness_source: str = ""
    quantisation: Quantisation | None = None
    sync: dict[str, Any] | None = None
    events: tuple[EventLine, ...] = ()
    event_count: int = 0
    notes: tuple[str, ...] = ()
    provenance: dict[str, dict[str, str]] = field(default_factory=dict)
