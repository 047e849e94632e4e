"""Small runs whose every frame is known, for the tests of the store."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from thermacq.rig import StoreTable
from thermacq.store import (
    CameraStream,
    Event,
    EventKind,
    FrameRow,
    ProbeStream,
    RunHeader,
    RunWriter,
)

ROWS, COLUMNS = 12, 16
CAMERAS = [
    CameraStream(
        name, ROWS, COLUMNS, {"model": "M", "serial": name}, {}, {"bit_depth": 14, "counter_bits": 16}
    )
    for name in ("left", "right")
]
PROBE = ProbeStream("gauge", ("a", "b"), "V", 1000.0)
PERIOD_NS = 20_000_000


def known_counts(camera: str, index: int) -> NDArray[np.uint16]:
    """Frame that is known from its camera and index alone."""
    seed = [ord(camera[0]), index]
    return np.random.default_rng(seed).integers(0, 1 << 14, (ROWS, COLUMNS), np.uint16)


def known_row(index: int) -> FrameRow:
    """Index row of the same frame; the counter wraps at 16 bits."""
    host_ns = 1_000_000_000 + PERIOD_NS * index
    return FrameRow((65_530 + index) % 65_536, 7 * index, host_ns + 5_000, index, host_ns, 0, 300.0)


def append_known(writer: RunWriter, index: int) -> None:
    """One step of a known run: a frame of each camera, some samples, now and then an event."""
    for camera in CAMERAS:
        writer.append_frame(camera.name, known_counts(camera.name, index), known_row(index))
    ticks = np.arange(20 * index, 20 * index + 20)
    values = np.column_stack((ticks * 0.5, -ticks * 0.25))
    writer.append_samples("gauge", values, ticks, 20 * index, known_row(index).host_ns, [20 * index])
    if index % 10 == 3:
        writer.append_event(Event(known_row(index).host_ns, "left", EventKind.SHUTTER, index, "closed"))


@pytest.fixture
def header() -> RunHeader:
    return RunHeader(
        run_id="00000000-0000-4000-8000-000000000000",
        title="known run",
        start_time="2024-05-01T10:00:00+00:00",
        wall_anchor_ns=1_714_557_600_000_000_000,
        host_anchor_ns=1_000_000_000,
        clock="virtual",
        simulated=True,
        rig={
            "name": "test rig",
            "trigger": {"frame_rate_hz": 50.0},
            "cameras": {"left": {"driver": "x"}, "right": {"driver": "x"}},
        },
        calibration={"baseline_m": 0.06},
        versions={"thermacq": "0"},
    )


@pytest.fixture
def create(header: RunHeader, tmp_path: Path) -> Callable[..., RunWriter]:
    """Make a writer of a known run; by default at ``tmp_path/run.h5``."""

    def make(path: Path | None = None, compression: str = "lz4", reserve_mb: float = 0.0) -> RunWriter:
        settings = StoreTable.model_validate({"compression": compression, "reserve_mb": reserve_mb})
        return RunWriter.create(path or tmp_path / "run.h5", header, CAMERAS, [PROBE], settings)

    return make


@pytest.fixture
def append() -> Callable[[RunWriter, int], None]:
    return append_known


@pytest.fixture
def counts_of() -> Callable[[str, int], NDArray[np.uint16]]:
    return known_counts


@pytest.fixture
def run_file(create: Callable[..., RunWriter], tmp_path: Path) -> Path:
    """A complete known run of 25 frames per camera."""
    writer = create()
    for index in range(25):
        append_known(writer, index)
        if index % 7 == 6:
            writer.flush()
    writer.finish({"pairs": 25}, "as asked", "2024-05-01T10:00:01+00:00")
    return tmp_path / "run.h5"
