"""The preheat monitor on a run file: one that is closed, or one that still grows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import FrameFlag
from thermacq.errors import CorrectionError
from thermacq.imaging.corrections import corrections_of
from thermacq.store import EventKind, RunFile, open_run
from thermacq_calibration.infrared.preheat import (
    Grade,
    Preheat,
    PreheatLimits,
    judge_preheat,
)
from thermacq_calibration.infrared.warm_up import WarmUp
from thermacq_calibration.targets.pictures import saturation

OVERRIDE = "preheat override"
"""Beginning of the event that tells why somebody went on without a go."""

_SAMPLE_S = 0.9
# Pictures of a fast recording are looked at about once a second; drift is slow.
_SHORT_CLOSING_S = 0.6
# Frames farther apart may miss the shutter of a camera that corrects itself.
_STUCK_S = 30.0
# Longer than any shutter stays closed; noise makes each picture another one.


@dataclass(frozen=True)
class PreheatStatus:
    """Go or no-go of a rig at one time.

    Parameters
    ----------
    run
        The run file.
    time_s
        Since the recording began.
    cameras
        Judgement of each camera, by its name.
    temperatures_k
        Temperature of each focal plane; NaN where unknown.
    override
        Why somebody went on without a go; empty: nobody did.
    faults
        What is wrong with the pictures of a camera, by its name: none of its figures can be trusted then.
    """

    run: Path
    time_s: float
    cameras: dict[str, Preheat]
    temperatures_k: dict[str, float]
    override: str = ""
    faults: dict[str, str] = field(default_factory=dict)

    @property
    def is_ready(self) -> bool:
        """Whether all cameras are ready."""
        return all(self._is_camera_go(name) for name in self.cameras)

    @property
    def is_go(self) -> bool:
        """Whether all cameras are ready, or somebody decided to go on."""
        return self.is_ready or bool(self.override)

    @property
    def ready_in_s(self) -> float:
        """Predicted time until all are ready; NaN when nothing can be said."""
        if self.faults:
            return math.nan
        times_s = [camera.ready_in_s for camera in self.cameras.values()]
        return math.nan if any(not math.isfinite(one) for one in times_s) else max(times_s)

    @property
    def verdict(self) -> str:
        """The judgement in a line, short enough for an event of a run file."""
        parts = []
        for name, camera in self.cameras.items():
            failed = [one.name for one in camera.criteria if one.grade is Grade.FAIL]
            why = ["picture"] if name in self.faults else failed or ["nothing judged"]
            parts.append(f"{name} {'go' if self._is_camera_go(name) else 'no-go: ' + ', '.join(why)}")
        return "; ".join(parts)

    def facts(self) -> dict[str, Any]:
        """Plain values for JSON; what is not known is None."""
        cameras = {
            name: {
                "go": self._is_camera_go(name),
                "fault": self.faults.get(name, ""),
                "ready_in_s": _known(camera.ready_in_s),
                "fpa_temperature_k": _known(self.temperatures_k[name]),
                "criteria": [
                    {key: _known(value) for key, value in asdict(one).items()} for one in camera.criteria
                ],
            }
            for name, camera in self.cameras.items()
        }
        return {
            "run": str(self.run),
            "time_s": self.time_s,
            "go": self.is_go,
            "ready": self.is_ready,
            "override": self.override,
            "ready_in_s": _known(self.ready_in_s),
            "cameras": cameras,
        }

    def _is_camera_go(self, name: str) -> bool:
        return self.cameras[name].is_go and name not in self.faults


class PreheatMonitor:
    """Looks at a run file, again and again while it grows.

    Parameters
    ----------
    path
        The run file.
    counts_per_kelvin
        Scale of the counts, for all cameras; None: that of their corrections, where they have some.
    correction_files
        Corrections of the cameras; without any, those stored in the run.
    limits
        Bars of the criteria.
    """

    def __init__(
        self,
        path: Path,
        counts_per_kelvin: float | None = None,
        correction_files: Sequence[Path] = (),
        limits: PreheatLimits | None = None,
    ) -> None:
        self._path = path
        self._given = counts_per_kelvin
        self._files = correction_files
        self._limits = limits or PreheatLimits()
        self._scales: dict[str, float | None] = {}
        self._seen: dict[str, _Samples] = {}
        self._override = ""

    def update(self) -> PreheatStatus | None:
        """Read what is new and judge; None while some camera has no frame.

        Raises
        ------
        StoreError, CorrectionError
            The run, or a correction, cannot be read.
        """
        with open_run(self._path) as run:
            if not self._seen:
                self._begin(run)
            for name, samples in self._seen.items():
                samples.read(run, name)
            self._override = override_of(run)
        return self._judge()

    def warm_up(self, camera: str) -> WarmUp:
        """What was seen of a camera so far."""
        return self._seen[camera].warm_up()

    def scale(self, camera: str) -> float | None:
        """Counts per kelvin of a camera; None where they are not known."""
        return self._scales[camera]

    @property
    def limits(self) -> PreheatLimits:
        """Bars of the criteria."""
        return self._limits

    def _begin(self, run: RunFile) -> None:
        known = corrections_of(run, self._files).cameras
        for name in run.cameras:
            correction = known.get(name)
            found = None if correction is None else correction.counts_per_kelvin
            self._scales[name] = found if self._given is None else self._given
            self._seen[name] = _Samples(bool(run.camera(name).capabilities.get("has_shutter")))
        if not self._seen:
            raise CorrectionError(f"'{run.path}' has no camera")

    def _judge(self) -> PreheatStatus | None:
        seen = {name: samples.warm_up() for name, samples in self._seen.items()}
        if not all(len(one.time_s) for one in seen.values()):
            return None
        cameras = {name: judge_preheat(one, self._scales[name], self._limits) for name, one in seen.items()}
        temperatures_k = {name: float(one.fpa_temperature_k[-1]) for name, one in seen.items()}
        time_s = max(camera.time_s for camera in cameras.values())
        faults = {name: fault for name, samples in self._seen.items() if (fault := samples.fault())}
        return PreheatStatus(self._path, time_s, cameras, temperatures_k, self._override, faults)


class _Samples:
    """What was read of one camera."""

    def __init__(self, has_shutter: bool) -> None:
        self._has_shutter = has_shutter
        self._rows = 0
        self._interval_s = 0.0
        self._last = (-math.inf, False)
        self._taken: list[tuple[float, float, float, bool]] = []
        self._repeated = 0
        self._closed = 0
        self._open_s = self._changed_s = 0.0
        self._spoilt_by = ""

    def read(self, run: RunFile, camera: str) -> None:
        """Take in what is new: about one frame a second, and each change of the shutter."""
        table = run.frames(camera)
        time_s = (table.host_ns - run.header.host_anchor_ns) / 1e9
        closed = (table.flags & FrameFlag.SHUTTER) != 0
        spoilt = (table.flags & FrameFlag.INCOMPLETE) != 0
        for row in range(self._rows, len(table)):
            is_closed = bool(closed[row])
            self._closed += is_closed
            is_repeated = row > 0 and table.crc32[row] == table.crc32[row - 1]
            self._repeated += is_closed and is_repeated
            if not is_closed:
                self._open_s = float(time_s[row])
                self._changed_s = self._changed_s if is_repeated else self._open_s
            since_s = float(time_s[row]) - self._last[0]
            if spoilt[row] or since_s <= 0 or (since_s < _SAMPLE_S and is_closed == self._last[1]):
                continue
            picture = run.counts(camera, row)
            level = float(picture.mean(dtype=np.float64))
            if not is_closed:
                self._spoilt_by = _spoilt_by(picture)
            self._taken.append((float(time_s[row]), float(table.fpa_temperature_k[row]), level, is_closed))
            self._last = float(time_s[row]), is_closed
        self._rows = len(table)
        self._interval_s = float(np.median(np.diff(time_s))) if len(table) > 1 else 0.0

    def fault(self) -> str:
        """What is wrong with the pictures now; empty when nothing is."""
        stuck_s = self._open_s - self._changed_s
        if not self._spoilt_by and stuck_s > _STUCK_S:
            return f"the camera has repeated one and the same picture for {stuck_s / 60:.1f} min"
        return self._spoilt_by

    def warm_up(self) -> WarmUp:
        values = np.array(self._taken, np.float64).reshape(-1, 4)
        # A camera that corrects itself repeats its last picture meanwhile; noise never repeats itself.
        frozen = 2 * self._repeated >= self._closed
        is_sparse = self._interval_s > _SHORT_CLOSING_S
        return WarmUp(
            values[:, 0],
            values[:, 1],
            values[:, 2],
            values[:, 3] > 0,
            frozen,
            self._has_shutter,
            is_sparse,
        )


def _spoilt_by(picture: NDArray[Any]) -> str:
    """Why a picture cannot drift; empty when it may."""
    if picture.min() == picture.max():
        return f"the picture is constant: each pixel has the count {picture.min()}"
    saturated = saturation(picture)
    return f"the picture is {saturated}" if saturated else ""


def override_of(run: RunFile) -> str:
    """Why somebody went on without a go when this run was made; empty: nobody did."""
    for event in run.events():
        if event.kind is EventKind.NOTE and event.detail.startswith(OVERRIDE):
            return event.detail.removeprefix(OVERRIDE).removeprefix(": ")
    return ""


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
