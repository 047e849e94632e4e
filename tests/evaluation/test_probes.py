from __future__ import annotations

import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.evaluation.probes import probe_record, still_level
from thermacq.store import CameraStream, FrameRow, ProbeStream, RunHeader, RunWriter, open_run

HOST_ANCHOR_NS = 5_000_000_000
TICK_RATE_HZ = 1e6
DRIFT = 50e-6
PERIOD_S = 0.8


def elevation(time_s):
    return 0.03 * np.sin(2 * np.pi * time_s / PERIOD_S)


@pytest.fixture
def make_run(tmp_path):
    """A run of 8 s with one probe: 0.02 m per volt, zero at 1.5 V, a clock that is 50 ppm fast."""

    def make(*, zero_raw=None, tick_rate_hz=TICK_RATE_HZ, pulses=True, channel="", samples=800, lost=0):
        rig = {
            "cameras": {"left": {"driver": "x"}, "right": {"driver": "x"}},
            "probes": {
                "P1": {
                    "driver": "y",
                    "x_m": 0.25,
                    "y_m": 0.1,
                    "coefficient_m_per_unit": 0.02,
                    "coefficient_u_rel": 0.0044,
                    "channel": channel,
                }
                | ({} if zero_raw is None else {"zero_raw": zero_raw})
            },
        }
        header = RunHeader("id", "t", "2026-01-01T00:00:00Z", 0, HOST_ANCHOR_NS, "real", False, rig)
        path = tmp_path / "run.h5"
        streams = [CameraStream(name, 4, 4) for name in ("left", "right")]
        with RunWriter.create(
            path, header, streams, [ProbeStream("P1", ("a", "b"), "V", tick_rate_hz)]
        ) as writer:
            frame_s = np.arange(0, 8, 0.02)
            for index, moment in enumerate(frame_s):
                fired = HOST_ANCHOR_NS + round(moment * 1e9)
                for name in ("left", "right"):
                    row = FrameRow(index, -1, fired + 5_000_000, trigger_index=index, trigger_ns=fired)
                    writer.append_frame(name, np.zeros((4, 4), np.uint16), row)
            time_s = np.arange(samples) * 0.01
            ticks = np.rint((time_s * (1 + DRIFT) + 123.0) * TICK_RATE_HZ).astype(np.int64)
            pulse_ticks = np.rint((frame_s * (1 + DRIFT) + 123.0) * TICK_RATE_HZ).astype(np.int64)
            values = np.stack([1.5 + elevation(time_s) / 0.02, np.zeros_like(time_s)], axis=1)
            for start in range(0, samples, 20):
                block = slice(start, min(start + 20, samples))
                received = HOST_ANCHOR_NS + round(time_s[block][-1] * 1e9) + 2_000_000
                chosen = pulse_ticks[(pulse_ticks >= ticks[block][0]) & (pulse_ticks <= ticks[block][-1])]
                first = start + (lost if start >= 400 else 0)
                writer.append_samples(
                    "P1", values[block], ticks[block], first, received, chosen if pulses else ()
                )
            writer.finish({}, "frames")
        return path

    return make


def test_pulses_put_the_probe_on_the_cameras_time(make_run):
    with open_run(make_run(zero_raw=1.5)) as run:
        found = probe_record(run, "P1")
    assert found.clock.method == "pulses"
    assert found.clock.drift_ppm == pytest.approx(50, abs=1)
    assert found.time_s == pytest.approx(np.arange(800) * 0.01, abs=3e-6)
    assert found.eta_m == pytest.approx(elevation(found.time_s), abs=1e-5)
    assert (found.x_m, found.y_m, found.zero_source, found.lost_samples) == (0.25, 0.1, "rig", 0)
    assert found.coefficient_u_rel == 0.0044


def test_without_pulses_receipt_times_must_do(make_run):
    with open_run(make_run(zero_raw=1.5, pulses=False)) as run:
        found = probe_record(run, "P1")
    assert found.clock.method == "envelope"
    # The shortest delay of receipt, 2 ms here, cannot be told from the clock's offset.
    assert found.time_s == pytest.approx(np.arange(800) * 0.01 + 0.002, abs=1e-4)


def test_a_probe_without_a_clock_is_taken_to_sample_evenly(make_run):
    with open_run(make_run(zero_raw=1.5, tick_rate_hz=0.0)) as run:
        found = probe_record(run, "P1")
    assert np.diff(found.time_s) == pytest.approx(np.full(799, 0.01), rel=2e-3)


def test_zero_from_the_whole_waves_of_the_record(make_run):
    with open_run(make_run(samples=700)) as run:
        found = probe_record(run, "P1")
    assert found.zero_raw == pytest.approx(1.5, abs=0.01)
    assert found.zero_source == "mean over the whole waves of the record"
    assert abs(found.eta_m.mean()) > 2e-4


def test_zero_of_a_record_without_waves():
    assert still_level(np.arange(5.0), np.array([1.0, 2, 3, 4, 5])) == (3.0, "mean of the record")


def test_lost_samples_are_counted(make_run):
    with open_run(make_run(zero_raw=1.5, lost=7)) as run:
        assert probe_record(run, "P1").lost_samples == 7


def test_unusable_probes_are_refused(make_run, tmp_path):
    with open_run(make_run(channel="c", samples=40)) as run:
        with pytest.raises(StoreError, match="channel 'c' of probe 'P1', which has a, b"):
            probe_record(run, "P1")
        with pytest.raises(StoreError, match="no probe 'P9'"):
            probe_record(run, "P9")
    (tmp_path / "run.h5").unlink()
    with open_run(make_run(samples=2)) as run, pytest.raises(StoreError, match="2 samples: too few"):
        probe_record(run, "P1")
