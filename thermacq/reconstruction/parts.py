"""Many pairs on all cores: parts of a run, each a file of its own, so that work can stop and go on.

A part is a few consecutive pairs. Spawned worker processes make parts and rename each into place when it
is complete; the parent only counts them. So memory does not grow with the run, a second call skips what
is there, and the folder's name is a hash of the run and of every setting: other settings, other folder.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError

PAIRS_PER_PART = 8

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the name of a stage, the pairs done and the pairs in all."""

PartMaker: TypeAlias = Callable[[range], dict[str, NDArray[Any]]]
"""Makes the arrays of one part from the indices of its pairs."""


@dataclass(frozen=True)
class PartsJob:
    """Work on the pairs of a run, cut into parts.

    Parameters
    ----------
    stage
        Name for the progress display.
    pairs
        Number of pairs.
    folder
        Where the parts go.
    make_worker
        Makes the function that makes parts, in each process once; travels there by pickling, so a
        `functools.partial` of a function of a module.
    """

    stage: str
    pairs: int
    folder: Path
    make_worker: Callable[[], PartMaker]

    @property
    def parts(self) -> int:
        """Number of parts."""
        return -(-self.pairs // PAIRS_PER_PART)

    def members(self, part: int) -> range:
        """Indices of the pairs of a part."""
        return range(part * PAIRS_PER_PART, min((part + 1) * PAIRS_PER_PART, self.pairs))

    def path(self, part: int) -> Path:
        """File of a part."""
        return self.folder / f"part-{part:06d}.npz"


def make_parts(job: PartsJob, workers: int, progress: Progress) -> None:
    """Make every part that is not there yet.

    Parameters
    ----------
    job
        The work.
    workers
        Number of worker processes; 1 works in this process.
    progress
        Told after every part.

    Raises
    ------
    ReconstructionError
        The folder cannot be written, or a worker died.
    """
    try:
        job.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ReconstructionError(f"'{job.folder}' cannot be made: {error.strerror}") from None
    missing = [part for part in range(job.parts) if not job.path(part).is_file()]
    done = job.pairs - sum(len(job.members(part)) for part in missing)
    progress(job.stage, done, job.pairs)
    for part in _finished(job, missing, workers):
        done += len(job.members(part))
        progress(job.stage, done, job.pairs)


def read_parts(job: PartsJob) -> Iterator[dict[str, NDArray[Any]]]:
    """Arrays of all parts in order, one part in memory at a time."""
    for part in range(job.parts):
        path = job.path(part)
        try:
            with np.load(path, allow_pickle=False) as arrays:
                yield dict(arrays)
        except Exception as error:
            raise ReconstructionError(
                f"the part '{path}' is damaged: {error}", remedy="Delete it and run the same command again."
            ) from None


def _finished(job: PartsJob, missing: list[int], workers: int) -> Iterator[int]:
    """Parts in the order in which they get ready."""
    if workers == 1 or len(missing) < 2:
        make = job.make_worker()
        for part in missing:
            yield _make_part(job, part, make)
        return
    yield from _finished_by_processes(job, missing, min(workers, len(missing)))


def _finished_by_processes(job: PartsJob, missing: list[int], workers: int) -> Iterator[int]:
    """At most two parts for each worker are on their way, so that nothing piles up."""
    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(job,),
    )
    waiting = iter(missing)
    running: set[Future[int]] = set()
    try:
        with _inherited_by_workers():
            running |= {pool.submit(_make_part_in_worker, part) for part in _take(waiting, 2 * workers)}
        while running:
            ready, running = wait(running, return_when=FIRST_COMPLETED)
            running |= {pool.submit(_make_part_in_worker, part) for part in _take(waiting, len(ready))}
            yield from (future.result() for future in ready)
    except BrokenProcessPool:
        raise ReconstructionError(
            "a worker process died, perhaps for want of memory",
            kept=f"The parts that were ready are kept in '{job.folder}'.",
            remedy="Run the same command again, with fewer --workers; it goes on where it stopped.",
        ) from None
    finally:
        # Parts being made are finished and kept, also after Ctrl-C.
        pool.shutdown(wait=True, cancel_futures=True)


def _take(waiting: Iterator[int], count: int) -> list[int]:
    return list(itertools.islice(waiting, count))


@contextlib.contextmanager
def _inherited_by_workers() -> Iterator[None]:
    """Processes started inside use one thread for linear algebra, and never see Ctrl-C.

    There is a process for each core already; and each shall finish the part at hand.
    """
    variable, in_main_thread = "OPENBLAS_NUM_THREADS", threading.current_thread() is threading.main_thread()
    threads = os.environ.get(variable)
    os.environ[variable] = "1"
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if in_main_thread else None
    try:
        yield
    finally:
        if in_main_thread:
            signal.signal(signal.SIGINT, before)
        os.environ.pop(variable)
        if threads is not None:
            os.environ[variable] = threads


def _make_part(job: PartsJob, part: int, make: PartMaker) -> int:
    """Make one part; it appears under its name only when it is complete."""
    arrays = make(job.members(part))
    path = job.path(part)
    unfinished = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        with unfinished.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        unfinished.replace(path)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise ReconstructionError(
            f"'{path}' cannot be written: {error.strerror}",
            kept=f"The parts that were ready are kept in '{job.folder}'.",
            remedy="Make room and run the same command again; it goes on where it stopped.",
        ) from None
    return part


class _Worker:
    """State of a worker process: the job, and its part maker once the first part was asked for."""

    job: PartsJob
    make: PartMaker | None = None


def _start_worker(job: PartsJob) -> None:
    import cv2

    # One thread per process: the processes already use all cores.
    cv2.setNumThreads(1)
    _Worker.job = job


def _make_part_in_worker(part: int) -> int:
    if _Worker.make is None:
        _Worker.make = _Worker.job.make_worker()
    return _make_part(_Worker.job, part, _Worker.make)
