"""What the tests of the cameras share: the host's side with frames that are kept, and a recording as users make it."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np

from thermacq.errors import IncompleteFrame
from thermacq.testing.bench import StopSwitch

# Only against hanging: a busy computer may be late by seconds.
PATIENCE_S = 60.0


class KeepingHost(StopSwitch):
    """The host's side of an acquisition; each frame has a buffer of its own."""

    def __init__(self, camera):
        super().__init__()
        declared = camera.capabilities
        self.shape = declared.rows, declared.columns

    def buffer(self):
        return np.zeros(self.shape, np.uint16)


def take_frames(camera, number, within_s=PATIENCE_S):
    """Frames, and what was told of damaged ones between them; fewer when the time is over."""
    host, frames, told = KeepingHost(camera), [], []
    stream = camera.frames(host)
    deadline_s = time.monotonic() + within_s
    while len(frames) < number and time.monotonic() < deadline_s:
        try:
            frames.append(next(stream))
        except IncompleteFrame as fault:
            told.append(fault.what)
            stream = camera.frames(host)
    return frames, told


def record_emulated(folder, monkeypatch, rig, *options):
    """Record `rig` (TOML) with the command, every device emulated; its standard output and the run file."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    (folder / "rig.toml").write_text(rig)
    command = [sys.executable, "-m", "thermacq", "record", "rig.toml", "--emulate", "-o", "run.h5", *options]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=2 * PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, folder / "run.h5"
