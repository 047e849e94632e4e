"""Files that are broken, foreign or hostile: each is a clear `StoreError`, soon."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermacq.errors import StoreError
from thermacq.store import open_run, verify

DETAILS = "entry/thermacq"
FRAMES = "entry/instrument/left/thermacq"


def replace(file, name, **options):
    del file[name]
    file.create_dataset(name, **options)


def change_json(file, name, change):
    document = json.loads(file[f"{DETAILS}/{name}"][()])
    change(document)
    replace(file, f"{DETAILS}/{name}", data=np.bytes_(json.dumps(document).encode()))


def refuses(path, match=r"run\.h5"):
    with pytest.raises(StoreError, match=match):
        verify(path)


def test_questions_about_unknown_devices_and_frames(run_file):
    with open_run(run_file) as run:
        for question in (
            lambda: run.counts("middle", 0),
            lambda: run.frames("gauge"),
            lambda: run.probe("left"),
            lambda: run.counts("left", 25),
            lambda: run.counts("left", -1),
        ):
            with pytest.raises(StoreError, match=r"run\.h5"):
                question()


def test_hash_is_that_of_the_file(run_file):
    import hashlib

    with open_run(run_file) as run:
        assert run.sha256() == hashlib.sha256(run_file.read_bytes()).hexdigest()


def test_paths_that_are_no_files(tmp_path):
    refuses(tmp_path, "there is no run file")
    refuses(tmp_path / "none.h5", "there is no run file")


@pytest.mark.parametrize("content", [b"", b"x", b"frame,time\n1,2\n", b"\x89HDF\r\n\x1a\n", os.urandom(4096)])
def test_not_hdf5(tmp_path, content):
    path = tmp_path / "r.h5"
    path.write_bytes(content)
    refuses(path, "HDF5")


def test_a_fifo_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "r.h5")
    refuses(tmp_path / "r.h5", "there is no run file")


def test_foreign_hdf5(tmp_path):
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["image"] = np.zeros((4, 4))
    refuses(tmp_path / "r.h5", "entry")


def test_newer_format(run_file):
    with h5py.File(run_file, "r+") as file:
        file[f"{DETAILS}/format_version"][()] = 99
    refuses(run_file, "format version 99")


@pytest.mark.parametrize(
    "name",
    ["entry/instrument", "entry/events", DETAILS, f"{DETAILS}/streams", FRAMES, f"{FRAMES}/crc32",
     f"{FRAMES}/committed", "entry/instrument/left/data", "entry/instrument/gauge_thermacq/pulses"],
)  # fmt: skip
def test_missing_members(run_file, name):
    with h5py.File(run_file, "r+") as file:
        del file[name]
    refuses(run_file, name.rsplit("/", 1)[1])


@pytest.mark.parametrize("link", [h5py.SoftLink, h5py.ExternalLink])
def test_links_are_not_followed(run_file, tmp_path, link):
    other = shutil.copy(run_file, tmp_path / "other.h5")
    with h5py.File(run_file, "r+") as file:
        name = "entry/instrument/right"
        del file[name]
        file[name] = link(f"/{name}") if link is h5py.SoftLink else link(str(other), f"/{name}")
    refuses(run_file, "no member 'right' of its own")


def test_cyclic_links_do_not_hang(run_file):
    with h5py.File(run_file, "r+") as file:
        file["entry/instrument/left/again"] = file["entry"]
        del file["entry/events"]
        file["entry/events"] = file["entry"]
    refuses(run_file)


def test_data_from_other_files_are_refused(run_file, tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(1000))
    with h5py.File(run_file, "r+") as file:
        replace(file, f"{FRAMES}/host_ns", shape=(25,), dtype="i8", external=[(str(secret), 0, 200)])
    refuses(run_file, "from elsewhere")


def test_virtual_data_are_refused(run_file, tmp_path):
    other = shutil.copy(run_file, tmp_path / "other.h5")
    with h5py.File(run_file, "r+") as file:
        layout = h5py.VirtualLayout((25,), "i8")
        layout[:] = h5py.VirtualSource(other, f"{FRAMES}/host_ns", (25,))
        del file[f"{FRAMES}/host_ns"]
        file.create_virtual_dataset(f"{FRAMES}/host_ns", layout)
    refuses(run_file, "from elsewhere")


@pytest.mark.parametrize("committed", [26, 10**12, 2**63])
def test_more_frames_claimed_than_there_are(run_file, committed):
    with h5py.File(run_file, "r+") as file:
        file[f"{FRAMES}/committed"][()] = np.uint64(committed)
    refuses(run_file)


def test_a_bomb_of_declared_but_empty_frames(run_file):
    with h5py.File(run_file, "r+") as file:
        for column in file[FRAMES].values():
            if column.shape:
                column.resize((10**12,))
        file["entry/instrument/left/data"].resize(10**12, axis=0)
        file[f"{FRAMES}/committed"][()] = 10**12
    refuses(run_file, "more rows than the file can hold")


def test_a_bomb_of_declared_but_empty_samples(run_file):
    with h5py.File(run_file, "r+") as file:
        group = file["entry/instrument/gauge_thermacq"]
        for name in ("ticks", "index", "host_ns", "time", "value"):
            group[name].resize(10**12, axis=0)
        group["committed"][()] = 10**12
    refuses(run_file, "than the file can hold")


def test_frames_that_were_counted_but_never_written(run_file):
    with h5py.File(run_file, "r+") as file:
        for column in file[FRAMES].values():
            if column.shape:
                column.resize((30,))
        file["entry/instrument/left/data"].resize(30, axis=0)
        file[f"{FRAMES}/committed"][()] = 30
    report = verify(run_file)
    assert any("damaged frames: 25, 26, 27, 28, 29" in finding.what for finding in report.findings)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (f"{FRAMES}/committed", {"data": "25"}),
        (f"{FRAMES}/committed", {"data": 25.0}),
        (f"{FRAMES}/committed", {"data": [25]}),
        (f"{FRAMES}/committed", {"data": -25}),
        (f"{FRAMES}/crc32", {"data": ["text"] * 25}),
        (f"{FRAMES}/crc32", {"shape": (25,), "dtype": "i8"}),
        (f"{FRAMES}/crc32", {"shape": (25,), "dtype": "u4", "chunks": (5,), "compression": "gzip"}),
        (f"{FRAMES}/crc32", {"shape": (5, 5), "dtype": "u4"}),
        (f"{DETAILS}/header", {"data": "{}"}),
        (f"{DETAILS}/header", {"data": np.bytes_(b"{}")}),
        (f"{DETAILS}/header", {"data": np.bytes_(b"[" * 100_000)}),
        (f"{DETAILS}/header", {"data": np.bytes_(b"\xff\xfe")}),
        (f"{DETAILS}/header", {"shape": (), "dtype": "S1000000000"}),
        (f"{DETAILS}/versions", {"data": 5}),
        (f"{DETAILS}/finished", {"data": np.bytes_(b"yes")}),
        ("entry/instrument/left/data", {"shape": (25, 12, 16), "dtype": "u2"}),
        ("entry/instrument/left/data", {"shape": (25, 12, 16), "dtype": "f4", "chunks": (1, 12, 16)}),
        ("entry/instrument/left/data", {"shape": (25, 12, 16), "dtype": "u2", "chunks": (5, 12, 16)}),
        (
            "entry/instrument/left/data",
            {"shape": (25, 12, 16), "dtype": "u2", "chunks": (1, 12, 16), "compression": "gzip"},
        ),
    ],
)
def test_wrong_types_and_shapes(run_file, name, options):
    with h5py.File(run_file, "r+") as file:
        replace(file, name, **options)
    refuses(run_file)


@pytest.mark.parametrize(
    "change",
    [
        lambda streams: streams.update(cameras=7),
        lambda streams: streams["cameras"][0].update(rows="many"),
        lambda streams: streams["cameras"][0].update(rows=0),
        lambda streams: streams["cameras"][0].update(rows=10**9, columns=10**9),
        lambda streams: streams["cameras"][0].update(name="../../entry"),
        lambda streams: streams["cameras"][0].update(name=["left"]),
        lambda streams: streams["cameras"][0].update(identity="me"),
        lambda streams: streams["cameras"].extend(streams["cameras"][:1] * 1000),
        lambda streams: streams["probes"][0].update(channels=["one"]),
        lambda streams: streams["probes"][0].pop("unit"),
    ],
)
def test_impossible_devices(run_file, change):
    with h5py.File(run_file, "r+") as file:
        change_json(file, "streams", change)
    refuses(run_file)


def test_a_rig_of_another_version_is_explained(run_file):
    with h5py.File(run_file, "r+") as file:
        change_json(file, "rig", lambda rig: rig.update(warp_drive=True))
    with open_run(run_file) as run, pytest.raises(StoreError, match="warp_drive"):
        _ = run.rig


def test_chunks_that_lie_about_their_size(run_file):
    with h5py.File(run_file) as file:
        place = file["entry/instrument/left/data"].id.get_chunk_info_by_coord((0, 0, 0))
    content = bytearray(run_file.read_bytes())
    content[place.byte_offset + 4 : place.byte_offset + 8] = (2**31 - 1).to_bytes(4, "little")
    run_file.write_bytes(content)
    with open_run(run_file) as run, pytest.raises(StoreError, match=r"frame 0 of camera 'left'.*damaged"):
        run.counts("left", 0)


@pytest.fixture(scope="module")
def check_in_child(tmp_path_factory):
    """Open and verify a file in a process of its own, which HDF5 may crash; give its verdict."""
    script = tmp_path_factory.mktemp("child") / "check.py"
    script.write_text(
        "import sys\n"
        "from thermacq.errors import StoreError\n"
        "from thermacq.store import verify\n"
        "for line in sys.stdin:\n"
        "    try:\n"
        "        print('sound' if verify(line.strip()).ok else 'findings', flush=True)\n"
        "    except StoreError:\n"
        "        print('refused', flush=True)\n"
    )
    command = [sys.executable, "-W", "error", str(script)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:

        def check(path):
            child.stdin.write(f"{path}\n")
            child.stdin.flush()
            return child.stdout.readline().strip()

        yield check
        child.stdin.close()


@pytest.mark.slow
@pytest.mark.parametrize("finished", [True, False], ids=["complete", "killed"])
@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    database=None,
)
@given(data=st.data())
def test_any_damage_is_a_store_error(run_file, create, append, check_in_child, tmp_path, finished, data):
    """Flip, cut and zero bytes anywhere: opening and verifying ends soon, with a verdict."""
    original = tmp_path / f"original-{finished}"
    if not original.exists():
        original.write_bytes(run_file.read_bytes() if finished else killed(create, append, tmp_path))
    content = bytearray(original.read_bytes())
    used = np.flatnonzero(np.frombuffer(content, np.uint8))
    for _ in range(data.draw(st.integers(1, 12))):
        place = int(used[data.draw(st.integers(0, len(used) - 1))])
        content[place] = data.draw(st.integers(0, 255))
    if data.draw(st.integers(0, 7)) == 0:
        del content[data.draw(st.integers(0, len(content))) :]
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(content)
    assert check_in_child(damaged) in ("sound", "findings", "refused")


def killed(create, append, tmp_path):
    """Bytes of a run whose writer was killed after a commit."""
    writer = create(tmp_path / "living.h5")
    for index in range(8):
        append(writer, index)
    writer.flush()
    content = (tmp_path / "living.h5").read_bytes()
    writer.close()
    return content
