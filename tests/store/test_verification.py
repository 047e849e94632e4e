from __future__ import annotations

import h5py
import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.store import (
    CameraStream,
    Event,
    EventKind,
    FrameRow,
    ProbeStream,
    RunWriter,
    open_run,
    verify,
)


def texts(report):
    return " | ".join(f"{finding.where}: {finding.what}" for finding in report.findings)


def break_chunk(path, camera, index):
    """Flip a byte in the middle of the stored chunk of a frame."""
    with h5py.File(path) as file:
        place = file[f"entry/instrument/{camera}/data"].id.get_chunk_info_by_coord((index, 0, 0))
    content = bytearray(path.read_bytes())
    content[place.byte_offset + place.size // 2] ^= 0x40
    path.write_bytes(content)


def write(path, header, rows, events=(), counter_bits=16):
    camera = CameraStream("left", 2, 3, capabilities={"counter_bits": counter_bits})
    with RunWriter.create(path, header, [camera]) as writer:
        for row in rows:
            writer.append_frame("left", np.zeros((2, 3), np.uint16), row)
        for event in events:
            writer.append_event(event)
        writer.finish({}, "")
    return path


def test_a_sound_run_has_no_findings(run_file):
    seen = []
    report = verify(run_file, lambda done, total: seen.append((done, total)))
    assert report.ok
    assert report.notes == []
    assert report.frames == {"left": 25, "right": 25}
    assert report.samples == {"gauge": 500}
    assert seen == [(number, 50) for number in range(1, 51)]


def test_a_damaged_frame_is_named(run_file):
    break_chunk(run_file, "right", 13)
    report = verify(run_file)
    assert texts(report) == "right: damaged frames: 13"
    with open_run(run_file) as run:
        run.counts("right", 12)


def test_many_damaged_frames_are_counted(run_file):
    for index in range(12):
        break_chunk(run_file, "left", index)
    assert "and 2 more" in texts(verify(run_file))


def test_damage_in_uncompressed_counts_is_found(create, append, tmp_path):
    with create(compression="none") as writer:
        append(writer, 0)
        writer.finish({}, "")
    break_chunk(tmp_path / "run.h5", "left", 0)
    assert texts(verify(tmp_path / "run.h5")) == "left: damaged frames: 0"


def test_a_gap_without_event_is_a_finding(header, tmp_path):
    path = write(tmp_path / "r.h5", header, [FrameRow(counter, -1, counter) for counter in (0, 1, 4, 5)])
    assert "frame counter: 2 missing in 1 gaps, and no event explains" in texts(verify(path))


def test_a_gap_with_an_event_is_a_note(header, tmp_path):
    rows = [FrameRow(counter, -1, counter) for counter in (0, 1, 4, 5)]
    path = write(tmp_path / "r.h5", header, rows, [Event(3, "left", EventKind.RING_FULL, 2)])
    report = verify(path)
    assert report.ok
    assert "2 missing" in report.notes[0].what


def test_the_event_of_another_device_explains_nothing(header, tmp_path):
    rows = [FrameRow(counter, -1, counter) for counter in (0, 3)]
    path = write(tmp_path / "r.h5", header, rows, [Event(3, "right", EventKind.RING_FULL, 2)])
    assert not verify(path).ok


def test_times_and_counters_that_go_back_are_findings(header, tmp_path):
    rows = [FrameRow(5, 10, 100, 0), FrameRow(5, 9, 90, 1)]
    found = texts(verify(write(tmp_path / "r.h5", header, rows)))
    assert "frame counter: stands still or goes back 1" in found
    assert "host times: go back 1" in found
    assert "device times: go back 1" in found


def test_an_unfinished_run_is_a_finding(create, append, tmp_path):
    writer = create()
    append(writer, 0)
    writer.close()
    report = verify(tmp_path / "run.h5")
    assert not report.complete
    assert "not closed" in texts(report)


def test_probe_gaps_and_values_that_are_no_numbers_are_findings(create, tmp_path):
    with create() as writer:
        writer.append_samples("gauge", np.ones((3, 2)), np.arange(3), 0, 0)
        writer.append_samples("gauge", np.full((1, 2), np.nan), np.array([9]), 9, 5)
        writer.finish({}, "")
    found = texts(verify(tmp_path / "run.h5"))
    assert "sample count: 6 missing" in found
    assert "2 values are not numbers" in found


def test_no_run_file(tmp_path):
    with pytest.raises(StoreError, match="there is no run file"):
        verify(tmp_path / "none.h5")


RESTARTED = 4


def rows_with_an_outage(flag=RESTARTED):
    """Ten frames, an outage, and ten frames with counter and ticks from the beginning."""
    rows = [FrameRow(n, 1000 + n, 10**9 + n * 10**7, trigger_index=n) for n in range(10)]
    return rows + [
        FrameRow(n, 1000 + n, 3 * 10**9 + n * 10**7, trigger_index=200 + n, flags=0 if n else flag)
        for n in range(10)
    ]


def test_a_restarted_camera_is_no_fault(header, tmp_path):
    back = Event(3 * 10**9 - 1, "left", EventKind.RECONNECTED, 200, "away 2 s")
    path = write(tmp_path / "run.h5", header, rows_with_an_outage(), [back])
    report = verify(path)
    assert report.findings == []
    assert [note.what for note in report.notes] == [
        "trigger index: 190 missing in 1 gaps; the recording explains losses by events"
    ]
    with open_run(path) as run:
        frames = run.frames("left")
        assert np.array_equal(frames.sequence_number, range(20))
        assert frames.restarts_ns.tolist() == [3 * 10**9]


def test_counters_that_go_back_for_no_reason_are_found(header, tmp_path):
    found = texts(verify(write(tmp_path / "run.h5", header, rows_with_an_outage(flag=0))))
    assert "frame counter: stands still or goes back 1 times" in found
    assert "device times: go back 1 times" in found


def test_a_restarted_probe_is_no_fault(header, tmp_path):
    probe = ProbeStream("wp", ("a",), "V", 1000.0)
    for told in (True, False):
        path = tmp_path / f"{told}.h5"
        with RunWriter.create(path, header, [CameraStream("left", 2, 3)], [probe]) as writer:
            values, ticks = np.zeros((10, 1)), np.arange(10)
            writer.append_samples("wp", values, ticks, 0, 10**9, pulse_ticks=[1, 5])
            if told:
                writer.append_event(Event(2 * 10**9, "wp", EventKind.RECONNECTED, 10, "away"))
            writer.append_samples("wp", values, ticks, 10, 2 * 10**9, pulse_ticks=[2, 6])
            writer.finish({}, "")
        found = texts(verify(path))
        assert (found == "") == told
        if not told:
            assert "device times: go back" in found
            assert "trigger pulse times: go back" in found
