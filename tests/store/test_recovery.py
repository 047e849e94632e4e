from __future__ import annotations

import h5py
import numpy as np
import pytest

from thermacq.errors import StoreError
from thermacq.store import CameraStream, FrameRow, RunWriter, open_run, recover, verify


@pytest.fixture
def cut_short(create, append, tmp_path):
    """A run of 9 committed frames and 2 uncommitted ones, whose writer never came back."""
    writer = create()
    for index in range(9):
        append(writer, index)
    writer.flush()
    path = tmp_path / "cut.h5"
    for index in (9, 10):
        append(writer, index)
    writer._file.flush()  # the chunks reach the disk, the count does not
    path.write_bytes((tmp_path / "run.h5").read_bytes())
    writer.close()
    return path


def test_committed_frames_are_saved_and_the_rest_is_stated(cut_short, tmp_path, counts_of, header):
    before = cut_short.read_bytes()
    report = recover(cut_short, tmp_path / "clean.h5")
    assert cut_short.read_bytes() == before
    assert not report.was_complete
    assert report.frames == {"left": 9, "right": 9}
    assert report.samples == {"gauge": 180}
    assert report.uncommitted == {"left": 2, "right": 2}
    assert report.lost == 4
    assert verify(tmp_path / "clean.h5").ok
    with open_run(tmp_path / "clean.h5") as run, open_run(cut_short) as original:
        assert run.complete
        assert run.header == header
        assert run.summary()["recovered"]["uncommitted"] == {"left": 2, "right": 2}
        assert run.end_time == "2024-05-01T10:00:00.160005+00:00"
        assert run.events() == original.events()
        for name, column in vars(original.frames("left")).items():
            np.testing.assert_array_equal(getattr(run.frames("left"), name), column)
        for name in ("values", "ticks", "index", "host_ns", "pulse_ticks"):
            np.testing.assert_array_equal(
                getattr(run.probe("gauge"), name), getattr(original.probe("gauge"), name)
            )
        np.testing.assert_array_equal(run.counts("right", 8), counts_of("right", 8))


def test_a_damaged_frame_becomes_a_stated_gap(run_file, tmp_path, counts_of):
    with h5py.File(run_file) as file:
        place = file["entry/instrument/left/data"].id.get_chunk_info_by_coord((4, 0, 0))
    content = bytearray(run_file.read_bytes())
    content[place.byte_offset + 40] ^= 0xFF
    run_file.write_bytes(content)
    report = recover(run_file, tmp_path / "clean.h5")
    assert report.damaged == {"left": [4], "right": []}
    with open_run(tmp_path / "clean.h5") as run:
        np.testing.assert_array_equal(np.diff(run.frames("left").sequence_number)[2:5], [1, 2, 1])
        np.testing.assert_array_equal(run.counts("left", 4), counts_of("left", 5))
        assert run.summary()["pairs"] == 25
        assert run.summary()["recovered"]["damaged"] == {"left": [4], "right": []}


def test_a_sound_run_is_copied_whole(run_file, tmp_path):
    report = recover(run_file, tmp_path / "copy.h5")
    assert report.was_complete
    assert report.lost == 0
    with open_run(run_file) as run, open_run(tmp_path / "copy.h5") as copy:
        assert (copy.summary(), copy.end_reason, copy.end_time) == (
            run.summary(),
            run.end_reason,
            run.end_time,
        )


def test_output_is_never_overwritten(run_file, tmp_path):
    (tmp_path / "clean.h5").write_text("precious")
    with pytest.raises(StoreError, match="exists already"):
        recover(run_file, tmp_path / "clean.h5")
    assert (tmp_path / "clean.h5").read_text() == "precious"


def test_a_failing_disk_leaves_no_half_output(run_file, tmp_path, monkeypatch):
    from thermacq.store import operations

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(operations, "write_chunk", full)
    with pytest.raises(StoreError, match="no space is left") as caught:
        recover(run_file, tmp_path / "clean.h5")
    assert "is untouched" in caught.value.kept
    assert not (tmp_path / "clean.h5").exists()


def test_a_restart_is_kept_when_its_first_frame_is_damaged(header, tmp_path):
    path = tmp_path / "run.h5"
    camera = CameraStream("left", 2, 3, capabilities={"counter_bits": 16})
    with RunWriter.create(path, header, [camera]) as writer:
        for host_ns in range(20):
            row = FrameRow(host_ns % 10, host_ns % 10, host_ns, flags=4 if host_ns == 10 else 0)
            writer.append_frame("left", np.zeros((2, 3), np.uint16), row)
        writer.finish({}, "")
    with h5py.File(path) as file:
        place = file["entry/instrument/left/data"].id.get_chunk_info_by_coord((10, 0, 0))
    content = bytearray(path.read_bytes())
    content[place.byte_offset + place.size // 2] ^= 0x40
    path.write_bytes(content)
    recover(path, tmp_path / "clean.h5")
    with open_run(tmp_path / "clean.h5") as run:
        frames = run.frames("left")
        assert frames.restarts_ns.tolist() == [11]
        assert np.array_equal(np.diff(frames.sequence_number), np.ones(18))
