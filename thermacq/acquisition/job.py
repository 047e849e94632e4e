"""What a client asks of a recorder, and what it gets back; both travel as JSON files."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from thermacq import errors
from thermacq.errors import AcquisitionError, ThermacqError
from thermacq.rig import Rig


@dataclass(frozen=True)
class Job:
    """One recording to make.

    Parameters
    ----------
    run_id
        UUID of the run.
    rig
        The resolved rig.
    output
        Absolute path of the run file to be.
    duration_s, frames
        When to end; at most one is given. Without, the recording goes on until it is stopped.
    calibration
        Stereo calibration record as plain values, or None.
    emulate
        Whether emulators play the devices that have one.
    """

    run_id: str
    rig: Rig
    output: Path
    duration_s: float | None = None
    frames: int | None = None
    calibration: dict[str, Any] | None = None
    emulate: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "run_id": self.run_id,
            "rig": self.rig.model_dump(mode="json"),
            "output": str(self.output),
            "duration_s": self.duration_s,
            "frames": self.frames,
            "calibration": self.calibration,
            "emulate": self.emulate,
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Job:
        """Undo `to_dict`."""
        return cls(**{**values, "rig": Rig.model_validate(values["rig"]), "output": Path(values["output"])})


@dataclass(frozen=True)
class RecordingResult:
    """How a recording ended.

    Parameters
    ----------
    path
        The run file.
    end_reason
        A value of `EndReason`; `message` says it in words.
    asked_for
        Whether it ended as somebody wanted.
    summary
        What stands in the run file's summary, the sync report under ``sync``.
    warnings
        What the user should know.
    """

    path: Path
    end_reason: str
    message: str
    asked_for: bool
    summary: dict[str, Any]
    warnings: tuple[str, ...] = field(default=())

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "path": str(self.path)}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> RecordingResult:
        """Undo `to_dict`."""
        return cls(**{**values, "path": Path(values["path"]), "warnings": tuple(values["warnings"])})


def error_to_dict(error: ThermacqError) -> dict[str, str]:
    """An error as plain values."""
    return {
        "kind": type(error).__name__,
        "what": error.what,
        "kept": error.kept,
        "remedy": error.remedy,
    }


def error_from_dict(values: dict[str, str]) -> ThermacqError:
    """The error again; one of a kind with another constructor comes back as `AcquisitionError`."""
    kind = getattr(errors, values["kind"], AcquisitionError)
    if not issubclass(kind, ThermacqError) or issubclass(kind, errors.DeviceFault):
        kind = AcquisitionError
    error: ThermacqError = kind(values["what"], kept=values["kept"], remedy=values["remedy"])
    return error
