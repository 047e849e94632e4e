from __future__ import annotations

import os
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.store import CameraStream, Event, EventKind, FrameRow, ProbeStream, RunWriter, open_run, verify


@pytest.mark.parametrize("compression", ["lz4", "zstd", "none"])
def test_everything_written_is_read_back(create, append, counts_of, tmp_path, compression):
    with create(compression=compression) as writer:
        for index in range(12):
            append(writer, index)
        writer.finish({"pairs": 12}, "as asked", "2024-05-01T10:00:01+00:00")
    with open_run(tmp_path / "run.h5") as run:
        assert run.complete
        assert run.compression == compression
        assert run.cameras == ("left", "right")
        assert run.probes == ("gauge",)
        assert run.summary() == {"pairs": 12}
        assert run.end_reason == "as asked"
        assert run.calibration() == {"baseline_m": 0.06}
        assert run.rig.name == "test rig"
        for camera in run.cameras:
            assert run.frame_count(camera) == 12
            for index in range(12):
                np.testing.assert_array_equal(run.counts(camera, index), counts_of(camera, index))
        frames = run.frames("left")
        np.testing.assert_array_equal(frames.counter, [*range(65_530, 65_536), *range(6)])
        np.testing.assert_array_equal(frames.sequence_number, np.arange(65_530, 65_542))
        np.testing.assert_array_equal(frames.trigger_ns, 1_000_000_000 + 20_000_000 * np.arange(12))
        samples = run.probe("gauge")
        np.testing.assert_array_equal(samples.values[:, 0], 0.5 * np.arange(240))
        np.testing.assert_array_equal(samples.index, np.arange(240))
        np.testing.assert_array_equal(samples.pulse_ticks, 20 * np.arange(12))
        assert [event.index for event in run.events()] == [3]


def test_header_survives(run_file, header):
    with open_run(run_file) as run:
        assert run.header == header


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_any_hdf5_reader_with_the_blosc_filter_reads_the_counts(
    create, append, counts_of, tmp_path, compression
):
    with create(compression=compression) as writer:
        append(writer, 0)
        writer.finish({}, "")
    assert hdf5plugin.get_filters()
    with h5py.File(tmp_path / "run.h5") as file:
        np.testing.assert_array_equal(file["entry/left/data"][0], counts_of("left", 0))


def test_nothing_is_promised_before_flush_and_everything_after(create, append, tmp_path):
    writer = create()
    append(writer, 0)
    with open_run(tmp_path / "run.h5") as run:
        assert run.frame_count("left") == 0
    writer.flush()
    assert writer.committed("left") == 1
    with open_run(tmp_path / "run.h5") as run:
        assert run.frame_count("left") == 1
        assert not run.complete
        assert run.summary() is None
    append(writer, 1)
    writer.close()
    with open_run(tmp_path / "run.h5") as run:
        assert run.frame_count("right") == 2
        assert not run.complete


def test_frames_without_counter_are_numbered_by_row(header, tmp_path):
    with RunWriter.create(tmp_path / "r.h5", header, [CameraStream("left", 2, 2)]) as writer:
        for _ in range(3):
            writer.append_frame("left", np.zeros((2, 2), np.uint16), FrameRow(-1, -1, 0))
    with open_run(tmp_path / "r.h5") as run:
        np.testing.assert_array_equal(run.frames("left").sequence_number, [0, 1, 2])


def test_long_event_details_are_cut_between_characters(create, tmp_path):
    with create() as writer:
        writer.append_event(Event(1, "left", EventKind.NOTE, detail="a" + "é" * 300))
    with open_run(tmp_path / "run.h5") as run:
        assert run.events()[0].detail == "a" + "é" * 99


def test_large_summary_loses_its_long_lists_and_says_so(create, tmp_path):
    with create() as writer:
        writer.finish({"skew_ns": {"p50": 61.0, "each": list(range(100_000))}, "pairs": 3}, "")
    with open_run(tmp_path / "run.h5") as run:
        summary = run.summary()
    assert summary["pairs"] == 3
    assert summary["skew_ns"]["p50"] == 61.0
    assert "100000 entries were left out" in summary["skew_ns"]["each"]


def test_monstrous_summary_is_replaced_by_a_note(create, tmp_path):
    with create() as writer:
        writer.finish({f"key {number}": "x" * 100 for number in range(5_000)}, "")
    with open_run(tmp_path / "run.h5") as run:
        assert run.summary() == {"note": "the summary was too large to be stored"}


def test_existing_file_is_not_touched(create, tmp_path):
    path = tmp_path / "run.h5"
    path.write_text("precious")
    with pytest.raises(StoreError, match="exists already"):
        create()
    assert path.read_text() == "precious"


def test_missing_folder_is_named(create, tmp_path):
    with pytest.raises(StoreError, match="there is no folder"):
        create(tmp_path / "nowhere" / "run.h5")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write to read-only folders")
def test_read_only_folder_gives_a_clear_error(create, tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    with pytest.raises(StoreError, match="cannot be created"):
        create(folder / "run.h5")


def test_folder_that_cannot_be_written_to_gives_a_clear_error(create):
    with pytest.raises(StoreError, match="cannot be created") as caught:
        create(Path("/proc/run.h5"))
    assert "folder" in caught.value.remedy


@pytest.mark.parametrize("name", ["", "a/b", "events", "..", "left camera", "x" * 65])
def test_unfit_device_names_are_refused(header, tmp_path, name):
    with pytest.raises(StoreError, match="cannot be stored"):
        RunWriter.create(tmp_path / "r.h5", header, [CameraStream(name, 2, 2)])
    assert not (tmp_path / "r.h5").exists()


def test_doubled_device_names_are_refused(header, tmp_path):
    with pytest.raises(StoreError, match="same name"):
        RunWriter.create(
            tmp_path / "r.h5", header, [CameraStream("a", 2, 2)], [ProbeStream("a", ("c",), "V", 0.0)]
        )


def test_garbage_from_a_probe_is_refused_and_the_run_goes_on(create, append, tmp_path):
    with create() as writer:
        with pytest.raises(StoreError, match="gauge"):
            writer.append_samples("gauge", np.zeros((3, 5)), np.arange(3), 0, 0)
        append(writer, 0)
        writer.finish({}, "")
    assert verify(tmp_path / "run.h5").ok


def test_a_closed_writer_refuses(create, append):
    writer = create()
    writer.close()
    writer.close()
    with pytest.raises(StoreError, match="closed"):
        append(writer, 0)


def test_probe_without_clock_takes_host_times(header, tmp_path):
    with RunWriter.create(tmp_path / "r.h5", header, [], [ProbeStream("p", ("c",), "V", 0.0)]) as writer:
        writer.append_samples("p", np.ones((2, 1)), np.full(2, -1), 0, 3_500_000_000)
    with h5py.File(tmp_path / "r.h5") as file:
        np.testing.assert_array_equal(file["entry/p/time"], [2.5, 2.5])
