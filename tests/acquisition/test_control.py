import json
import os
import threading
import time
from pathlib import Path

import pytest
import zmq

from thermacq.acquisition import control
from thermacq.errors import AcquisitionError


def test_the_runtime_folder_is_private(runtime_dir: Path) -> None:
    folder = control.runtime_folder()
    assert folder == runtime_dir / "thermacq"
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_folder_that_others_may_enter_is_refused(runtime_dir: Path) -> None:
    (runtime_dir / "thermacq").mkdir(mode=0o755)
    with pytest.raises(AcquisitionError, match="only you may enter"):
        control.runtime_folder()


def test_a_link_to_elsewhere_is_refused(runtime_dir: Path, tmp_path: Path) -> None:
    (runtime_dir / "thermacq").symlink_to(tmp_path)
    with pytest.raises(AcquisitionError, match="only you may enter"):
        control.runtime_folder()


def test_without_a_runtime_directory_the_user_has_one_in_tmp(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "missing"))
    monkeypatch.setattr(control.tempfile, "gettempdir", lambda: str(tmp_path))
    assert control.runtime_folder() == tmp_path / f"thermacq-{os.getuid()}"


def test_a_recorder_is_alive_while_it_holds_its_lock() -> None:
    folder = control.new_folder("run")
    assert not control.is_alive(folder)
    lock = control.hold_lock(folder)
    assert control.is_alive(folder)
    assert control.living_recordings() == [folder]
    os.close(lock)
    assert not control.is_alive(folder)


def test_folders_that_ended_long_ago_are_removed_and_living_ones_are_not() -> None:
    old, living = control.new_folder("old"), control.new_folder("living")
    lock = control.hold_lock(living)
    for folder in (old, living):
        os.utime(folder, (0, 0))
    control.new_folder("new")
    assert not old.exists()
    assert living.exists()
    os.close(lock)


@pytest.fixture
def desk():
    """A desk that is served by a thread."""
    folder = control.new_folder("desk")
    made = control.Desk(folder)
    done = threading.Event()

    def serve() -> None:
        while not done.is_set():
            made.serve(lambda: {"state": "recording"})
            done.wait(0.01)

    thread = threading.Thread(target=serve)
    thread.start()
    yield folder, made
    done.set()
    thread.join()
    made.close()


def test_status_and_stop(desk) -> None:
    folder, made = desk
    assert control.request(folder, "status") == {"state": "recording"}
    assert not made.stop_wanted
    assert control.request(folder, "stop") == {"state": "recording"}
    assert made.stop_wanted


def test_notes_are_kept_for_the_recorder_and_not_without_end(desk) -> None:
    folder, made = desk
    assert control.request(folder, "note", text="the lamp is on") == {"state": "recording"}
    assert made.notes == ["the lamp is on"]
    assert not made.stop_wanted
    for _ in range(120):
        control.request(folder, "note", text="again")
    assert len(made.notes) == 100


def test_a_closed_desk_leaves_no_sockets() -> None:
    folder = control.new_folder("desk")
    made = control.Desk(folder)
    assert {item.name for item in folder.iterdir()} == {"control", "status"}
    made.close()
    assert list(folder.iterdir()) == []


def test_a_watcher_gets_the_latest_status() -> None:
    folder = control.new_folder("desk")
    made, watcher = control.Desk(folder), control.Watcher(folder)
    number = 0
    while watcher.next(0.05) is None:
        made.publish({"number": number})
        number += 1
        assert number < 200
    for number in (500, 501, 502):
        made.publish({"number": number})
    deadline_s = time.monotonic() + 10
    while (status := watcher.next(1.0)) != {"number": 502}:
        assert time.monotonic() < deadline_s, status
    watcher.close()
    made.close()


@pytest.mark.parametrize("junk", [b"", b"\xff\xfe", b"[]", b"3", b'{"command": "dance"}', b"{" * 10_000])
def test_a_malformed_request_is_answered_and_harms_nothing(desk, junk: bytes) -> None:
    folder, made = desk
    context = zmq.Context()
    socket = context.socket(zmq.REQ)
    socket.connect(f"ipc://{folder / 'control'}")
    socket.send(junk)
    assert socket.poll(5000)
    assert "unknown request" in json.loads(socket.recv())["error"]
    context.destroy(linger=0)
    assert control.request(folder, "status") == {"state": "recording"}
    assert not made.stop_wanted


def test_nobody_answers() -> None:
    assert control.request(control.new_folder("dead"), "status", timeout_s=0.05) is None


def test_a_client_that_dies_after_asking_harms_nobody(desk) -> None:
    folder, _ = desk
    context = zmq.Context()
    socket = context.socket(zmq.REQ)
    socket.connect(f"ipc://{folder / 'control'}")
    socket.send_json({"command": "status"})
    context.destroy(linger=100)
    assert control.request(folder, "status") == {"state": "recording"}


def test_a_path_too_long_for_a_socket_is_explained(tmp_path: Path) -> None:
    folder = tmp_path / ("x" * 120)
    folder.mkdir()
    with pytest.raises(AcquisitionError, match="too long"):
        control.request(folder, "status")
