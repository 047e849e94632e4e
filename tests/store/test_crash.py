"""The writer is killed at random moments: no committed frame may be lost."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.store import open_run, recover, verify

KILLS = 60

# Forks a writer per trial, so that only the first pays for the imports. The writer tells over a pipe how
# many frames it has committed; its parent kills it some time later and tells the last number that it got.
TRIALS = """
import json, os, random, signal, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import conftest as known
import h5py, hdf5plugin, numcodecs
from thermacq.rig import StoreTable
from thermacq.store import RunHeader, RunWriter

def write(path, seed, pipe):
    chance = random.Random(seed)
    header = RunHeader("i", "t", "2024-05-01T10:00:00Z", 0, 0, "virtual", True, {"cameras": {}})
    compression = chance.choice(["lz4", "zstd", "none"])
    settings = StoreTable(compression=compression)
    writer = RunWriter.create(path, header, known.CAMERAS, [known.PROBE], settings)
    for index in range(1_000_000):
        known.append_known(writer, index)
        if chance.random() < 0.3:
            writer.flush()
            os.write(pipe, (index + 1).to_bytes(8, "little"))

for trial in range(int(sys.argv[3])):
    seed = int(sys.argv[4]) + trial
    chance = random.Random(seed)
    path = Path(sys.argv[2]) / f"{seed}.h5"
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(ours)
        write(path, seed, theirs)
    os.close(theirs)
    time.sleep(chance.uniform(0.0, 0.25))
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    told = b""
    while part := os.read(ours, 65536):
        told += part
    os.close(ours)
    whole = len(told) // 8 * 8
    promised = int.from_bytes(told[whole - 8 : whole], "little") if whole else 0
    print(json.dumps([seed, promised, os.WTERMSIG(status)]), flush=True)
"""

WRITE_ON = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import conftest as known
from thermacq.store import RunHeader, RunWriter

header = RunHeader("i", "t", "2024-05-01T10:00:00Z", 0, 0, "virtual", True, {"cameras": {}})
writer = RunWriter.create(Path(sys.argv[2]), header, known.CAMERAS, [known.PROBE])
for index in range(1_000_000):
    known.append_known(writer, index)
    writer.flush()
    if index == 0:
        print("begun", flush=True)
"""


@pytest.mark.slow
def test_no_committed_frame_is_lost(tmp_path, counts_of):
    first_seed = random.SystemRandom().randrange(10**9)
    print(f"seeds {first_seed} to {first_seed + KILLS - 1}")
    arguments = [str(Path(__file__).parent), str(tmp_path), str(KILLS), str(first_seed)]
    trials = subprocess.run(
        [sys.executable, "-c", TRIALS, *arguments], capture_output=True, text=True, timeout=280, check=True
    )
    outcomes = [json.loads(line) for line in trials.stdout.splitlines()]
    assert len(outcomes) == KILLS
    with_frames = 0
    for seed, promised, killed_by in outcomes:
        assert killed_by == signal.SIGKILL
        path = tmp_path / f"{seed}.h5"
        try:
            run = open_run(path)
        except StoreError:
            assert promised == 0, f"seed {seed}: {promised} frames were promised, the file does not open"
            continue
        with run:
            for camera in run.cameras:
                found = run.frame_count(camera)
                assert found >= promised, f"seed {seed}: {found} of {promised} promised frames"
                np.testing.assert_array_equal(run.frames(camera).trigger_index, np.arange(found))
                for index in range(found):
                    np.testing.assert_array_equal(run.counts(camera, index), counts_of(camera, index))
            frames = {camera: run.frame_count(camera) for camera in run.cameras}
        with_frames += promised > 0
        report = recover(path, tmp_path / "clean.h5")
        assert not report.was_complete
        assert report.frames == frames
        assert report.damaged == {"left": [], "right": []}
        assert verify(tmp_path / "clean.h5").ok
        (tmp_path / "clean.h5").unlink()
    assert with_frames >= 0.6 * KILLS, "too few writers lived long enough for the test to mean something"


@pytest.mark.slow
def test_a_run_can_be_read_while_it_is_written(tmp_path, counts_of):
    """Readers open the file again and again beside a writer, and never see anything half done."""
    path = tmp_path / "run.h5"
    arguments = [sys.executable, "-c", WRITE_ON, str(Path(__file__).parent), str(path)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout.readline() == "begun\n"
        seen = [0]
        for _ in range(60):
            with open_run(path) as run:
                frames = run.frame_count("left")
                np.testing.assert_array_equal(run.frames("left").trigger_index, np.arange(frames))
                for index in range(seen[-1], frames):
                    np.testing.assert_array_equal(run.counts("left", index), counts_of("left", index))
                run.probe("gauge")
                run.events()
                seen.append(frames)
        writer.kill()
    assert seen == sorted(seen)
    assert seen[-1] > seen[1] > 0
