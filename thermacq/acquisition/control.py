"""How a recording is watched and stopped: a private folder per recording, and two local sockets in it.

The recorder answers requests on one socket and publishes its status on the other, as JSON. The folder also
holds its job, its log, and at the end its result. A recorder holds a lock on its folder while it lives, so
that a client can tell a living one from one that was killed.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq

from thermacq.errors import AcquisitionError

JOB, LOG, RESULT, LOCK = "job.json", "recorder.log", "result.json", "lock"
_CONTROL, _STATUS = "control", "status"
_KEEP_ENDED_S = 600.0
_MOST_NOTES = 100

Status = dict[str, Any]


def runtime_folder() -> Path:
    """Folder of all recordings of this user, which nobody else may enter; made when missing.

    Raises
    ------
    AcquisitionError
        The folder belongs to somebody else, or others may enter it.
    """
    given = os.environ.get("XDG_RUNTIME_DIR", "")
    if given and Path(given).is_dir():
        folder = Path(given) / "thermacq"
    else:
        folder = Path(tempfile.gettempdir()) / f"thermacq-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise AcquisitionError(
            f"'{folder}' is not a folder that only you may enter",
            remedy=f"Remove it, or run `chmod 700 {folder}` if it is yours.",
        )
    return folder


def new_folder(run_id: str) -> Path:
    """Folder of a new recording; folders of recordings that ended a while ago are removed."""
    base = runtime_folder()
    for folder in base.iterdir():
        old = time.time() - folder.stat().st_mtime > _KEEP_ENDED_S
        if old and folder.is_dir() and not is_alive(folder):
            shutil.rmtree(folder, ignore_errors=True)
    folder = base / run_id[:12]
    folder.mkdir(mode=0o700)
    return folder


def living_recordings() -> list[Path]:
    """Folders of the recordings that run now, the oldest first."""
    folders = [folder for folder in runtime_folder().iterdir() if folder.is_dir() and is_alive(folder)]
    return sorted(folders, key=lambda folder: folder.stat().st_ctime)


def hold_lock(folder: Path) -> int:
    """Recorder: mark the folder as alive until this process ends."""
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return lock


def is_alive(folder: Path) -> bool:
    """Whether the recorder of this folder lives."""
    try:
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(lock)
    return False


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file in one step, so that nobody reads half of it."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(value), encoding="utf-8")
    part.replace(path)


def read_json(path: Path) -> Any:
    """Read a JSON file; None when it is not there."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None


class Desk:
    """The recorder's side: answers ``status``, ``stop`` and ``note``, publishes the status."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._context = zmq.Context()
        self._replies = self._context.socket(zmq.REP)
        self._news = self._context.socket(zmq.PUB)
        self._replies.bind(_address(folder / _CONTROL))
        self._news.bind(_address(folder / _STATUS))
        self.stop_wanted = False
        self.notes: list[str] = []
        """What clients want to stand in the run file; the recorder takes them out."""

    def serve(self, status: Callable[[], Status]) -> None:
        """Answer the requests that wait; a malformed one gets an answer that says so."""
        while self._replies.poll(0):
            request = self._replies.recv()
            try:
                values = json.loads(request)
                command = values["command"]
            except (ValueError, KeyError, TypeError):
                command, values = "", {}
            if command == "stop":
                self.stop_wanted = True
            if command == "note" and len(self.notes) < _MOST_NOTES:
                self.notes.append(str(values.get("text", "")))
            if command in ("status", "stop", "note"):
                answer = status()
            else:
                answer = {"error": "unknown request; known: status, stop, note"}
            self._replies.send_json(answer)

    def publish(self, status: Status) -> None:
        """Tell everybody who listens; nobody can slow it down."""
        self._news.send_json(status)

    def close(self) -> None:
        """Close the sockets and remove their files, which ZeroMQ leaves."""
        self._context.destroy(linger=100)
        for name in (_CONTROL, _STATUS):
            (self._folder / name).unlink(missing_ok=True)


class Watcher:
    """A client's subscription to the status of one recording."""

    def __init__(self, folder: Path) -> None:
        self._context = zmq.Context()
        self._news = self._context.socket(zmq.SUB)
        self._news.setsockopt(zmq.CONFLATE, 1)
        self._news.setsockopt(zmq.SUBSCRIBE, b"")
        self._news.connect(_address(folder / _STATUS))

    def next(self, timeout_s: float) -> Status | None:
        """Latest status, None when none came in time."""
        if not self._news.poll(round(timeout_s * 1000)):
            return None
        status: Status = json.loads(self._news.recv())
        return status

    def close(self) -> None:
        """End the subscription."""
        self._context.destroy(linger=0)


def request(folder: Path, command: str, timeout_s: float = 2.0, text: str = "") -> Status | None:
    """Ask a recorder something; None when it does not answer in time. `text` is what a ``note`` says."""
    context = zmq.Context()
    try:
        socket = context.socket(zmq.REQ)
        socket.connect(_address(folder / _CONTROL))
        socket.send_json({"command": command, "text": text})
        if not socket.poll(round(timeout_s * 1000)):
            return None
        answer: Status = json.loads(socket.recv())
        return answer
    finally:
        context.destroy(linger=0)


def _address(path: Path) -> str:
    if len(os.fsencode(path)) > zmq.IPC_PATH_MAX_LEN:
        raise AcquisitionError(
            f"the path of the control socket is too long: '{path}'",
            remedy="Set XDG_RUNTIME_DIR to a folder with a shorter path.",
        )
    return f"ipc://{path}"
