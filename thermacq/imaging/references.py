"""Uniform views in recorded runs: which frames show one, at which temperature, and what they say of each camera."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import FrameFlag
from thermacq.errors import CorrectionError
from thermacq.store import RunFile, open_run

if TYPE_CHECKING:
    from thermacq_calibration import ReferenceView

_SPOILT = int(FrameFlag.INCOMPLETE | FrameFlag.SHUTTER)
_LOWEST_K = 150.0
_SETTLING_FRAMES = 10
"""A simulated blackbody steps between two frames; a camera with inertia still sees the old one for some."""


@dataclass(frozen=True)
class Reference:
    """Frames of a run that show a uniform view.

    Parameters
    ----------
    path
        The run file.
    temperature_k
        Temperature of the view; None: as the simulated scene says, or unknown.
    first, last
        Range of frames, `last` not included; None: from the beginning, to the end.
    """

    path: Path
    temperature_k: float | None = None
    first: int | None = None
    last: int | None = None


def parse_reference(text: str) -> Reference:
    """Read ``RUN``, ``RUN@KELVIN`` or ``RUN@KELVIN@A:B``.

    Raises
    ------
    CorrectionError
        The temperature is no number in kelvin, or the range is none.
    """
    if Path(text).is_file():
        return Reference(Path(text))
    path, *rest = text.rsplit("@", 2) if text.count("@") > 1 and ":" in text else text.rsplit("@", 1)
    temperature_k = _kelvin(rest[0], text) if rest and rest[0] else None
    first = last = None
    if len(rest) == 2:
        begin, colon, end = rest[1].partition(":")
        try:
            first, last = (int(begin) if begin else None), (int(end) if end else None)
        except ValueError:
            colon = ""
        if not colon or min(first or 0, last or 0) < 0:
            raise CorrectionError(f"'{rest[1]}' in '{text}' is no range of frames", remedy="Write 0:64.")
    return Reference(Path(path), temperature_k, first, last)


def views_of(reference: Reference, cameras: list[str] | None = None) -> dict[str, ReferenceView]:
    """What a reference shows to each camera of its run.

    Parameters
    ----------
    reference
        The frames.
    cameras
        Names of the cameras that are wanted; None: all.

    Raises
    ------
    CorrectionError
        The run has no such frames, or shows several temperatures of which none was chosen.
    StoreError
        The run cannot be read.
    thermacq_calibration.CalibrationError
        The frames are too few, saturated, constant or not of one size.
    """
    with open_run(reference.path) as run:
        return {camera: _view(run, camera, reference) for camera in cameras or run.cameras}


def serials_of(path: Path) -> dict[str, str]:
    """Serial number of each camera of a run, empty where it has none."""
    with open_run(path) as run:
        return {name: run.camera(name).serial for name in run.cameras}


def middle_time(reference: Reference) -> str:
    """Wall-clock time of the middle of the frames, ISO 8601, UTC; raises as `views_of`."""
    with open_run(reference.path) as run:
        camera = run.cameras[0]
        chosen, _ = frames_of(run, camera, reference)
        header, host_ns = run.header, run.frames(camera).host_ns[chosen]
    unix_ns = header.wall_anchor_ns + int(host_ns.mean()) - header.host_anchor_ns
    return datetime.fromtimestamp(unix_ns / 1e9, UTC).isoformat(timespec="seconds")


def _view(run: RunFile, camera: str, reference: Reference) -> ReferenceView:
    from thermacq_calibration import observe

    chosen, temperature_k = frames_of(run, camera, reference)
    table = run.frames(camera)
    inside_k = table.fpa_temperature_k[chosen]
    known_k = inside_k[np.isfinite(inside_k)]
    return observe(
        _counts(run, camera, chosen),
        temperature_k,
        float(known_k.mean()) if known_k.size else None,
        f"{run.path.name}, camera '{camera}'",
    )


def frames_of(run: RunFile, camera: str, reference: Reference) -> tuple[NDArray[np.intp], float | None]:
    """Positions of the frames that are meant, and the temperature that they show, None where it is not known.

    Raises
    ------
    CorrectionError
        There are none, or they show several temperatures of which none was chosen.
    """
    table = run.frames(camera)
    is_wanted = (table.flags & _SPOILT) == 0
    number = np.arange(len(table))
    is_wanted &= (number >= (reference.first or 0)) & (
        number < (len(table) if reference.last is None else reference.last)
    )
    temperature_k = reference.temperature_k
    stepped = _scene_temperatures(run, table.trigger_index)
    if stepped is not None and is_wanted.any():
        shown = np.unique(stepped[is_wanted & np.isfinite(stepped)])
        if temperature_k is None and len(shown) > 1:
            listed = ", ".join(f"{one:g}" for one in shown)
            raise CorrectionError(
                f"'{run.path}' shows a blackbody at {listed} K one after the other",
                remedy=f"Say which is meant: {run.path}@{shown[0]:g}.",
            )
        wanted_k = float(shown[0]) if temperature_k is None and len(shown) else temperature_k
        is_there = np.abs(stepped - (math.nan if wanted_k is None else wanted_k)) < 1e-3
        if not (is_wanted & is_there).any():
            listed = ", ".join(f"{one:g}" for one in shown)
            raise CorrectionError(
                f"the blackbody in '{run.path}' never has {wanted_k:g} K in these frames, but {listed} K",
                remedy="Give one of these temperatures.",
            )
        is_wanted, temperature_k = is_wanted & is_there, wanted_k
    if not is_wanted.any():
        raise CorrectionError(
            f"'{run.path}' has no good frames of camera '{camera}' in this range",
            remedy="`thermacq info` shows what was recorded; frames with the shutter closed do not count.",
        )
    return np.flatnonzero(is_wanted), temperature_k


def _scene_temperatures(run: RunFile, trigger_index: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Temperature of the simulated blackbody in each frame, NaN shortly after a step; None for other runs."""
    scene: dict[str, Any] = run.header.rig.get("scene") or {}
    uniform = scene.get("uniform") or {}
    steps, each = uniform.get("temperatures_k"), uniform.get("frames_per_temperature")
    if not (run.header.simulated and scene.get("view") == "uniform" and steps and each):
        return None
    index = np.where(trigger_index >= 0, trigger_index, np.arange(len(trigger_index)))
    place = np.minimum(index // int(each), len(steps) - 1)
    temperature_k = np.asarray(steps, np.float64)[place]
    is_settling = (place > 0) & (index - place * int(each) < _SETTLING_FRAMES)
    return np.where(is_settling, np.nan, temperature_k)


def _counts(run: RunFile, camera: str, chosen: NDArray[np.intp]) -> Iterator[NDArray[np.uint16]]:
    for index in chosen:
        yield run.counts(camera, int(index))


def _kelvin(word: str, text: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not _LOWEST_K < value < 1000:
        raise CorrectionError(
            f"'{word}' in '{text}' is no temperature in kelvin",
            remedy="Write RUN@293.15 for 20 °C.",
        )
    return value
