"""Views of the calibration board, from a folder, from files, or from a run: what calibration starts from.

A view is one pose of the board with a picture from each camera. Pictures are read only when they are
looked at, so that a long recording never stands in memory.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ImportDataError, ReconstructionError
from thermacq.imaging.corrections import NO_CORRECTIONS, CorrectedPictures, Corrections, corrections_of
from thermacq.reconstruction.pairs import run_pairs
from thermacq.rig import Rig
from thermacq.store import RunFile, open_run
from thermacq_calibration import (
    FRAMES_TO_AVERAGE,
    Board,
    BoardKind,
    Detection,
    NoBoard,
    View,
    average,
    detect_board,
)
from thermacq_calibration.targets.poses import changes, still_stretches

Picture: TypeAlias = NDArray[Any]
Load: TypeAlias = Callable[[], Picture]

_PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm"})
_SIDE = re.compile(r"(?<![a-z])(left|right|l|r)(?![a-z])|^(left|right)", re.IGNORECASE)


@dataclass(frozen=True)
class PictureView:
    """A pose of the board: how to read the picture of each camera; None where there is no picture."""

    name: str
    left: Load | None
    right: Load | None


@contextmanager
def open_views(
    sources: Sequence[Path],
    frames_per_view: int | None = None,
    pair: str | None = None,
    *,
    correction_files: Sequence[Path] = (),
    correct: bool = True,
) -> Iterator[list[PictureView]]:
    """Views of a folder, of picture files, or of one pair of cameras of a run, as long as the context lasts.

    Pictures of a run are corrected as `views_from_run` says; those of files are taken as they are.

    Raises
    ------
    ImportDataError, StoreError, ReconstructionError
        There is nothing there, it cannot be read, or it holds no views.
    """
    for source in sources:
        if not source.exists():
            raise ImportDataError(f"there is no file or folder '{source}'")
    if all(is_picture(source) for source in sources):
        yield views_from_files(sources)
    elif len(sources) > 1:
        raise ImportDataError(
            "several sources must all be pictures", remedy="Give one folder, one run file, or pictures."
        )
    elif sources[0].is_dir():
        yield views_from_folder(sources[0])
    else:
        with open_run(sources[0]) as run:
            corrections = corrections_of(run, correction_files, use=correct, stages=())
            yield views_from_run(run, frames_per_view, pair, corrections)


def is_run(sources: Sequence[Path]) -> bool:
    """Whether the sources are one run file."""
    return len(sources) == 1 and sources[0].is_file() and not is_picture(sources[0])


def board_of(rig: Rig) -> Board:
    """The board that a rig names."""
    table = rig.board
    kind = BoardKind(table.kind)
    return Board(table.columns, table.rows, table.square_m, kind, table.marker_m, table.dictionary)


def views_from_files(files: Sequence[Path]) -> list[PictureView]:
    """Pair pictures whose names differ only in ``left``/``right`` (or ``l``/``r``).

    Pictures that name no side become views of one camera, so that boards can be looked for in them.

    Raises
    ------
    ImportDataError
        Two pictures claim the same view and side.
    """
    sides: dict[str, dict[str, Path]] = {}
    for file in sorted(files, key=lambda path: natural_key(path.name)):
        side, key = _side_and_key(file.stem)
        if (taken := sides.setdefault(key, {}).get(side)) is not None:
            raise ImportDataError(
                f"'{taken}' and '{file}' are both the {side} picture of view '{key}'",
                remedy="Keep one of them.",
            )
        sides[key][side] = file
    return [
        PictureView(key, _loader(pair.get("left")), _loader(pair.get("right"))) for key, pair in sides.items()
    ]


def views_from_folder(folder: Path) -> list[PictureView]:
    """Pictures of a folder, or of its subfolders ``left`` and ``right``.

    Raises
    ------
    ImportDataError
        There are no pictures.
    """
    below = {path.name.lower(): path for path in folder.iterdir() if path.is_dir()}
    if {"left", "right"} <= below.keys():
        return views_from_lists(_pictures_in(below["left"]), _pictures_in(below["right"]))
    return views_from_files(_pictures_in(folder))


def views_from_lists(left: Sequence[Path], right: Sequence[Path]) -> list[PictureView]:
    """Pair two lists of pictures: by name when names agree apart from the side, else in natural order.

    Raises
    ------
    ImportDataError
        Names do not agree and the lists have different lengths, or a list is empty.
    """
    if not left or not right:
        raise ImportDataError(f"there are {len(left)} left and {len(right)} right pictures")
    keyed = [{_side_and_key(file.stem)[1]: file for file in side} for side in (left, right)]
    unique = len(keyed[0]) == len(left) and len(keyed[1]) == len(right)
    if unique and keyed[0].keys() & keyed[1].keys():
        names = sorted(keyed[0].keys() | keyed[1].keys(), key=natural_key)
        return [PictureView(name, _loader(keyed[0].get(name)), _loader(keyed[1].get(name))) for name in names]
    if len(left) != len(right):
        raise ImportDataError(
            f"{len(left)} left and {len(right)} right pictures cannot be paired: their names do not agree",
            remedy="Name the pictures of one view alike, for instance left01.png and right01.png.",
        )
    ordered = (sorted(side, key=lambda path: natural_key(path.name)) for side in (left, right))
    return [
        PictureView(f"{one.stem} | {other.stem}", _loader(one), _loader(other))
        for one, other in zip(*ordered, strict=True)
    ]


def views_from_run(
    run: RunFile,
    frames_per_view: int | None = None,
    pair: str | None = None,
    corrections: Corrections = NO_CORRECTIONS,
) -> list[PictureView]:
    """Poses of a recorded board; each picture is the mean of up to 16 frames.

    Parameters
    ----------
    run
        The open run; it must stay open while the views are looked at.
    frames_per_view
        Pairs per pose; None finds the stretches in which the left picture stands still.
    pair
        Which pair of cameras; see `camera_sides`.
    corrections
        What is applied to each picture; stages of plugins (destriping) have no place here.

    Raises
    ------
    ReconstructionError
        The run has no pairs, or the board never stands still.
    """
    pairs = run_pairs(run, pair)
    if frames_per_view is None:
        left = (run.counts(pairs.left_camera, int(index)) for index in pairs.left)
        stretches = still_stretches(*changes(left))
    else:
        stretches = [
            range(first, min(first + frames_per_view, len(pairs)))
            for first in range(0, len(pairs), frames_per_view)
        ]
    if not stretches:
        raise ReconstructionError(
            f"the board never stands still for a few frames in the {len(pairs)} pairs of '{run.path}'",
            remedy="Hold each pose, or say how many pairs belong to one with --frames-per-view.",
        )
    return [
        PictureView(
            f"{stretch[0]}-{stretch[-1]}",
            _run_loader(run, pairs.left_camera, pairs.left[middle_of(stretch)], corrections),
            _run_loader(run, pairs.right_camera, pairs.right[middle_of(stretch)], corrections),
        )
        for stretch in stretches
    ]


def detect_views(
    views: Sequence[PictureView], board: Board, progress: Callable[[], None] = lambda: None
) -> tuple[list[View], tuple[int, int]]:
    """Look for the board in every picture.

    Parameters
    ----------
    views
        The views.
    board
        Which board to look for.
    progress
        Called after each view.

    Returns
    -------
    views : list
        What was found, or why nothing was.
    image_size
        (columns, rows) of the pictures.

    Raises
    ------
    ImportDataError
        No picture can be read, or the two cameras' pictures have different sizes.
    """
    sizes: dict[str, set[tuple[int, ...]]] = {"left": set(), "right": set()}

    def look_at(view: PictureView) -> View:
        return View(
            view.name, _look(view.left, board, sizes["left"]), _look(view.right, board, sizes["right"])
        )

    found = []
    # The detector runs on one core and lets other threads work meanwhile.
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for view in pool.map(look_at, views):
            found.append(view)
            progress()
    shapes = sizes["left"] | sizes["right"]
    if not shapes:
        raise ImportDataError("none of the pictures can be read")
    if len(shapes) > 1:
        raise ImportDataError(
            f"the pictures have different sizes: left {_sizes(sizes['left'])}, right {_sizes(sizes['right'])}",
            remedy="All pictures of both cameras must have one size.",
        )
    rows, columns = shapes.pop()
    return found, (columns, rows)


def is_picture(path: Path) -> bool:
    """Whether a file name is that of a picture."""
    return path.suffix.lower() in _PICTURE_SUFFIXES


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sorting key under which view 10 follows view 9."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def read_picture(path: Path) -> Picture:
    """Read a picture file as it is, 8 or 16 bit; colour becomes grey.

    Raises
    ------
    ImportDataError
        The file is no picture, or damaged.
    """
    import cv2

    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ImportDataError(f"'{path}' cannot be read: {error.strerror}") from None
    try:
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE
        picture = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        picture = None
    if picture is None:
        raise ImportDataError(f"'{path}' is no picture, or damaged")
    return picture


def _look(load: Load | None, board: Board, sizes: set[tuple[int, ...]]) -> Detection | NoBoard:
    """Detection or reason; the size of a picture that could be read is added to `sizes`."""
    if load is None:
        return NoBoard("there is no picture")
    try:
        picture = load()
    except ImportDataError as error:
        return NoBoard(error.what)
    sizes.add(picture.shape)
    return detect_board(picture, board)


def _side_and_key(stem: str) -> tuple[str, str]:
    """Which camera a file name speaks of (left when it does not say), and the rest of the name."""
    match = _SIDE.search(stem)
    if match is None:
        return "left", stem
    rest = f"{stem[: match.start()]}{stem[match.end() :]}".strip("_-. ")
    return ("left" if match[0].lower().startswith("l") else "right"), rest or stem


def _pictures_in(folder: Path) -> list[Path]:
    pictures = [path for path in folder.iterdir() if is_picture(path)]
    if not pictures:
        raise ImportDataError(
            f"there are no pictures in '{folder}'",
            remedy=f"Pictures end in {', '.join(sorted(_PICTURE_SUFFIXES))}.",
        )
    return pictures


def _loader(path: Path | None) -> Load | None:
    return None if path is None else lambda: read_picture(path)


def _run_loader(run: RunFile, camera: str, frames: NDArray[np.intp], corrections: Corrections) -> Load:
    return lambda: mean_picture(run, camera, frames, corrections)


def mean_picture(
    run: RunFile, camera: str, frames: NDArray[np.intp], corrections: Corrections
) -> NDArray[np.float32]:
    """Mean of some frames of a camera, corrected: (rows, columns) float32, counts."""
    # Made for each call: pictures of a camera are read by several threads.
    pictures = CorrectedPictures(run, camera, corrections)
    return average(np.stack([pictures.read(int(index)) for index in frames]))


def middle_of(stretch: range) -> slice:
    """The middle of a stretch, as many frames as are averaged: its ends may still be moving."""
    spare = max(0, len(stretch) - FRAMES_TO_AVERAGE)
    first = stretch[0] + spare // 2
    return slice(first, first + len(stretch) - spare)


def _sizes(shapes: Iterable[tuple[int, ...]]) -> str:
    return ", ".join(f"{shape[1]} x {shape[0]}" for shape in sorted(shapes)) or "none"
