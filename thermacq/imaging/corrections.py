"""Corrections applied on reading: which of them a run's pictures get, and the pictures that come of it.

Raw counts are never altered. `corrections_of` decides, `CorrectedPictures` reads; whatever was applied is in
`Corrections.provenance`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from thermacq.devices import FrameFlag
from thermacq.errors import CorrectionError
from thermacq.hooks import PictureCorrection
from thermacq.plugins import plugins
from thermacq.rig import CorrectionTable
from thermacq.settings import explain
from thermacq.store import RunFile

if TYPE_CHECKING:
    from thermacq_calibration import CameraCorrection, Corrector

LARGEST_WARMING_K = 1.0
"""Change of the focal plane's temperature since the correction from which a user is warned."""
_SPOILT = int(FrameFlag.INCOMPLETE | FrameFlag.SHUTTER)


@dataclass(frozen=True)
class Stage:
    """A stage of a plugin, its settings complete."""

    name: str
    settings: dict[str, Any]


@dataclass(frozen=True)
class Corrections:
    """What is done to the pictures of a run when they are read; travels to worker processes by pickling.

    Parameters
    ----------
    cameras
        Correction of each camera that has one, by its name in the run.
    origin
        Where they are from: ``run``, ``files``, or ``none``.
    nonuniformity, bad_pixels, shading
        Which of the built-in stages are applied.
    stages
        Stages of plugins, applied to every camera after the built-in ones.
    """

    cameras: Mapping[str, CameraCorrection] = field(default_factory=dict)
    origin: str = "none"
    nonuniformity: bool = True
    bad_pixels: bool = True
    shading: bool = True
    stages: tuple[Stage, ...] = ()

    def corrector(self, camera: str) -> Corrector | None:
        """The built-in stages of a camera; None when there is nothing to do."""
        from thermacq_calibration import Corrector

        correction = self.cameras.get(camera)
        if correction is None or not (self.nonuniformity or self.bad_pixels or self.shading):
            return None
        return Corrector(correction, self.nonuniformity, self.bad_pixels, self.shading)

    def provenance(self) -> dict[str, Any]:
        """What is applied, as plain values; equal only when the corrected pictures are."""
        cameras = {}
        for name, correction in self.cameras.items():
            corrector = self.corrector(name)
            if corrector is not None and corrector.stages:
                cameras[name] = {
                    "sha256": correction.sha256,
                    "serial": correction.serial,
                    "created": correction.created,
                    "offset_updated": correction.offset_updated,
                    "stages": list(corrector.stages),
                }
        return {
            "from": self.origin if cameras else "none",
            "cameras": cameras,
            "stages": [{"name": stage.name, "settings": stage.settings} for stage in self.stages],
        }


NO_CORRECTIONS = Corrections()
"""Pictures as the cameras delivered them."""


def corrections_of(
    run: RunFile,
    files: Sequence[Path] = (),
    *,
    use: bool = True,
    stages: Sequence[Mapping[str, Any]] | None = None,
) -> Corrections:
    """Which corrections the pictures of a run get.

    Parameters
    ----------
    run
        The run.
    files
        Correction files; each is given to the camera of its serial number. None: those stored with the run.
    use
        False: none at all.
    stages
        Stages of plugins, each with ``name`` and ``settings``; None: those that the rig names.

    Raises
    ------
    CorrectionError
        A file belongs to no camera of the run or to one that has its correction already, is for pictures of
        another size, or a stage has impossible settings.
    thermacq_calibration.CalibrationError
        A file is missing or damaged.
    StoreError
        A correction stored with the run is damaged.
    PluginError
        There is no such stage.
    """
    if not use:
        return NO_CORRECTIONS
    table = run.rig.correction
    given = _by_camera(run, files) if files else run.corrections()
    for camera, correction in given.items():
        check_fits(run, camera, correction)
    wanted = _named_stages(table) if stages is None else stages
    return Corrections(
        given,
        "files" if files else "run",
        table.nonuniformity,
        table.bad_pixels,
        table.shading,
        tuple(_complete(stage["name"], stage.get("settings", {})) for stage in wanted),
    )


def doubts(run: RunFile, cameras: Sequence[str], corrections: Corrections) -> tuple[str, ...]:
    """What a user should know before trusting these corrections in the pictures of these cameras."""
    found = []
    corrected = [camera for camera in cameras if corrections.corrector(camera) is not None]
    if corrected and len(corrected) < len(cameras):
        missing = ", ".join(f"'{camera}'" for camera in cameras if camera not in corrected)
        found.append(f"camera {missing} has no correction, the other one has")
    for camera in corrected:
        table, record = run.frames(camera), corrections.cameras[camera]
        is_closed = (table.flags & int(FrameFlag.SHUTTER)) != 0
        events = int(np.count_nonzero(is_closed[1:] & ~is_closed[:-1]) + is_closed[:1].sum())
        if events and corrections.nonuniformity:
            found.append(
                f"camera '{camera}' closed its shutter {events} times: it may have changed its offsets, to which "
                "the correction does not fit any more; switch automatic shutter corrections off for recordings"
            )
        inside_k = table.fpa_temperature_k[np.isfinite(table.fpa_temperature_k)]
        if inside_k.size and record.fpa_temperature_k is not None:
            warmer_k = float(inside_k.mean()) - record.fpa_temperature_k
            if abs(warmer_k) > LARGEST_WARMING_K:
                found.append(
                    f"the focal plane of camera '{camera}' is {warmer_k:+.1f} K from where its correction was "
                    "made: update the offsets by a uniform view (`thermacq correction update`)"
                )
    return tuple(found)


def check_fits(run: RunFile, camera: str, correction: CameraCorrection) -> None:
    """Refuse the correction of another camera, or for pictures of another size; raises `CorrectionError`."""
    stream = run.camera(camera)
    serial = stream.serial
    if serial and correction.serial and serial != correction.serial:
        raise CorrectionError(
            f"the correction is that of camera {correction.serial}; camera '{camera}' of '{run.path}' is {serial}",
            remedy="Use the correction that was made with this camera.",
        )
    rows, columns = correction.shape
    if (stream.rows, stream.columns) != (rows, columns):
        raise CorrectionError(
            f"the correction of camera '{camera}' is for pictures of {columns} x {rows} pixels, those of "
            f"'{run.path}' have {stream.columns} x {stream.rows}",
            remedy="Use the correction that was made in this picture format.",
        )


class CorrectedPictures:
    """Reads the pictures of one camera of a run, corrected; the file stays open elsewhere.

    A picture depends on its own number only, not on which were read before: a stage with a memory is made anew
    and shown the pictures before, whenever the numbers are not consecutive.

    Parameters
    ----------
    run
        The run file.
    camera
        Name of the camera.
    corrections
        What is applied.
    """

    def __init__(self, run: RunFile, camera: str, corrections: Corrections) -> None:
        self._run = run
        self._camera = camera
        self._corrector = corrections.corrector(camera)
        self._stages = corrections.stages
        self._makers = [plugins().correction_stage(stage.name) for stage in self._stages]
        self._models = [
            maker.settings().model_validate(stage.settings)
            for maker, stage in zip(self._makers, self._stages, strict=True)
        ]
        self._memory = sum(
            maker.memory(model) for maker, model in zip(self._makers, self._models, strict=True)
        )
        self._made: list[PictureCorrection] = []
        self._latest = -1
        table = run.frames(camera)
        self._temperature_k = table.fpa_temperature_k
        self._is_good = (table.flags & _SPOILT) == 0

    def read(self, index: int) -> NDArray[np.uint16] | NDArray[np.float32]:
        """Picture of frame `index`, (rows, columns): float32 corrected counts, or raw ones when nothing is applied.

        Raises
        ------
        StoreError
            There is no such frame, or it is damaged.
        """
        if not self._stages:
            return self._built_in(index)
        before = self._before(index)
        if not self._made or (self._memory > 0 and before[-1:] != [self._latest]):
            self._made = [maker.make(model) for maker, model in zip(self._makers, self._models, strict=True)]
            for earlier in before:
                self._staged(earlier)
        self._latest = index
        return self._staged(index)

    def _before(self, index: int) -> list[int]:
        """The good frames that the stages remember when they come to this one."""
        if self._memory == 0:
            return []
        good = np.flatnonzero(self._is_good[:index])
        return [int(one) for one in good[-self._memory :]]

    def _built_in(self, index: int) -> NDArray[np.uint16] | NDArray[np.float32]:
        counts = self._run.counts(self._camera, index)
        if self._corrector is None:
            return counts
        return self._corrector(counts, float(self._temperature_k[index]))

    def _staged(self, index: int) -> NDArray[np.float32]:
        picture = np.asarray(self._built_in(index), np.float32)
        for stage in self._made:
            picture = stage(picture)
        return picture


def _by_camera(run: RunFile, files: Sequence[Path]) -> dict[str, CameraCorrection]:
    """Corrections given as files, each for the camera whose serial number it has."""
    from thermacq_calibration import load_correction

    found: dict[str, CameraCorrection] = {}
    for file in files:
        correction = load_correction(file)
        camera = _camera_of(run, correction)
        if camera is None:
            known = ", ".join(f"{name} is {run.camera(name).serial or 'unknown'}" for name in run.cameras)
            raise CorrectionError(
                f"'{file}' is the correction of camera {correction.serial or correction.camera}, which did not "
                f"take part in '{run.path}' ({known})",
                remedy="Use the corrections of the cameras of this run.",
            )
        if camera in found:
            raise CorrectionError(
                f"two corrections were given for camera '{camera}'; the second is '{file}'",
                remedy="Give one for each camera.",
            )
        found[camera] = correction
    return found


def _camera_of(run: RunFile, correction: CameraCorrection) -> str | None:
    """Camera of a correction: by serial number, and by name where either has none."""
    for name in run.cameras:
        serial = run.camera(name).serial
        if serial and correction.serial:
            if serial == correction.serial:
                return name
        elif name == correction.camera:
            return name
    return None


def _named_stages(table: CorrectionTable) -> list[dict[str, Any]]:
    return [{"name": stage.name, "settings": stage.settings} for stage in table.stages]


def _complete(name: str, settings: Mapping[str, Any]) -> Stage:
    """A stage with every default filled in."""
    model = plugins().correction_stage(name).settings()
    try:
        return Stage(name, model.model_validate(dict(settings)).model_dump(mode="json"))
    except ValidationError as error:
        raise CorrectionError(
            explain(error, model, f"settings of correction stage '{name}'"),
            remedy=f"Its settings: {', '.join(model.model_fields)}.",
        ) from None
