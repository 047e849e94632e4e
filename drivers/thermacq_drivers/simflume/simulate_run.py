"""Records a scene with a ready rig, through the ordinary recorder, and then writes its truth."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from thermacq.errors import StoreError
from thermacq_drivers.simflume.ready_made import RIGS, rig_toml, scene_toml

TRUTH_SPACING_M = 0.005
_PAPER = "paper"


def simulate(scene: str, rig: str | None, run: Path, length: Sequence[str], truth: Path | None) -> int:
    """Record a scene and write its truth; messages of the recorder go to the terminal.

    Parameters
    ----------
    scene, rig
        Files ending in ``.toml``, or names of ready ones. Without a rig: the ready one of the scene's name,
        else the paper's.
    run
        Run file to make.
    length
        Options of ``thermacq record`` that say how long the recording is.
    truth
        NetCDF-4 file to make, or None.

    Returns
    -------
    int
        Exit status of ``thermacq record``; unless it is 0 no truth is written.

    Raises
    ------
    RigError
        There is no ready scene or rig of that name.
    StoreError
        The truth file exists.
    """
    if truth is not None and truth.exists():
        raise StoreError(f"'{truth}' exists", kept="Nothing was recorded.", remedy="Choose another name.")
    with tempfile.TemporaryDirectory(prefix="thermacq-simulate-") as directory:
        scene_file = _as_file(scene, scene_toml, Path(directory) / "scene.toml")
        rig_file = _as_file(rig or _rig_of(scene), rig_toml, Path(directory) / "rig.toml")
        files = [str(rig_file), "--scene", str(scene_file), "--output", str(run)]
        status = _wait(subprocess.Popen([sys.executable, "-m", "thermacq", "record", *files, *length]))
    if status == 0 and truth is not None:
        from thermacq_drivers.simflume.truth_file import write_truth

        write_truth(run, truth, TRUTH_SPACING_M, [])
    return status


def _rig_of(scene: str) -> str:
    name = Path(scene).stem if scene.endswith(".toml") else scene
    return name if name in RIGS else _PAPER


def _as_file(given: str, text_of: Callable[[str], str], file: Path) -> Path:
    """The file that is given, or the ready text of that name written to `file`."""
    if given.endswith(".toml"):
        return Path(given)
    file.write_text(text_of(given), encoding="utf-8")
    return file


def _wait(recorder: subprocess.Popen[bytes]) -> int:
    """Wait for the recorder; Ctrl-C reaches it too, and it then ends the run cleanly."""
    while True:
        try:
            return recorder.wait()
        except KeyboardInterrupt:
            continue
