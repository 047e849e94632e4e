"""Views of the chessboard from folders, lists of files and runs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from thermacq.devices import FrameFlag
from thermacq.errors import ImportDataError, ReconstructionError, StoreError
from thermacq.reconstruction.views import (
    detect_views,
    open_views,
    read_picture,
    views_from_files,
    views_from_lists,
)
from thermacq.store import CameraStream, FrameRow, RunHeader, RunWriter
from thermacq_calibration import CameraCorrection, Detection, NoBoard


def touch(folder, *names):
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"")
    return folder


def named(views):
    return [(view.name, view.left is not None, view.right is not None) for view in views]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["left10.jpg", "right10.jpg", "left9.jpg", "right9.jpg"], ["9", "10"]),
        (["a_left_01.png", "a_right_01.png"], ["a__01"]),
        (["L-1.tif", "R-1.tif"], ["1"]),
        (["cal_l_7.PNG", "cal_r_7.PNG"], ["cal__7"]),
        (["bright_left.png", "bright_right.png"], ["bright"]),
    ],
)
def test_pictures_are_paired_by_the_rest_of_their_names(tmp_path, names, expected):
    with open_views([touch(tmp_path / "set", *names)]) as views:
        assert named(views) == [(name, True, True) for name in expected]


def test_a_missing_partner_is_kept_as_missing(tmp_path):
    with open_views([touch(tmp_path / "set", "left1.png", "left2.png", "right2.png")]) as views:
        assert named(views) == [("1", True, False), ("2", True, True)]


def test_pictures_that_name_no_side_are_views_of_one_camera(tmp_path):
    with open_views([touch(tmp_path / "set", "temp_10-55.png", "temp_10-56.png", "notes.txt")]) as views:
        assert named(views) == [("temp_10-55", True, False), ("temp_10-56", True, False)]


def test_subfolders_left_and_right(tmp_path):
    touch(tmp_path / "left", "1.png", "2.png")
    touch(tmp_path / "right", "1.png", "2.png")
    with open_views([tmp_path]) as views:
        assert named(views) == [("1", True, True), ("2", True, True)]


def test_lists_with_other_names_are_paired_in_order():
    left = [Path(f"cam0/{number}a.png") for number in (10, 9)]
    right = [Path(f"cam1/{number}b.png") for number in (9, 10)]
    assert [view.name for view in views_from_lists(left, right)] == ["9a | 9b", "10a | 10b"]


@pytest.mark.parametrize(("left", "right"), [(2, 3), (0, 2), (2, 0)])
def test_lists_that_cannot_be_paired_are_refused(left, right):
    with pytest.raises(ImportDataError, match=f"{left} left and {right} right"):
        views_from_lists([Path(f"a{n}.png") for n in range(left)], [Path(f"b{n}.png") for n in range(right)])


def test_two_pictures_of_one_view_and_side_are_refused():
    with pytest.raises(ImportDataError, match="both the left picture"):
        views_from_files([Path("left1.png"), Path("left1.jpg")])


def test_sources_that_are_nothing_are_refused(tmp_path):
    for sources, words in (
        ([tmp_path / "missing"], "no file or folder"),
        ([touch(tmp_path / "empty")], "no pictures"),
        ([tmp_path, tmp_path / "empty"], "several sources"),
    ):
        with pytest.raises(ImportDataError, match=words), open_views(sources):
            pass
    (tmp_path / "run.h5").write_bytes(b"not HDF5")
    with pytest.raises(StoreError), open_views([tmp_path / "run.h5"]):
        pass


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pictures_keep_their_depth(tmp_path, dtype):
    counts = np.arange(64 * 48).reshape(48, 64).astype(dtype)
    cv2.imwrite(str(tmp_path / "a.png"), counts)
    read = read_picture(tmp_path / "a.png")
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, counts)


@pytest.mark.parametrize("content", [b"", b"GIF?", b"\x89PNG\r\n\x1a\n\x00"])
def test_files_that_are_no_pictures_are_refused(tmp_path, content):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ImportDataError, match="no picture"):
        read_picture(tmp_path / "a.png")


def test_unreadable_pictures_and_missing_partners_become_reasons(tmp_path, small_pair):
    left, _ = small_pair.pictures(small_pair.poses(1)[0])
    cv2.imwrite(str(tmp_path / "left1.png"), left)
    (tmp_path / "right1.png").write_bytes(b"")
    cv2.imwrite(str(tmp_path / "left2.png"), left)
    with open_views([tmp_path]) as pictures:
        views, size = detect_views(pictures, small_pair.board)
    assert size == (320, 256)
    assert isinstance(views[0].left, Detection)
    assert isinstance(views[0].right, NoBoard)
    assert "no picture, or damaged" in views[0].right.reason
    assert views[1].problem == "right: there is no picture"


def test_cameras_of_different_size_are_refused(tmp_path, small_pair):
    cv2.imwrite(str(tmp_path / "left1.png"), np.zeros((256, 320), np.uint16))
    cv2.imwrite(str(tmp_path / "right1.png"), np.zeros((240, 320), np.uint16))
    with (
        open_views([tmp_path]) as views,
        pytest.raises(ImportDataError, match="left 320 x 256, right 320 x 240"),
    ):
        detect_views(views, small_pair.board)


def test_nothing_readable_is_refused(tmp_path, small_pair):
    with (
        open_views([touch(tmp_path / "set", "left1.png", "right1.png")]) as views,
        pytest.raises(ImportDataError, match="none of the pictures"),
    ):
        detect_views(views, small_pair.board)


@pytest.fixture
def board_run(tmp_path, small_pair):
    """Write a recording of a board: so many frames of each of the poses; returns its path."""

    def write(held, noise=6.0, cameras=("left", "right"), corrections=None):
        path = tmp_path / "board.h5"
        rig = {"cameras": {name: {"driver": "x"} for name in cameras}}
        header = RunHeader("1", "board", "2026-01-01T00:00:00+00:00", 0, 0, "virtual", True, rig)
        columns, rows = small_pair.truth.image_size
        streams = [CameraStream(name, rows, columns) for name in cameras]
        writer = RunWriter.create(path, header, streams, corrections=corrections)
        index = 0
        random = np.random.default_rng(2)
        for pose, count in zip(small_pair.poses(len(held), seed=1), held, strict=True):
            clean = small_pair.pictures(pose, noise=0.0)
            for _ in range(count):
                for name, picture in zip(cameras, clean, strict=False):
                    counts = np.rint(picture + random.normal(0, noise, picture.shape)).astype(np.uint16)
                    flags = FrameFlag.SHUTTER if index == 3 else FrameFlag.NONE
                    writer.append_frame(
                        name,
                        counts,
                        FrameRow(index, -1, index * 20_000_000, index, index * 20_000_000, int(flags)),
                    )
                index += 1
        writer.finish({}, "done")
        return path

    return write


def test_poses_of_a_recording_are_found_and_averaged(board_run, small_pair):
    path = board_run([9, 20, 6])
    with open_views([path]) as views:
        # The frame behind the shutter is no pair, so that numbers count pairs.
        assert [view.name for view in views] == ["0-7", "8-27", "28-33"]
        assert views[1].left is not None
        picture = views[1].left()
        found, size = detect_views(views, small_pair.board)
    assert size == (320, 256)
    flat = picture[:40, :40]
    assert flat.std() == pytest.approx(6 / np.sqrt(16), rel=0.1)
    truths = [small_pair.corners(pose) for pose in small_pair.poses(3, seed=1)]
    for view, truth in zip(found, truths, strict=True):
        for side, expected in zip((view.left, view.right), truth, strict=True):
            assert isinstance(side, Detection)
            assert np.median(np.linalg.norm(side.corners - expected, axis=1)) < 0.2


def test_frames_per_view_overrides_the_search(board_run):
    path = board_run([4, 4])
    with open_views([path], frames_per_view=3) as views:
        assert [view.name for view in views] == ["0-2", "3-5", "6-6"]


def test_views_of_a_run_are_corrected_as_the_run_says_unless_told_otherwise(board_run, small_pair):
    columns, rows = small_pair.truth.image_size
    ramp = np.linspace(0, 500, columns, dtype=np.float32) * np.ones((rows, 1), np.float32)
    none = np.zeros((rows, columns), np.uint8)
    right = CameraCorrection("", "right", np.ones_like(ramp), ramp, none)
    path = board_run([8], noise=0.5, corrections={"right": right})
    with open_views([path]) as views, open_views([path], correct=False) as raw:
        np.testing.assert_array_equal(views[0].left(), raw[0].left())
        np.testing.assert_allclose(views[0].right() - raw[0].right(), ramp, atol=1e-3)


def test_a_board_that_never_rests_is_explained(board_run):
    path = board_run([1] * 8)
    with (
        pytest.raises(ReconstructionError, match="never stands still") as caught,
        open_views([path]),
    ):
        pass
    assert "--frames-per-view" in caught.value.remedy


def test_a_recording_of_one_camera_is_refused(board_run):
    path = board_run([5], cameras=("left",))
    with pytest.raises(ReconstructionError, match="stereo needs two"), open_views([path]):
        pass
