"""Recording from Python and from the command line: start a recorder, follow it, get its result."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thermacq.acquisition import control
from thermacq.acquisition.job import Job, RecordingResult, error_from_dict
from thermacq.acquisition.plan import check_time
from thermacq.errors import AcquisitionError
from thermacq.plugins import plugins
from thermacq.rig import Rig, load_rig
from thermacq.rig.rehearsal import emulated_devices

if TYPE_CHECKING:
    from thermacq_calibration import StereoCalibration

_POLL_S = 0.25

OnStatus = Callable[[control.Status], None]


class Session:
    """A client's hold on one recording; the recording does not depend on it."""

    def __init__(self, folder: Path, pid: int | None = None) -> None:
        self.folder = folder
        self._pid = pid

    def status(self) -> control.Status | None:
        """Status now; None when the recorder does not answer."""
        return control.request(self.folder, "status")

    def stop(self) -> None:
        """Ask the recorder to end the recording; it keeps everything."""
        if control.request(self.folder, "stop") is None and self._pid is not None and self._lives():
            os.kill(self._pid, signal.SIGTERM)

    def note(self, text: str) -> bool:
        """Have a note written among the events of the run file, at most 200 bytes of it; True when it will be."""
        return control.request(self.folder, "note", text=text) is not None

    def follow(self, on_status: OnStatus | None = None, until: str = "ended") -> None:
        """Hand on each status until the recording is in the state `until`, or has ended."""
        watcher = control.Watcher(self.folder)
        try:
            while self._lives():
                status = watcher.next(_POLL_S)
                if status is not None:
                    if on_status is not None:
                        on_status(status)
                    if status["state"] == until:
                        return
        finally:
            watcher.close()

    def wait(self) -> None:
        """Wait until the recorder is gone."""
        while self._lives():
            time.sleep(_POLL_S / 10)

    def result(self) -> RecordingResult:
        """Wait for the end of the recording and say how it went; its folder is removed.

        Raises
        ------
        ThermacqError
            What kept the recording from starting, or from being written to the end.
        """
        self.wait()
        result = control.read_json(self.folder / control.RESULT)
        loss = None if result is not None else self._recorder_loss()
        shutil.rmtree(self.folder, ignore_errors=True)
        if loss is not None:
            raise loss
        if (error := result.pop("error")) is not None:
            raise error_from_dict(error)
        return RecordingResult.from_dict(result)

    def _recorder_loss(self) -> AcquisitionError:
        log = self.folder / control.LOG
        last_words = log.read_text(errors="replace").strip()[-500:] if log.exists() else ""
        job = control.read_json(self.folder / control.JOB) or {"output": ""}
        path = Path(job["output"])
        if not path.is_file():
            return AcquisitionError(
                f"the recorder process was lost. {last_words}", kept="There is no run file."
            )
        return AcquisitionError(
            f"the recorder process was lost. {last_words}",
            kept=f"What was recorded is in '{path}'; its writer closes it by itself if it lives.",
            remedy=f"`thermacq info {path}` shows what is there, `thermacq recover` mends it.",
        )

    def _lives(self) -> bool:
        if self._pid is not None:
            try:
                if os.waitpid(self._pid, os.WNOHANG) == (0, 0):
                    return True
            except ChildProcessError:
                pass
            self._pid = None
        return control.is_alive(self.folder)


def start(
    rig: Path | Rig,
    output: Path,
    *,
    duration_s: float | None = None,
    frames: int | None = None,
    scene: Path | None = None,
    calibration: Path | StereoCalibration | None = None,
    emulate: bool = False,
) -> Session:
    """Start a recorder; it goes on when this process ends.

    Parameters
    ----------
    rig
        Rig file, or a resolved rig.
    output
        Run file to be; must not exist.
    duration_s, frames
        When to end; at most one. Without, it records until `Session.stop`.
    scene
        Scene file whose keys replace those of the rig's ``[scene]`` table; needs `rig` to be a file.
    calibration
        Stereo calibration to store with the run.
    emulate
        Emulators play the devices that have one: a rehearsal without hardware.

    Raises
    ------
    ThermacqError
        Something is wrong with what was given. What the devices say comes with `Session.result`.
    """
    resolved = rig if isinstance(rig, Rig) else load_rig(rig, scene)
    output = output.absolute()
    if output.exists():
        raise AcquisitionError(
            f"'{output}' exists already; a run file is never overwritten",
            remedy="Choose another name, or move the old file away.",
        )
    if not output.parent.is_dir():
        raise AcquisitionError(
            f"there is no folder '{output.parent}'", remedy="Create it, or choose another."
        )
    job = Job(
        run_id=str(uuid.uuid4()),
        rig=resolved,
        output=output,
        duration_s=duration_s,
        frames=frames,
        calibration=_calibration_values(calibration),
        emulate=emulate,
    )
    check_time(job)
    if emulate:
        emulated_devices(resolved, plugins())
    folder = control.new_folder(job.run_id)
    control.write_json(folder / control.JOB, job.to_dict())
    return Session(folder, _launch(folder))


def record(
    rig: Path | Rig,
    output: Path,
    *,
    duration_s: float | None = None,
    frames: int | None = None,
    scene: Path | None = None,
    calibration: Path | StereoCalibration | None = None,
    emulate: bool = False,
    on_status: OnStatus | None = None,
) -> RecordingResult:
    """Record one run and wait for its end; parameters as in `start`.

    A keyboard interrupt ends the recording cleanly and is raised again once the file is closed.
    """
    session = start(
        rig,
        output,
        duration_s=duration_s,
        frames=frames,
        scene=scene,
        calibration=calibration,
        emulate=emulate,
    )
    try:
        session.follow(on_status)
    except KeyboardInterrupt:
        session.stop()
        session.result()
        raise
    return session.result()


def running() -> list[Session]:
    """Recordings that run now, the oldest first."""
    return [Session(folder) for folder in control.living_recordings()]


def _calibration_values(calibration: Path | StereoCalibration | None) -> dict[str, Any] | None:
    if isinstance(calibration, Path):
        from thermacq_calibration import load_calibration

        calibration = load_calibration(calibration)
    return None if calibration is None else calibration.to_dict()


def _launch(folder: Path) -> int:
    """Start the recorder in a session of its own: no signal for this terminal or client reaches it."""
    log = os.open(folder / control.LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    nothing = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.posix_spawn(
            sys.executable,
            [sys.executable, "-m", "thermacq.acquisition", str(folder)],
            # A small product in many BLAS threads takes a hundred times as long when the cores are busy.
            {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            file_actions=[
                (os.POSIX_SPAWN_DUP2, nothing, 0),
                (os.POSIX_SPAWN_DUP2, log, 1),
                (os.POSIX_SPAWN_DUP2, log, 2),
            ],
            setsid=True,
        )
    finally:
        os.close(log)
        os.close(nothing)
