"""The whole way from two cameras to the run file: whether it keeps up, and how fast it can go.

Two test-pattern cameras, 640 x 512 uint16, bit-shuffled LZ4. First at 200 frames/s each in real time, where
anything that cannot keep up is lost and counted; then in virtual time, where a full ring makes time wait, so
that the wall clock tells the throughput. Three baselines: bare h5py writing the very chunks of that run, which
were compressed beforehand; bare h5py compressing them on the way; and the processor's limit, compressing the
same pictures on all cores without writing anything.
"""

from __future__ import annotations

import os
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from thermacq.acquisition import RecordingResult, record
from thermacq.rig import Rig
from thermacq.store.codec import encode_frame, filter_options, frame_crc32

RATE_HZ = 200.0
SECONDS = 60.0
THROUGHPUT_FRAMES = 3000
CHUNKS = 64
CAMERA = {"driver": "test-pattern"}


def run() -> list[dict[str, Any]]:
    """Rows of the benchmark."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = _real_time(folder / "real.h5")
        path = folder / "virtual.h5"
        rate = _virtual_time(path)
        pictures = _pictures(path)
        for baseline, bare in (
            ("bare h5py, same chunks written directly", _bare_direct(folder / "a.h5", pictures)),
            ("bare h5py, same filter inside HDF5", _bare_filter(folder / "b.h5", pictures)),
            ("compressing alone, all cores, nothing else done", _compressing(pictures)),
        ):
            rows.append({"name": baseline, "value": bare, "unit": "frames/s"})
            rows.append(
                {
                    "name": "whole pipeline, both cameras",
                    "value": rate,
                    "unit": "frames/s",
                    "baseline": baseline,
                    "ratio": rate / bare,
                }
            )
    return rows


def _rig(clock: str) -> Rig:
    return Rig.model_validate(
        {
            "name": "pipeline",
            "clock": {"kind": clock},
            "trigger": {"mode": "free_run", "frame_rate_hz": RATE_HZ},
            "cameras": {"left": CAMERA, "right": CAMERA},
        }
    )


def _real_time(path: Path) -> list[dict[str, Any]]:
    fullest = 0.0

    def note(status: dict[str, Any]) -> None:
        nonlocal fullest
        fills = [device.get("ring_fill", 0.0) for device in status["devices"].values()]
        fullest = max(fullest, *fills) if fills else fullest

    result = record(_rig("real"), path, duration_s=SECONDS, on_status=note)
    wanted = 2 * RATE_HZ * SECONDS
    path.unlink()
    written, lost = _counts(result)
    baseline = f"{wanted:.0f} asked for in {SECONDS:.0f} s"
    return [
        {
            "name": "real time: frames written",
            "value": written,
            "unit": "frames",
            "baseline": baseline,
            "ratio": written / wanted,
        },
        {"name": "real time: frames lost", "value": lost, "unit": "frames"},
        {"name": "real time: fullest ring seen", "value": 100 * fullest, "unit": "%"},
        {
            "name": "real time: slowest write",
            "value": 1e3 * result.summary["writer"]["write_s"],
            "unit": "ms",
        },
    ]


def _counts(result: RecordingResult) -> tuple[int, int]:
    devices = result.summary["sync"]["devices"].values()
    return sum(device["written"] for device in devices), sum(
        sum(device["lost"].values()) for device in devices
    )


def _virtual_time(path: Path) -> float:
    """Frames written per second of wall clock, both cameras together, start and end left out."""
    marks: list[tuple[float, int]] = []

    def note(status: dict[str, Any]) -> None:
        if status["state"] == "recording":
            written = sum(device["written"] for device in status["devices"].values())
            marks.append((time.perf_counter(), written))

    record(_rig("virtual"), path, frames=THROUGHPUT_FRAMES, on_status=note)
    (began, first), (ended, last) = marks[1], marks[-1]
    return (last - first) / (ended - began)


def _pictures(path: Path) -> list[np.ndarray[Any, Any]]:
    from thermacq.store import open_run

    with open_run(path) as recorded:
        return [recorded.counts("left", index) for index in range(CHUNKS)]


def _dataset(file: h5py.File, pictures: list[np.ndarray[Any, Any]]) -> h5py.Dataset:
    shape = pictures[0].shape
    return file.create_dataset(
        "data",
        (0, *shape),
        np.uint16,
        maxshape=(None, *shape),
        chunks=(1, *shape),
        **filter_options("lz4"),
    )


def _bare_direct(path: Path, pictures: list[np.ndarray[Any, Any]]) -> float:
    encoded = [encode_frame(picture, "lz4") for picture in pictures]
    frames = 2 * THROUGHPUT_FRAMES
    began = time.perf_counter()
    with h5py.File(path, "w") as file:
        data = _dataset(file, pictures)
        for index in range(frames):
            data.resize(index + 1, axis=0)
            data.id.write_direct_chunk((index, 0, 0), encoded[index % CHUNKS])
    rate = frames / (time.perf_counter() - began)
    path.unlink()
    return rate


def _compressing(pictures: list[np.ndarray[Any, Any]]) -> float:
    """The writer's work on a picture, checksum included, in as many threads as there are cores."""

    def work(index: int) -> None:
        picture = pictures[index % CHUNKS]
        encode_frame(picture, "lz4")
        frame_crc32(picture)

    frames = 2 * THROUGHPUT_FRAMES
    with ThreadPoolExecutor(os.cpu_count() or 1) as threads:
        began = time.perf_counter()
        for _ in threads.map(work, range(frames)):
            pass
        return frames / (time.perf_counter() - began)


def _bare_filter(path: Path, pictures: list[np.ndarray[Any, Any]]) -> float:
    frames = THROUGHPUT_FRAMES // 3
    began = time.perf_counter()
    with h5py.File(path, "w") as file:
        data = _dataset(file, pictures)
        for index in range(frames):
            data.resize(index + 1, axis=0)
            data[index] = pictures[index % CHUNKS]
    rate = frames / (time.perf_counter() - began)
    path.unlink()
    return rate
