"""How many frames a second the run file takes, against bare h5py writing the same chunks."""

from __future__ import annotations

import tempfile
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from thermacq.store import CameraStream, FrameRow, RunHeader, RunWriter, encode_frame, frame_crc32, open_run

ROWS, COLUMNS = 512, 640
FRAMES = 400
FRAMES_PER_FLUSH = 50  # every 0.25 s at 2 x 100 frames/s
REPEATS = 3
BASELINE = "bare h5py, same chunks written directly"


def run() -> list[dict[str, Any]]:
    """Rows of (name, value, unit, baseline, ratio); the best of some repeats, in the page cache."""
    counts = _thermal_picture()
    chunk = encode_frame(counts, "lz4")
    bare = _best(lambda folder: _bare_chunks(folder, chunk))
    ways: dict[str, Callable[[Path], float]] = {
        "run file, compressed beforehand": lambda folder: _run_file(folder, counts, chunk),
        "run file, compressed in the writer's thread": lambda folder: _run_file(folder, counts, None),
        "bare h5py, filter inside HDF5": lambda folder: _bare_assignment(folder, counts, compressed=True),
        "bare h5py, plain assignment, uncompressed": lambda folder: _bare_assignment(
            folder, counts, compressed=False
        ),
    }
    rows = [_row(BASELINE, bare, bare)]
    rows += [_row(name, _best(way), bare) for name, way in ways.items()]
    rows.append(_row("reading the run file", _best(lambda folder: _reading(folder, counts, chunk)), bare))
    rows.append(
        {
            "name": "store: size of a compressed frame",
            "value": len(chunk),
            "unit": "bytes",
            "baseline": "raw counts",
            "ratio": len(chunk) / counts.nbytes,
        }
    )
    return rows


def _row(name: str, value: float, baseline: float) -> dict[str, Any]:
    return {
        "name": f"store: {name}",
        "value": value,
        "unit": "frames/s",
        "baseline": BASELINE,
        "ratio": value / baseline,
    }


def _thermal_picture() -> NDArray[np.uint16]:
    """Smooth water with noise of some counts, as a cooled or averaged LWIR camera sees it."""
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    water = 22_000 + 200 * np.sin(row / 37) * np.cos(column / 53)
    return (water + np.random.default_rng(1).normal(0, 8, (ROWS, COLUMNS))).astype(np.uint16)


def _best(way: Callable[[Path], float]) -> float:
    """Highest frames/s of some repeats, each in a folder of its own."""
    found = []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            found.append(way(Path(folder)))
    return max(found)


def _bare_chunks(folder: Path, chunk: bytes) -> float:
    with h5py.File(folder / "bare.h5", "w", libver=("v110", "v110")) as file:
        data = _dataset(file, compressed=True)
        start = time.perf_counter()
        for index in range(FRAMES):
            data.resize(index + 1, axis=0)
            data.id.write_direct_chunk((index, 0, 0), chunk)
        file.flush()
        return FRAMES / (time.perf_counter() - start)


def _bare_assignment(folder: Path, counts: NDArray[np.uint16], *, compressed: bool) -> float:
    with h5py.File(folder / "bare.h5", "w", libver=("v110", "v110")) as file:
        data = _dataset(file, compressed=compressed)
        start = time.perf_counter()
        for index in range(FRAMES):
            data.resize(index + 1, axis=0)
            data[index] = counts
        file.flush()
        return FRAMES / (time.perf_counter() - start)


def _dataset(file: h5py.File, *, compressed: bool) -> h5py.Dataset:
    filters = hdf5plugin.Blosc("lz4", 5, hdf5plugin.Blosc.BITSHUFFLE) if compressed else {}
    return file.create_dataset(
        "data",
        (0, ROWS, COLUMNS),
        np.uint16,
        maxshape=(None, ROWS, COLUMNS),
        chunks=(1, ROWS, COLUMNS),
        **filters,
    )


def _run_file(folder: Path, counts: NDArray[np.uint16], chunk: bytes | None) -> float:
    """Frames/s of a run writer that commits as often as a recording does."""
    checksum = frame_crc32(counts)
    with _writer(folder) as writer:
        start = time.perf_counter()
        for index in range(FRAMES):
            row = FrameRow(index, index, index, index, index)
            if chunk is None:
                writer.append_frame("left", counts, row)
            else:
                writer.append_encoded("left", chunk, row, checksum)
            if index % FRAMES_PER_FLUSH == FRAMES_PER_FLUSH - 1:
                writer.flush()
        writer.flush()
        return FRAMES / (time.perf_counter() - start)


def _reading(folder: Path, counts: NDArray[np.uint16], chunk: bytes) -> float:
    _run_file(folder, counts, chunk)
    with open_run(folder / "run.h5") as opened:
        start = time.perf_counter()
        for index in range(FRAMES):
            opened.counts("left", index)
        return FRAMES / (time.perf_counter() - start)


def _writer(folder: Path) -> RunWriter:
    header = RunHeader(
        run_id=str(uuid.uuid4()),
        title="benchmark",
        start_time="2024-01-01T00:00:00Z",
        wall_anchor_ns=0,
        host_anchor_ns=0,
        clock="virtual",
        simulated=True,
        rig={"name": "benchmark", "cameras": {}},
    )
    return RunWriter.create(folder / "run.h5", header, [CameraStream("left", ROWS, COLUMNS)])
