"""Two small cameras by formula, counts = 6000 + offset + 100 gain (T - 295 K) + noise, and runs of their pictures."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
import pytest

from thermacq.devices import FrameFlag
from thermacq.rig import Rig
from thermacq.store import CameraStream, FrameRow, RunHeader, RunWriter

ROWS, COLUMNS = 48, 64
PER_K = 100.0
NOISE = 3.5
DEAD = (20, 30)
START = "2026-01-02T03:04:05+00:00"


@dataclass
class Sensor:
    """One camera; its pattern follows from the seed."""

    seed: int
    gain: np.ndarray = field(init=False)
    offset: np.ndarray = field(init=False)

    def __post_init__(self):
        random = np.random.default_rng(self.seed)
        self.gain = 1 + 0.03 * random.standard_normal((ROWS, COLUMNS))
        self.offset = 150 * random.standard_normal((ROWS, COLUMNS))
        self.gain[DEAD] = 0.0

    def counts(self, temperature_k, number, noise=NOISE):
        """Raw counts of a uniform view, or of a picture of temperatures."""
        random = np.random.default_rng((self.seed, number))
        clean = 6000 + self.offset + PER_K * self.gain * (temperature_k - 295.0)
        return np.rint(clean + noise * random.standard_normal((ROWS, COLUMNS))).astype(np.uint16)


@pytest.fixture
def sensors():
    return {"left": Sensor(1), "right": Sensor(2)}


@pytest.fixture
def write_run(tmp_path, sensors):
    """Write a run: `pictures(camera, index)` or a temperature; further tables of the rig by keyword."""
    numbers = itertools.count()

    def write(
        shown,
        frames=32,
        *,
        serials=("SN1", "SN2"),
        flags=lambda _index: 0,
        corrections=None,
        inside_k=305.0,
        start_s=0.0,
        **tables,
    ):
        path = tmp_path / f"run{next(numbers)}.h5"
        cameras = [
            CameraStream(name, ROWS, COLUMNS, identity={"serial": serial})
            for name, serial in zip(sensors, serials, strict=True)
        ]
        rig = Rig.model_validate(
            {"cameras": {name: {"driver": "test-pattern"} for name in sensors}, **tables}
        )
        begin_ns = 1_767_323_045_000_000_000 + round(start_s * 1e9)
        header = RunHeader("id", "t", START, begin_ns, 0, "virtual", True, rig.model_dump(mode="json"))
        with RunWriter.create(path, header, cameras, corrections=corrections) as writer:
            for index in range(frames):
                for camera, sensor in sensors.items():
                    shown_now = shown(camera, index) if callable(shown) else shown
                    counts = shown_now
                    if np.ndim(shown_now) == 0 or np.asarray(shown_now).dtype.kind == "f":
                        counts = sensor.counts(shown_now, 1000 * int(start_s) + index)
                    row = FrameRow(
                        index,
                        -1,
                        20_000_000 * index,
                        trigger_index=index,
                        flags=int(flags(index)),
                        fpa_temperature_k=inside_k,
                    )
                    writer.append_frame(camera, counts, row)
            writer.finish({}, "done")
        return path

    return write


@pytest.fixture
def blackbody(write_run):
    """Runs of uniform views: the colder one, the warmer one, and one between them."""
    return {name: write_run(kelvin) for name, kelvin in (("cold", 290.0), ("hot", 300.0), ("check", 295.0))}


@pytest.fixture
def shutter_flag():
    return FrameFlag.SHUTTER
