"""Parts: what makes a long run resumable, parallel and small in memory."""

from __future__ import annotations

import os
import signal
import tracemalloc
from functools import partial

import numpy as np
import pytest

from thermacq.errors import ReconstructionError
from thermacq.reconstruction.parts import PAIRS_PER_PART, PartsJob, make_parts, read_parts


def squares():
    return lambda members: {"value": np.array(list(members)) ** 2, "process": np.array([os.getpid()])}


def failing_from(first):
    def make(members):
        if members.start >= first:
            raise ReconstructionError("on purpose", kept="something")
        return {"value": np.array(list(members))}

    return make


def dying():
    def make(members):
        if members.start:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"value": np.zeros(1)}

    return make


def megabytes():
    return lambda members: {"value": np.zeros((len(members), 256, 256))}


def job_in(folder, pairs=40, make_worker=squares):
    return PartsJob("stage", pairs, folder / "parts", make_worker)


def silent(stage, done, total):
    pass


@pytest.mark.parametrize("workers", [1, 2])
def test_every_pair_is_worked_on_once_and_parts_come_back_in_order(tmp_path, workers):
    job, seen = job_in(tmp_path, pairs=43), []
    make_parts(job, workers, lambda *progress: seen.append(progress))
    values = [part["value"] for part in read_parts(job)]
    np.testing.assert_array_equal(np.concatenate(values), np.arange(43) ** 2)
    assert seen[0] == ("stage", 0, 43)
    assert seen[-1] == ("stage", 43, 43)
    assert not list(tmp_path.rglob("*.tmp"))


def test_work_is_spread_over_processes(tmp_path):
    job = job_in(tmp_path, pairs=80)
    make_parts(job, 2, silent)
    processes = {int(part["process"][0]) for part in read_parts(job)}
    assert os.getpid() not in processes


def test_what_is_there_is_not_made_again(tmp_path):
    job = job_in(tmp_path)
    with pytest.raises(ReconstructionError, match="on purpose"):
        make_parts(job_in(tmp_path, make_worker=partial(failing_from, 2 * PAIRS_PER_PART)), 1, silent)
    before = {path: path.stat().st_mtime_ns for path in job.folder.glob("*.npz")}
    assert len(before) == 2
    seen = []
    make_parts(job, 1, lambda *progress: seen.append(progress[1]))
    assert seen[0] == 2 * PAIRS_PER_PART
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert len(list(read_parts(job))) == job.parts


def test_an_error_in_a_worker_process_arrives_with_its_words(tmp_path):
    job = job_in(tmp_path, make_worker=partial(failing_from, PAIRS_PER_PART))
    with pytest.raises(ReconstructionError, match="on purpose") as caught:
        make_parts(job, 2, silent)
    assert caught.value.kept == "something"


def test_a_killed_worker_is_explained_and_finished_parts_are_kept(tmp_path):
    job = job_in(tmp_path, make_worker=dying)
    with pytest.raises(ReconstructionError, match="a worker process died") as caught:
        make_parts(job, 2, silent)
    assert "goes on where it stopped" in caught.value.remedy
    make_parts(job_in(tmp_path), 1, silent)
    assert len(list(read_parts(job))) == job.parts


def test_ctrl_c_leaves_finished_parts_and_no_process(tmp_path):
    job = job_in(tmp_path, pairs=400)

    def interrupt(stage, done, total):
        if done >= 3 * PAIRS_PER_PART:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_parts(job, 2, interrupt)
    kept = len(list(job.folder.glob("*.npz")))
    assert 3 <= kept < job.parts
    assert not list(job.folder.glob("*.tmp"))
    make_parts(job, 2, silent)
    values = np.concatenate([part["value"] for part in read_parts(job)])
    np.testing.assert_array_equal(values, np.arange(400) ** 2)


def test_a_damaged_part_is_named(tmp_path):
    job = job_in(tmp_path)
    make_parts(job, 1, silent)
    job.path(1).write_bytes(b"damaged")
    with pytest.raises(ReconstructionError, match=r"part-000001\.npz"):
        list(read_parts(job))


def test_a_folder_that_cannot_be_made_is_explained(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ReconstructionError, match="cannot be made"):
        make_parts(PartsJob("stage", 8, tmp_path / "file" / "parts", squares), 1, silent)


def test_memory_does_not_grow_with_the_run(tmp_path):
    """A part is 4 MiB; sixteen of them must not take more room than two."""
    peaks = []
    for pairs in (2 * PAIRS_PER_PART, 16 * PAIRS_PER_PART):
        job = PartsJob("stage", pairs, tmp_path / str(pairs), megabytes)
        tracemalloc.start()
        make_parts(job, 1, silent)
        for _ in read_parts(job):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]
