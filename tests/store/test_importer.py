from __future__ import annotations

import cv2
import numpy as np
import pytest

from thermacq.errors import ImportDataError, StoreError
from thermacq.store import open_run, verify
from thermacq.store.importer import import_pictures, read_timestamps


def picture(camera, index, depth=16, rows=6, columns=8):
    dtype, top = (np.uint8, 256) if depth == 8 else (np.uint16, 65_536)
    return np.random.default_rng([ord(camera[0]), index]).integers(0, top, (rows, columns), dtype)


def fill(tmp_path, suffix, depth=16, frames=12, **size):
    """Folders left and right of known pictures, numbered without leading zeros."""
    for camera in ("left", "right"):
        folder = tmp_path / camera
        folder.mkdir()
        for index in range(frames):
            path = folder / f"frame{index}{suffix}"
            if suffix == ".npy":
                np.save(path, picture(camera, index, depth, **size))
            else:
                cv2.imwrite(str(path), picture(camera, index, depth, **size))
    return str(tmp_path / "left"), str(tmp_path / "right")


def do(tmp_path, left, right, **options):
    return import_pictures(left, right, tmp_path / "run.h5", **({"rate_hz": 50.0} | options))


def refuses(tmp_path, left, right, match, **options):
    with pytest.raises(ImportDataError, match=match):
        do(tmp_path, left, right, **options)
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff", ".npy"])
@pytest.mark.parametrize("depth", [8, 16])
def test_pictures_become_a_run_bit_for_bit(tmp_path, suffix, depth):
    report = do(tmp_path, *fill(tmp_path, suffix, depth))
    assert (report.frames, report.rows, report.columns, report.bit_depth) == (12, 6, 8, depth)
    assert verify(tmp_path / "run.h5").ok
    with open_run(tmp_path / "run.h5") as run:
        assert run.cameras == ("left", "right")
        assert run.complete
        assert run.header.clock == "real"
        assert not run.header.simulated
        assert run.rig.cameras["left"].driver == "imported"
        assert run.camera("left").capabilities["bit_depth"] == depth
        for camera in run.cameras:
            frames = run.frames(camera)
            np.testing.assert_array_equal(frames.host_ns, np.arange(12) * 20_000_000)
            np.testing.assert_array_equal(frames.trigger_index, np.arange(12))
            for index in range(12):
                np.testing.assert_array_equal(run.counts(camera, index), picture(camera, index, depth))


def test_patterns_take_both_cameras_from_one_folder(tmp_path):
    for camera in ("left", "right"):
        for index in range(11):
            cv2.imwrite(str(tmp_path / f"{camera}{index}.png"), picture(camera, index))
    do(tmp_path, str(tmp_path / "left*.png"), str(tmp_path / "right*.png"))
    with open_run(tmp_path / "run.h5") as run:
        np.testing.assert_array_equal(run.counts("left", 10), picture("left", 10))
        np.testing.assert_array_equal(run.counts("right", 2), picture("right", 2))


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".tif"])
def test_stacks_in_one_file(tmp_path, suffix):
    for camera in ("left", "right"):
        stack = np.stack([picture(camera, index) for index in range(5)])
        path = tmp_path / f"{camera}{suffix}"
        if suffix == ".npy":
            np.save(path, stack)
        elif suffix == ".npz":
            np.savez(path, frames=stack)
        else:
            cv2.imwritemulti(str(path), list(stack))
    report = do(tmp_path, str(tmp_path / f"left{suffix}"), str(tmp_path / f"right{suffix}"))
    assert report.frames == 5
    with open_run(tmp_path / "run.h5") as run:
        np.testing.assert_array_equal(run.counts("right", 4), picture("right", 4))


def test_videos_bring_their_own_rate(tmp_path):
    values = {"left": 40, "right": 200}
    for camera, value in values.items():
        writer = cv2.VideoWriter(
            str(tmp_path / f"{camera}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (32, 16)
        )
        assert writer.isOpened()
        for index in range(7):
            writer.write(np.full((16, 32, 3), value + 3 * index, np.uint8))
        writer.release()
    report = do(tmp_path, str(tmp_path / "left.avi"), str(tmp_path / "right.avi"), rate_hz=None)
    assert (report.frames, report.frame_rate_hz) == (7, 25.0)
    with open_run(tmp_path / "run.h5") as run:
        for camera, value in values.items():
            assert abs(float(run.counts(camera, 6).mean()) - (value + 18)) < 3


def test_equal_colours_are_kept_and_others_become_luminance(tmp_path):
    gray = picture("left", 0, 8)
    cv2.imwrite(str(tmp_path / "left.png"), cv2.merge([gray, gray, gray, np.full_like(gray, 9)]))
    colours = np.zeros((6, 8, 3), np.uint8)
    colours[..., 2] = 100  # red, in OpenCV's order
    cv2.imwrite(str(tmp_path / "right.png"), colours)
    report = do(tmp_path, str(tmp_path / "left.png"), str(tmp_path / "right.png"), rate_hz=None)
    assert "left: the alpha channel was dropped" in report.notes
    assert any(note.startswith("right: colours were turned to gray") for note in report.notes)
    with open_run(tmp_path / "run.h5") as run:
        np.testing.assert_array_equal(run.counts("left", 0), gray)
        np.testing.assert_array_equal(run.counts("right", 0), round(0.299 * 100))
        assert {event.detail for event in run.events()} == set(report.notes)


@pytest.mark.parametrize(
    "text",
    ["10.5\n10.52\n10.6\n", "# seconds\n\n10.5\n10.52\n10.6", "frame,time_s\n1,10.5\n2,10.52\n3,10.6\n",
     "time;x\n10.5;1\n10.52;1\n10.6;1\n", "10.5 a\n10.52 b\n10.6 c\n", "\ufefftime\r\n10.5\r\n10.52\r\n10.6\r\n"],
)  # fmt: skip
def test_time_stamps_are_exact(tmp_path, text):
    (tmp_path / "times.csv").write_text(text, encoding="utf-8")
    left, right = fill(tmp_path, ".png", frames=3)
    do(tmp_path, left, right, rate_hz=None, timestamps=tmp_path / "times.csv")
    with open_run(tmp_path / "run.h5") as run:
        np.testing.assert_array_equal(
            run.frames("left").host_ns, [10_500_000_000, 10_520_000_000, 10_600_000_000]
        )
        assert run.header.host_anchor_ns == 10_500_000_000


def test_unix_times_keep_their_nanoseconds(tmp_path):
    (tmp_path / "t.txt").write_text("1714557600.123456789\n1714557600.143456789\n")
    assert read_timestamps(tmp_path / "t.txt") == (1_714_557_600_123_456_789, 1_714_557_600_143_456_789)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "no time stamps"),
        ("# nothing\n", "no time stamps"),
        ("1\n2\n2\n", r"line 3: the time is not later"),
        ("1\n0.5\n3\n", r"line 2: the time is not later"),
        ("1\nx\n3\n", r"line 2: 'x' has no time"),
        ("a.png,1\nb.png,2\n", r"line 1: 'a.png,1' has no time"),
        ("1\nnan\n3\n", r"line 2"),
        ("1\ninf\n", r"line 2"),
        ("1\n1e40\n", r"line 2"),
        ("time,x\n1,2\n\n,3\n", r"line 4"),
        ("1\n2\n", "2 time stamps for at least 3 pairs"),
        ("1\n2\n3\n4\n", "4 time stamps for 3 pairs"),
    ],
)
def test_bad_time_stamps(tmp_path, text, match):
    (tmp_path / "times.csv").write_text(text)
    left, right = fill(tmp_path, ".png", frames=3)
    refuses(tmp_path, left, right, match, rate_hz=None, timestamps=tmp_path / "times.csv")


def test_time_stamps_that_cannot_be_read(tmp_path):
    left, right = fill(tmp_path, ".png", frames=1)
    refuses(tmp_path, left, right, "cannot be read", rate_hz=None, timestamps=tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x81")
    refuses(tmp_path, left, right, "cannot be read", rate_hz=None, timestamps=tmp_path / "binary.csv")


def test_times_must_be_said_once(tmp_path):
    left, right = fill(tmp_path, ".png", frames=2)
    (tmp_path / "t").write_text("1\n2\n")
    refuses(tmp_path, left, right, "nothing says when", rate_hz=None)
    refuses(tmp_path, left, right, "both a rate and time stamps", timestamps=tmp_path / "t")
    for rate_hz in (0.0, -1.0, float("nan"), 1e9):
        refuses(tmp_path, left, right, "impossible", rate_hz=rate_hz)


def test_nothing_to_import(tmp_path):
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / "notes.txt").write_text("x")
    left = str(tmp_path / "left")
    refuses(tmp_path, left, left, "are the same")
    refuses(tmp_path, left, "elsewhere", "holds no pictures")
    refuses(tmp_path, "nowhere/*.png", left, "there is no folder, file or pattern")
    refuses(tmp_path, str(tmp_path / "left" / "notes.txt"), left, r"\*.txt cannot be imported")


def test_kinds_are_not_mixed(tmp_path):
    left, right = fill(tmp_path, ".png", frames=2)
    cv2.imwrite(str(tmp_path / "left" / "x.jpg"), picture("left", 0, 8))
    refuses(tmp_path, left, right, r"3 files of kind .jpg, .png")


def test_mixed_sizes_name_the_picture(tmp_path):
    left, right = fill(tmp_path, ".png", frames=3)
    cv2.imwrite(str(tmp_path / "left" / "frame1.png"), picture("left", 1, rows=7))
    refuses(tmp_path, left, right, r"frame1.png' has 8 x 7 pixels, the pictures before it have 8 x 6")


def test_mixed_depths_name_the_picture(tmp_path):
    left, right = fill(tmp_path, ".png", frames=3)
    cv2.imwrite(str(tmp_path / "left" / "frame2.png"), picture("left", 1, 8))
    refuses(tmp_path, left, right, r"frame2.png' has 8 bits, the pictures before it have 16")


def test_cameras_of_different_size_or_depth(tmp_path):
    for name, values in (("a", picture("l", 0)), ("b", picture("r", 0, rows=5)), ("c", picture("r", 0, 8))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), values)
    a, b, c = (str(tmp_path / f"{name}.png") for name in "abc")
    refuses(tmp_path, a, b, "left pictures have 8 x 6 pixels, the right ones 8 x 5")
    refuses(tmp_path, a, c, "left pictures have 16 bits, the right ones 8")


@pytest.mark.parametrize(
    ("extra", "match"), [("left", "right pictures end after 4"), ("right", "left pictures end")]
)
def test_unequal_numbers(tmp_path, extra, match):
    left, right = fill(tmp_path, ".png", frames=4)
    cv2.imwrite(str(tmp_path / extra / "frame9.png"), picture(extra, 9))
    refuses(tmp_path, left, right, match)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16, np.int32, np.uint32, np.bool_])
def test_odd_types_in_arrays(tmp_path, dtype):
    left, right = fill(tmp_path, ".npy", frames=2)
    np.save(tmp_path / "right" / "frame1.npy", np.zeros((6, 8), dtype))
    refuses(tmp_path, left, right, f"frame1.npy' holds {np.dtype(dtype)} values")


def test_float_tiff(tmp_path):
    left, right = fill(tmp_path, ".tif", frames=2)
    cv2.imwrite(str(tmp_path / "left" / "frame1.tif"), np.zeros((6, 8), np.float32))
    refuses(tmp_path, left, right, r"frame1.tif' has 32 bits per pixel")


def test_bilevel_png_is_not_taken_for_counts(tmp_path):
    left, right = fill(tmp_path, ".png", 8, frames=2)
    cv2.imwrite(str(tmp_path / "left" / "frame0.png"), picture("left", 0, 8), [cv2.IMWRITE_PNG_BILEVEL, 1])
    refuses(tmp_path, left, right, r"frame0.png' has 1 bits per pixel")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".npy", ".npz", ".avi"])
@pytest.mark.parametrize("content", ["empty", "text", "half"])
def test_unreadable_files_are_named(tmp_path, suffix, content):
    whole = tmp_path / f"whole{suffix}"
    if suffix in (".npy", ".npz"):
        save = np.save if suffix == ".npy" else np.savez_compressed
        save(whole, picture("left", 0, rows=80))
    elif suffix == ".avi":
        whole.write_bytes(b"RIFF....AVI LIST")
    else:
        cv2.imwrite(str(whole), picture("left", 0, 8, rows=80))
    stored = whole.read_bytes()
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(
        {"empty": b"", "text": b"no picture at all", "half": stored[: len(stored) // 2]}[content]
    )
    refuses(tmp_path, str(path), str(whole), rf"broken{suffix}.* cannot be read")


def test_pickled_arrays_are_not_loaded(tmp_path):
    np.save(tmp_path / "left.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    np.save(tmp_path / "right.npy", picture("right", 0))
    refuses(tmp_path, str(tmp_path / "left.npy"), str(tmp_path / "right.npy"), "cannot be read")


def test_archives_under_a_wrong_name(tmp_path):
    np.save(tmp_path / "good.npy", picture("r", 0))
    np.savez(tmp_path / "archive.npz", picture("r", 0))
    (tmp_path / "archive.npz").rename(tmp_path / "archive.npy")
    (tmp_path / "array.npz").write_bytes((tmp_path / "good.npy").read_bytes())
    for name in ("archive.npy", "array.npz"):
        refuses(tmp_path, str(tmp_path / name), str(tmp_path / "good.npy"), f"{name}' cannot be read")


def test_archives_and_arrays_of_odd_shape(tmp_path):
    np.savez(tmp_path / "two.npz", a=picture("l", 0), b=picture("l", 1))
    np.save(tmp_path / "line.npy", np.zeros(5, np.uint16))
    np.save(tmp_path / "none.npy", np.zeros((0, 5, 5), np.uint16))
    np.save(tmp_path / "good.npy", picture("r", 0))
    for name, match in (("two.npz", "holds 2 arrays"), ("line.npy", "shape"), ("none.npy", "shape")):
        refuses(tmp_path, str(tmp_path / name), str(tmp_path / "good.npy"), match)


def test_output_is_never_overwritten(tmp_path):
    left, right = fill(tmp_path, ".png", frames=1)
    (tmp_path / "run.h5").write_text("precious")
    with pytest.raises(StoreError, match="exists already"):
        do(tmp_path, left, right)
    assert (tmp_path / "run.h5").read_text() == "precious"


@pytest.mark.parametrize(
    ("folder", "left", "right", "rows", "columns", "depth", "frames"),
    [
        ("middlebury_motorcycle", "motorcycle_left.png", "motorcycle_right.png", 500, 741, 8, 1),
        ("ms2_thermal", "left*.png", "right*.png", 256, 640, 16, 1),
        ("cats_thermal_stereo", "left*.png", "right*.png", 480, 640, 8, 2),
        ("nir_stereo_chessboard_640x512", "left*.jpg", "right*.jpg", 512, 640, 8, 17),
    ],
)
def test_real_footage(shared_data, tmp_path, folder, left, right, rows, columns, depth, frames):
    place = shared_data / folder
    if not place.is_dir():
        pytest.skip(f"{folder} is not here")
    report = do(tmp_path, str(place / left), str(place / right))
    assert (report.frames, report.rows, report.columns, report.bit_depth) == (frames, rows, columns, depth)
    assert verify(tmp_path / "run.h5").ok


def test_raw_thermal_counts_are_untouched(shared_data, tmp_path):
    place = shared_data / "ms2_thermal"
    if not place.is_dir():
        pytest.skip("ms2_thermal is not here")
    do(tmp_path, str(place / "left*.png"), str(place / "right*.png"))
    with open_run(tmp_path / "run.h5") as run:
        counts = run.counts("left", 0)
    assert 3000 < counts.min() < counts.max() < 6000
