"""Guidance while calibrating: what the views so far cover, what is missing, and the next best view in words.

Four bars as in ROS' camera_calibration: position across and down, size (distance), skew. A view counts only
when it differs by more than 0.2 (sum over the four figures) from all that counted before, so that a repeated
pose is no new view. The views are enough when the bars are full and the acceptance rows on number of poses,
tilt and coverage (docs/reference/calibration.md) are passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.geometry.stereo import COVERAGE_CELLS, View
from thermacq_calibration.models import Board
from thermacq_calibration.targets.detection import Detection
from thermacq_calibration.targets.samples import Sample, sample_of

NEW_VIEW_DISTANCE = 0.2
# What the views must span for a full bar. Across it is less than down: both cameras must see the board.
BARS = {"x": 0.4, "y": 0.7, "size": 0.4, "skew": 0.5}
WANTED_VIEWS = 25
WANTED_COVERAGE = 0.8
TILTED_DEG = 20.0
WANTED_TILTED_PART = 1 / 3
# A proposal that differs by this much from all views is as good as new.
_CLEARLY_NEW = 0.3
# Directions in which a board can recede, diagonals first: they fill the bar of skew as well.
DIRECTIONS = {
    "upper left": (-1, -1),
    "lower right": (1, 1),
    "upper right": (1, -1),
    "lower left": (-1, 1),
    "left": (-1, 0),
    "right": (1, 0),
    "top": (0, -1),
    "bottom": (0, 1),
}
# Root of the part of the picture that the board fills, and this part in words.
DISTANCES = {"near": (0.6, "a third"), "middle": (0.45, "a fifth"), "far": (0.33, "a tenth")}
_AWAY = [*DIRECTIONS, ""]
_BONUS = 0.3
_COLUMNS, _ROWS = ("left", "middle", "right"), ("upper", "middle", "lower")


@dataclass(frozen=True)
class NextView:
    """The view that would help most.

    Parameters
    ----------
    column, row
        In which ninth of what both cameras see to hold the board: 0 to 2 each.
    away
        Name of the direction in which it shall recede (see `DIRECTIONS`); empty: facing the cameras.
    distance
        ``near``, ``middle`` or ``far``.
    """

    column: int
    row: int
    away: str
    distance: str

    @property
    def words(self) -> str:
        """What to say to the person who holds the board."""
        place = f"{_ROWS[self.row]} {_COLUMNS[self.column]}".replace("middle middle", "middle")
        tilted = f"tilt it away at the {self.away}, by 30 degrees" if self.away else "face it to the cameras"
        part = DISTANCES[self.distance][1]
        return f"hold the board at the {place}, where it fills {part} of the picture; {tilted}"

    @property
    def sample(self) -> Sample:
        """About what the left camera would see."""
        skew = 0.05 if not self.away else 0.5 if " " in self.away else 0.25
        away = DIRECTIONS.get(self.away, (0, 0))
        size = DISTANCES[self.distance][0]
        return Sample(self.column / 2, self.row / 2, size, skew, 30.0 if self.away else 0.0, away)


@dataclass(frozen=True, eq=False)
class Guidance:
    """What the views so far are worth.

    Parameters
    ----------
    seen
        Views in which both cameras found the board.
    counted
        Those of them that differ from all before.
    bars
        Progress 0 to 1 of ``x``, ``y``, ``size`` and ``skew``.
    left_cells, right_cells
        (6, 8) bool, cells of the pictures that hold a corner.
    tilted
        Part of the counted views that are tilted by more than 20 degrees.
    missing
        What is still missing, in words; empty when it is enough.
    next_view
        The next best view.
    """

    seen: int
    counted: int
    bars: dict[str, float]
    left_cells: NDArray[np.bool_]
    right_cells: NDArray[np.bool_]
    tilted: float
    missing: tuple[str, ...]
    next_view: NextView

    @property
    def enough(self) -> bool:
        """Whether the views suffice for a calibration that can be accepted."""
        return not self.missing


def guidance(views: Sequence[View], image_size: tuple[int, int], board: Board) -> Guidance:
    """Judge the views so far and propose the next one.

    Parameters
    ----------
    views
        All views, in the order of time.
    image_size
        (columns, rows) of the pictures.
    board
        The board.
    """
    usable = [
        (view.left, view.right)
        for view in views
        if isinstance(view.left, Detection) and isinstance(view.right, Detection) and not view.problem
    ]
    samples = [
        # Near boards are shifted between the two pictures; the mean place says where both see them.
        replace(left, x=(left.x + right.x) / 2)
        for left, right in ([sample_of(side, board, image_size) for side in pair] for pair in usable)
        if left is not None and right is not None
    ]
    counted = different(samples)
    left_cells = cells([left for left, _ in usable], image_size)
    right_cells = cells([right for _, right in usable], image_size)
    bars = {name: _bar(name, counted) for name in BARS}
    tilted = sum(sample.tilt_deg > TILTED_DEG for sample in counted) / max(1, len(counted))
    missing = _missing(len(counted), bars, min(left_cells.mean(), right_cells.mean()), tilted)
    return Guidance(
        len(usable),
        len(counted),
        bars,
        left_cells,
        right_cells,
        tilted,
        missing,
        _next_view(samples, bars, left_cells & right_cells),
    )


def different(samples: Sequence[Sample]) -> list[Sample]:
    """The samples that differ enough from all counted ones before them."""
    counted: list[Sample] = []
    for sample in samples:
        if all(sample.distance(other) > NEW_VIEW_DISTANCE for other in counted):
            counted.append(sample)
    return counted


def cells(found: Sequence[Detection], image_size: tuple[int, int]) -> NDArray[np.bool_]:
    """Cells of the picture that hold a corner of any of the boards: (6, 8) bool, rows first."""
    across, down = COVERAGE_CELLS
    hit = np.zeros((down, across), bool)
    for one in found:
        places = np.floor(one.corners / np.array(image_size) * np.array(COVERAGE_CELLS)).astype(int)
        hit[places[:, 1].clip(0, down - 1), places[:, 0].clip(0, across - 1)] = True
    return hit


def _bar(name: str, counted: Sequence[Sample]) -> float:
    """Span of one figure, in parts of what is wanted; small sizes and skews are no merit."""
    values = [getattr(sample, name) for sample in counted]
    if not values:
        return 0.0
    lowest = min(values) if name in ("x", "y") else 0.0
    return float(min(1.0, (max(values) - lowest) / BARS[name]))


def _missing(counted: int, bars: dict[str, float], coverage: float, tilted: float) -> tuple[str, ...]:
    words = {
        "x": "positions further left and right",
        "y": "positions further up and down",
        "size": "views from nearer",
        "skew": "views tilted about a diagonal",
    }
    missing = [words[name] for name, value in bars.items() if value < 1]
    if counted < WANTED_VIEWS:
        missing.append(f"{WANTED_VIEWS - counted} more different views")
    if coverage < WANTED_COVERAGE:
        missing.append(
            f"corners in more of the picture ({coverage:.0%} of the cells, {WANTED_COVERAGE:.0%} wanted)"
        )
    if tilted < WANTED_TILTED_PART:
        missing.append(f"tilted views ({tilted:.0%} over {TILTED_DEG:g} degrees, a third wanted)")
    return tuple(missing)


def _next_view(samples: Sequence[Sample], bars: dict[str, float], covered: NDArray[np.bool_]) -> NextView:
    """The proposal of which the views so far have least, with a bonus for what is missing."""
    proposals = [
        NextView(column, row, away, distance)
        for row in range(3)
        for column in range(3)
        for away in _AWAY
        for distance in DISTANCES
    ]
    wanted = np.array([_numbers(view) for view in proposals])
    kinds = np.array([_numbers(_kind(sample)) for sample in samples]).reshape(-1, 4)
    same = wanted[:, None] == kinds
    place, away, distance = same[..., 0] & same[..., 1], same[..., 2], same[..., 3]
    alike = [place, away, distance, place & distance]
    worth = np.sum([1 / (1 + these.sum(axis=1)) for these in alike], axis=0)
    down, across = (np.array_split(np.arange(length), 3) for length in covered.shape)
    empty = [1 - covered[np.ix_(down[view.row], across[view.column])].mean() for view in proposals]
    worth += empty
    worth += _BONUS * (bars["size"] < 1) * np.array([view.distance == "near" for view in proposals])
    worth += _BONUS * (bars["skew"] < 1) * np.array([" " in view.away for view in proposals])
    if samples:
        figures = np.array([_figures(view.sample) for view in proposals])
        differences = np.abs(figures[:, None] - np.array([_figures(sample) for sample in samples])).sum(
            axis=2
        )
        worth += np.minimum(1.0, differences.min(axis=1) / _CLEARLY_NEW)
    return proposals[int(np.argmax(worth))]


def _numbers(view: NextView) -> tuple[int, int, int, int]:
    return view.column, view.row, _AWAY.index(view.away), list(DISTANCES).index(view.distance)


def _figures(sample: Sample) -> tuple[float, float, float, float]:
    return sample.x, sample.y, sample.size, sample.skew


def _kind(sample: Sample) -> NextView:
    """The proposal that a view comes nearest to."""
    column, row = (int(place > 1 / 3) + int(place > 2 / 3) for place in (sample.x, sample.y))
    away = ""
    if sample.tilt_deg > TILTED_DEG:
        cosines = {
            name: (u * sample.away[0] + v * sample.away[1]) / np.hypot(u, v)
            for name, (u, v) in DIRECTIONS.items()
        }
        away = max(cosines, key=lambda name: cosines[name])
    distance = min(DISTANCES, key=lambda name: abs(DISTANCES[name][0] - sample.size))
    return NextView(column, row, away, distance)
