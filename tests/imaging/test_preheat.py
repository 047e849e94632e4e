"""The preheat monitor on run files: what it reads, while they grow and afterwards."""

from __future__ import annotations

import json

import numpy as np
import pytest

from thermacq.devices import FrameFlag
from thermacq.errors import StoreError
from thermacq.imaging.preheat import PreheatMonitor, override_of
from thermacq.imaging.preheat_drawing import save_warm_up
from thermacq.rig import Rig
from thermacq.store import CameraStream, Event, EventKind, FrameRow, RunHeader, RunWriter, open_run
from thermacq_calibration.infrared.preheat import Grade, PreheatLimits

LIMITS = PreheatLimits(minimum_s=600.0)
SCALE = 100.0


class Recording:
    """Writes a run of two small cameras, minute by minute; the shutter closes each minute for a second.

    The drift is that of a picture, K/min; it is taken away by each closing.
    """

    def __init__(self, path, rate_hz=2.0, drift=0.0, fpa=0.0, shows_shutter=False, has_shutter=True):
        self.rate_hz, self.drift, self.fpa, self.shows_shutter = rate_hz, drift, fpa, shows_shutter
        self.random = np.random.default_rng(1)
        self.index = 0
        self.last = np.full((6, 8), 6000, np.uint16)
        cameras = [
            CameraStream(name, 6, 8, capabilities={"has_shutter": has_shutter}) for name in ("left", "right")
        ]
        rig = Rig.model_validate(
            {"cameras": {name: {"driver": "test-pattern"} for name in ("left", "right")}}
        )
        header = RunHeader(
            "id", "t", "2026-01-01T00:00:00+00:00", 0, 10**9, "virtual", True, rig.model_dump(mode="json")
        )
        self.writer = RunWriter.create(path, header, cameras)

    def go_on(self, minutes):
        for _ in range(round(60 * minutes * self.rate_hz)):
            time_s = self.index / self.rate_hz
            is_closed = time_s % 60 < 1
            level = 6000 + SCALE * self.drift / 60 * (time_s if self.shows_shutter else time_s % 60)
            if not is_closed or self.shows_shutter:
                view = level if is_closed or not self.shows_shutter else 9000 + 500 * np.sin(time_s)
                self.last = np.rint(view + self.random.normal(0, 5, (6, 8))).astype(np.uint16)
            row = FrameRow(
                self.index,
                -1,
                10**9 + round(time_s * 1e9),
                flags=int(FrameFlag.SHUTTER) if is_closed else 0,
                fpa_temperature_k=300 + self.fpa / 60 * time_s + self.random.normal(0, 0.005),
            )
            for name in ("left", "right"):
                self.writer.append_frame(name, self.last, row)
            self.index += 1
        self.writer.flush()


@pytest.fixture
def record(tmp_path):
    writers = []

    def make(minutes, **how):
        path = tmp_path / f"run{len(writers)}.h5"
        recording = Recording(path, **how)
        writers.append(recording.writer)
        recording.go_on(minutes)
        return path, recording

    yield make
    for writer in writers:
        writer.close()


def test_a_growing_run_is_judged_again_and_again(record) -> None:
    path, recording = record(4)
    monitor = PreheatMonitor(path, SCALE, limits=LIMITS)
    early = monitor.update()
    assert not early.is_go
    assert early.time_s == pytest.approx(240, abs=1)
    assert {one.grade for one in early.cameras["left"].criteria} == {Grade.FAIL}
    recording.go_on(7)
    late = monitor.update()
    assert late.is_go
    assert late.ready_in_s == 0
    assert late.verdict == "left go; right go"
    assert late.temperatures_k["left"] == pytest.approx(300, abs=0.03)
    assert PreheatMonitor(path, SCALE, limits=LIMITS).update().cameras == late.cameras
    json.dumps(late.facts(), allow_nan=False)
    json.dumps(early.facts(), allow_nan=False)


def test_the_camera_that_warms_up_is_named(record, tmp_path) -> None:
    path, _ = record(11, fpa=0.1, drift=0.05)
    monitor = PreheatMonitor(path, SCALE, limits=LIMITS)
    found = monitor.update()
    assert not found.is_go
    assert found.verdict == "left no-go: fpa, drift; right no-go: fpa, drift"
    assert found.cameras["left"].fpa.value == pytest.approx(0.1, abs=0.005)
    assert found.cameras["left"].drift.value == pytest.approx(0.05, abs=0.01)
    assert found.facts()["ready_in_s"] is None
    save_warm_up(monitor, found, tmp_path / "warm.png")
    assert (tmp_path / "warm.png").stat().st_size > 20_000


def test_a_shutter_that_shows_itself_is_told_from_one_that_freezes(record) -> None:
    path, _ = record(11, drift=0.05, shows_shutter=True)
    monitor = PreheatMonitor(path, SCALE, limits=LIMITS)
    found = monitor.update().cameras["left"].drift
    assert not monitor.warm_up("left").frozen
    assert "on the shutter" in found.note
    assert found.value == pytest.approx(0.05, abs=0.01)
    path, _ = record(2)
    monitor = PreheatMonitor(path, SCALE)
    monitor.update()
    assert monitor.warm_up("left").frozen


def test_fast_recordings_are_thinned_and_slow_ones_are_sparse(record) -> None:
    path, _ = record(2, rate_hz=20.0)
    monitor = PreheatMonitor(path)
    monitor.update()
    seen = monitor.warm_up("right")
    assert 100 < len(seen.time_s) < 140
    assert seen.closed.sum() >= 2
    assert not seen.is_sparse
    path, _ = record(2, rate_hz=0.25)
    monitor = PreheatMonitor(path)
    monitor.update()
    assert monitor.warm_up("right").is_sparse


def test_what_is_not_known_is_not_judged(record) -> None:
    path, _ = record(11)
    assert PreheatMonitor(path, limits=LIMITS).update().cameras["left"].drift.grade is Grade.UNKNOWN
    path, _ = record(0, has_shutter=False)
    assert PreheatMonitor(path).update() is None
    with pytest.raises(StoreError, match="no run file"):
        PreheatMonitor(path.with_name("none.h5")).update()


def test_an_override_is_read_from_the_events(record) -> None:
    path, recording = record(1)
    with open_run(path) as run:
        assert override_of(run) == ""
    for detail in ("something else", "preheat override: in a hurry"):
        recording.writer.append_event(Event(10**9, "operator", EventKind.NOTE, -1, detail))
    recording.writer.flush()
    found = PreheatMonitor(path).update()
    assert found.override == "in a hurry"
    assert found.is_go
    assert not found.is_ready
