"""A run's pairs to disparity: reading, rectification, and the matcher with its settings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from thermacq.errors import ReconstructionError
from thermacq.hooks import DisparityMatcher
from thermacq.imaging import NO_CORRECTIONS, CorrectedPictures, Corrections
from thermacq.plugins import plugins
from thermacq.reconstruction.disparity_range import estimate_disparity_range
from thermacq.reconstruction.pairs import RunPairs
from thermacq.settings import explain
from thermacq.store import open_run
from thermacq_calibration import Rectification, StereoCalibration, apply, rectify

_RANGE_PAIRS = 5
_RANGE_KEYS = ("min_disparity", "max_disparity")


@dataclass(frozen=True)
class MatchingJob:
    """Everything that a worker process needs to match pairs of a run; plain values and arrays only.

    Parameters
    ----------
    run_path
        The run file.
    calibration
        The calibration as plain values.
    matcher
        Name of the matcher.
    settings
        Its settings, complete.
    pairs
        The pairs to match.
    corrections
        What is done to the pictures first.
    """

    run_path: Path
    calibration: dict[str, Any]
    matcher: str
    settings: dict[str, Any]
    pairs: RunPairs
    corrections: Corrections = NO_CORRECTIONS


class PairReader:
    """Corrected and rectified pairs of a run; a context manager that holds the file open."""

    def __init__(
        self,
        run_path: Path,
        calibration: StereoCalibration,
        pairs: RunPairs,
        corrections: Corrections = NO_CORRECTIONS,
    ) -> None:
        self.rectification: Rectification = rectify(calibration)
        self._pairs = pairs
        self._run = open_run(run_path)
        self._left, self._right = (
            CorrectedPictures(self._run, camera, corrections)
            for camera in (pairs.left_camera, pairs.right_camera)
        )

    def read(self, index: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Rectified pair, two (rows, columns) float32 pictures in counts, NaN outside."""
        pairs = self._pairs
        left = self._left.read(int(pairs.left[index]))
        right = self._right.read(int(pairs.right[index]))
        return apply(self.rectification, left, right)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._run.close()


def make_matcher(name: str, settings: Mapping[str, Any]) -> DisparityMatcher:
    """Make a matcher; see `check_matcher_settings` for the errors."""
    matcher = plugins().matcher(name)
    return matcher.make(check_matcher_settings(name, settings))


def check_matcher_settings(name: str, settings: Mapping[str, Any]) -> BaseModel:
    """Settings of a matcher as its model, defaults filled in.

    Raises
    ------
    PluginError
        There is no such matcher.
    ReconstructionError
        A setting is unknown or impossible.
    """
    model = plugins().matcher(name).settings()
    try:
        return model.model_validate(dict(settings))
    except ValidationError as error:
        raise ReconstructionError(
            explain(error, model, f"settings of matcher '{name}'"),
            remedy=f"Its settings: {', '.join(model.model_fields)}.",
        ) from None


def parse_settings(assignments: Sequence[str]) -> dict[str, Any]:
    """Settings from ``key=value`` words; values are JSON where they can be, else text.

    Raises
    ------
    ReconstructionError
        A word has no ``=``.
    """
    settings: dict[str, Any] = {}
    for word in assignments:
        key, equals, value = word.partition("=")
        if not equals or not key:
            raise ReconstructionError(f"'{word}' is no setting", remedy="Write --set key=value.")
        try:
            settings[key] = json.loads(value)
        except ValueError:
            settings[key] = value
    return settings


def complete_settings(
    reader: PairReader, pairs: int, name: str, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Settings of a matcher with an unset range of disparity found from pairs spread over the run.

    A matcher takes part by having settings ``min_disparity`` and ``max_disparity`` that may be None. All
    frames of a run are matched with the same range, so that no frame depends on how the work was split.
    """
    complete = check_matcher_settings(name, settings).model_dump(mode="json")
    unset = [key for key in _RANGE_KEYS if complete.get(key, 0) is None]
    if unset:
        chosen = np.unique(np.linspace(0, pairs - 1, _RANGE_PAIRS).astype(int))
        found = estimate_disparity_range(
            (reader.read(int(index)) for index in chosen), doffs_px=reader.rectification.doffs_px
        )
        complete.update({key: value for key, value in zip(_RANGE_KEYS, found, strict=True) if key in unset})
    return check_matcher_settings(name, complete).model_dump(mode="json")
