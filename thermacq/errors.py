"""The one way to report an error: what happened, to what, what was kept, what to do next.

Everything that a person at the tank can cause or mend is a `ThermacqError`; the command line prints it
without a traceback. Anything else that escapes is a bug.
"""

from __future__ import annotations


class ThermacqError(Exception):
    """An error that is explained to the user instead of traced.

    Parameters
    ----------
    what
        What happened, and to which device or file.
    kept
        What was kept in spite of it (empty when nothing was at stake).
    remedy
        What to do next.
    """

    def __init__(self, what: str, *, kept: str = "", remedy: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.kept = kept
        self.remedy = remedy

    def __str__(self) -> str:
        return "\n".join(part for part in (self.what, self.kept, self.remedy) if part)


class RigError(ThermacqError):
    """A rig file is missing, malformed, or does not fit the devices."""


class PluginError(ThermacqError):
    """A plugin is unknown, blocked or broken."""


class StoreError(ThermacqError):
    """A run file or product cannot be written, opened, or trusted."""


class AcquisitionError(ThermacqError):
    """A recording could not start, or ended otherwise than asked."""


class ImportDataError(ThermacqError):
    """Foreign pictures, videos or series cannot be turned into a run file or series."""


class CorrectionError(ThermacqError):
    """Corrections of pictures cannot be made, or do not fit the pictures."""


class ReconstructionError(ThermacqError):
    """A surface cannot be reconstructed from this run with this calibration."""


class DeviceFault(ThermacqError):
    """A device did not do what its interface promises.

    Parameters
    ----------
    device
        Name of the device in the rig.
    stage
        The verb during which it happened: ``open``, ``configure``, ``arm``, ``acquire``, ...
    what
        What happened; kept as `reason`, while the attribute `what` names device and stage too.
    last_frame
        Index of the last good frame or sample, -1 before the first.
    kept, remedy
        As in `ThermacqError`.
    """

    def __init__(
        self, device: str, stage: str, what: str, *, last_frame: int = -1, kept: str = "", remedy: str = ""
    ) -> None:
        position = f" after frame {last_frame}" if last_frame >= 0 else ""
        super().__init__(f"device '{device}' ({stage}{position}): {what}", kept=kept, remedy=remedy)
        self.device = device
        self.stage = stage
        self.last_frame = last_frame
        self.reason = what

    def __reduce__(self) -> tuple[object, ...]:
        """Faults cross process borders, so they must survive pickling."""
        return _rebuild_fault, (
            type(self),
            self.device,
            self.stage,
            self.reason,
            self.last_frame,
            self.kept,
            self.remedy,
        )


class DeviceDisconnected(DeviceFault):
    """The device is gone: unplugged, powered off, or its control channel was lost."""


class DeviceTimeout(DeviceFault):
    """The device did not answer, or no frame came, within the stated time."""


class IncompleteFrame(DeviceFault):
    """A frame or sample block arrived damaged or short; the stream can go on."""


class DeviceOverrun(DeviceFault):
    """The device lost data because the host was late; the stream can go on."""


def _rebuild_fault(
    kind: type[DeviceFault], device: str, stage: str, what: str, last_frame: int, kept: str, remedy: str
) -> DeviceFault:
    return kind(device, stage, what, last_frame=last_frame, kept=kept, remedy=remedy)
