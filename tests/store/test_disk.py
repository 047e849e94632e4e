"""Full and failing disks: what was committed stays, and the message says so."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.store import check_room, open_run, operations, recover
from thermacq.store.disk import Ballast, free_bytes

OPERATIONS = ("write_chunk", "write_rows", "write_value", "flush_file")


def read_all(path, counts_of):
    """Number of committed frames per camera, after each was compared with the truth."""
    with open_run(path) as run:
        found = {camera: run.frame_count(camera) for camera in run.cameras}
        for camera, frames in found.items():
            rows = run.frames(camera)
            np.testing.assert_array_equal(rows.trigger_index, np.arange(frames))
            for index in range(frames):
                np.testing.assert_array_equal(run.counts(camera, index), counts_of(camera, index))
        run.probe("gauge")
        run.events()
    return found


def record(writer, append, steps=12):
    """Write a short run and finish it; return what was promised before an error, and the error."""
    promised = {"left": 0, "right": 0}
    try:
        for index in range(steps):
            append(writer, index)
            if index % 3 == 2:
                writer.flush()
                promised = {camera: writer.committed(camera) for camera in promised}
        writer.finish({}, "as asked")
    except StoreError as error:
        return promised, error
    return {"left": steps, "right": steps}, None


class Failing:
    """Makes the n-th write of a run fail, and all later ones when the fault is to stay."""

    def __init__(self, monkeypatch, nth, stays, error):
        self.writes = 0
        for name in OPERATIONS:
            monkeypatch.setattr(operations, name, self.wrap(getattr(operations, name), nth, stays, error))

    def wrap(self, write, nth, stays, error):
        def wrapped(*arguments):
            self.writes += 1
            if self.writes == nth or (stays and self.writes > nth):
                raise error
            return write(*arguments)

        return wrapped


FULL = OSError(28, "No space left on device")
HIDDEN = RuntimeError("Can't decrement id ref count (file write failed: errno = 28, error message = ...)")


@pytest.mark.parametrize("stays", [False, True], ids=["once", "for good"])
@pytest.mark.parametrize("error", [FULL, HIDDEN], ids=["OSError", "RuntimeError"])
def test_any_write_may_fail(create, append, counts_of, tmp_path, monkeypatch, error, stays):
    with monkeypatch.context() as patch:
        total = Failing(patch, 0, False, error)
        record(create(tmp_path / "whole.h5"), append)
    assert total.writes > 100
    for nth in range(1, total.writes + 1, 7):
        path = tmp_path / f"{nth}.h5"
        writer = create(path)
        with monkeypatch.context() as patch:
            Failing(patch, nth, stays, error)
            promised, raised = record(writer, append)
            writer.close()
        assert raised is not None
        assert "no space is left on the disk" in raised.what
        assert "committed is safe" in raised.kept
        assert f"left {writer.committed('left')}" in raised.kept
        found = read_all(path, counts_of)
        assert found == {camera: writer.committed(camera) for camera in found}
        assert all(found[camera] >= promised[camera] for camera in promised)
        path.unlink()


def test_a_failed_writer_stays_failed(create, append, monkeypatch):
    writer = create()
    with monkeypatch.context() as patch:
        Failing(patch, 1, False, FULL)
        with pytest.raises(StoreError, match="no space"):
            append(writer, 0)
    for call in (writer.flush, lambda: append(writer, 1), lambda: writer.finish({}, "")):
        with pytest.raises(StoreError, match="no space"):
            call()
    writer.close()


WRITER = """
import json, os, resource, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import conftest as known
from thermacq.errors import StoreError
from thermacq.rig import StoreTable
from thermacq.store import RunHeader, RunWriter

header = RunHeader("i", "t", "2024-05-01T10:00:00Z", 0, 0, "virtual", True, {"cameras": {}})
writer = RunWriter.create(Path(sys.argv[2]), header, known.CAMERAS, [known.PROBE], StoreTable())
if len(sys.argv) > 3:  # a limit of the file size fails inside HDF5, in the middle of any write
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limit = os.path.getsize(sys.argv[2]) + int(sys.argv[3])
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    for index in range(200_000):
        known.append_known(writer, index)
        if index % 5 == 4:
            writer.flush()
            print(index + 1, flush=True)
except StoreError as error:
    print("error:", error.what.replace(chr(10), " "), "|", error.kept, flush=True)
writer.close()
print("closed", flush=True)
"""


def run_writer(path, *limit):
    """Write in a child until the disk refuses; return the promised frames, its message, and if it got past close."""
    arguments = [sys.executable, "-c", WRITER, str(Path(__file__).parent), str(path), *map(str, limit)]
    child = subprocess.run(arguments, capture_output=True, text=True, timeout=280, check=False)
    lines = child.stdout.split("\n")
    promised = max((int(line) for line in lines if line.isdigit()), default=0)
    message = next((line for line in lines if line.startswith("error:")), child.stderr)
    print(path.name, "promised", promised, "status", child.returncode)
    return promised, message, "closed" in lines


@pytest.mark.slow
def test_a_write_error_inside_hdf5(tmp_path, counts_of):
    """The library itself fails at any byte; the child may crash at its end, the file may not suffer."""
    some_frames = 0
    for limit in (1, 50_000, 200_001, 400_000, 600_000, 777_777, 1_000_000, 1_234_567):
        path = tmp_path / f"{limit}.h5"
        promised, message, said_goodbye = run_writer(path, limit)
        assert "failed" in message
        assert "committed is safe" in message
        assert said_goodbye
        found = read_all(path, counts_of)
        assert min(found.values()) >= promised
        some_frames += promised > 0
    assert some_frames >= 3


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 7 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    if os.geteuid() != 0:
        pytest.skip("only root may mount a small file system")
    mount = ["mount", "-t", "tmpfs", "-o", "size=7m", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small file system is not permitted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_disk_that_is_really_full(small_disk, tmp_path, counts_of):
    promised, message, _ = run_writer(small_disk / "run.h5")
    assert promised > 50
    assert "no space is left on the disk" in message
    assert "committed is safe" in message
    found = read_all(small_disk / "run.h5", counts_of)
    assert min(found.values()) >= promised
    report = recover(small_disk / "run.h5", tmp_path / "clean.h5")
    assert report.frames == found


def test_a_disk_too_full_to_begin(small_disk, create):
    (small_disk / "junk").write_bytes(bytes(4_000_000))
    with pytest.raises(StoreError, match="no space is left on the disk"):
        create(small_disk / "run.h5")
    assert not (small_disk / "run.h5").exists()


def test_reserve_watermark(create, append, tmp_path):
    roomy = create(tmp_path / "roomy.h5", reserve_mb=0.0)
    assert not roomy.disk_reserve_reached
    roomy.close()
    free_mb = free_bytes(tmp_path / "x") / 1e6
    tight = create(tmp_path / "tight.h5", reserve_mb=free_mb + 1000)
    assert tight.disk_reserve_reached
    append(tight, 0)
    tight.finish({}, "disk reserve reached")
    with open_run(tmp_path / "tight.h5") as run:
        assert run.complete
        assert run.frame_count("left") == 1


def test_a_run_that_will_not_fit_is_refused(tmp_path):
    free = free_bytes(tmp_path / "run.h5")
    check_room(tmp_path / "run.h5", free // 4, free // 4)
    with pytest.raises(StoreError, match="will not fit") as caught:
        check_room(tmp_path / "run.h5", free // 2, free)
    assert "record for a shorter time" in caught.value.remedy
    with pytest.raises(StoreError, match="there is no folder"):
        check_room(tmp_path / "nowhere" / "run.h5", 1, 1)


def test_ballast_takes_room_and_gives_it_back(small_disk):
    free = free_bytes(small_disk / "x")
    ballast = Ballast(small_disk, 3_000_000)
    assert free_bytes(small_disk / "x") <= free - 3_000_000
    assert list(small_disk.iterdir()) == []
    ballast.release()
    ballast.release()
    assert free_bytes(small_disk / "x") == free
