"""Bad input of ``correction``, ``noise`` and ``preheat``: each is told plainly, and no file is left behind."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from thermacq.cli import main
from thermacq.rig import Rig
from thermacq.store import CameraStream, FrameRow, RunHeader, RunWriter

SHAPE = (40, 64)
FULL = 16383


def uniform(kelvin, side, index):
    """Counts of an uncorrected sensor before a blackbody: 100 counts/K, noise 3.5 counts."""
    pattern = np.random.default_rng(side)
    gain, offset = 1 + 0.03 * pattern.standard_normal(SHAPE), 150 * pattern.standard_normal(SHAPE)
    noise = 3.5 * np.random.default_rng((side, index, int(10 * kelvin))).standard_normal(SHAPE)
    return np.rint(6000 + offset + 100 * gain * (kelvin - 295) + noise).astype(np.uint16)


def saturated(_side, _index):
    return np.full(SHAPE, FULL, np.uint16)


def half_saturated(side, index):
    counts = uniform(300, side, index)
    counts[:, : SHAPE[1] // 2] = FULL
    return counts


def only_right_saturated(side, index):
    return uniform(300, side, index) if side == 1 else saturated(side, index)


def at(kelvin):
    return lambda side, index: uniform(kelvin, side, index)


def frozen(side, _index):
    return uniform(295, side, 0)


def write_run(path, counts, frames=32, serials=("SN1", "SN2"), step_s=0.02, shape=SHAPE):
    """Run of two cameras that cannot close a shutter, focal planes at 305 K."""
    cameras = [
        CameraStream(name, *shape, identity={"serial": serial})
        for name, serial in zip(("left", "right"), serials, strict=True)
    ]
    rig = Rig.model_validate({"cameras": {camera.name: {"driver": "test-pattern"} for camera in cameras}})
    header = RunHeader(
        "id", "t", "2026-01-02T03:04:05+00:00", 10**18, 0, "virtual", True, rig.model_dump(mode="json")
    )
    with RunWriter.create(path, header, cameras) as writer:
        for index in range(frames):
            for side, camera in enumerate(cameras, start=1):
                time_ns = round(step_s * 1e9) * index
                row = FrameRow(index, -1, time_ns, trigger_index=index, fpa_temperature_k=305.0)
                writer.append_frame(camera.name, counts(side, index)[: shape[0]], row)
        writer.finish({}, "done")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One run of each kind, and things that are no runs."""
    folder = tmp_path_factory.mktemp("runs")
    write_run(folder / "cold.h5", at(290))
    write_run(folder / "cold-again.h5", lambda side, index: uniform(290, side, 1000 + index))
    write_run(folder / "middle.h5", at(295))
    write_run(folder / "hot.h5", at(300))
    write_run(folder / "saturated.h5", saturated)
    write_run(folder / "half.h5", half_saturated)
    write_run(folder / "right.h5", only_right_saturated)
    write_run(folder / "frozen.h5", frozen)
    write_run(folder / "dark.h5", lambda _side, _index: np.zeros(SHAPE, np.uint16))
    write_run(folder / "short.h5", at(300), frames=8)
    write_run(folder / "others.h5", lambda side, index: uniform(300, side + 5, index), serials=("SN7", "SN8"))
    write_run(
        folder / "exchanged.h5", lambda side, index: uniform(300, 3 - side, index), serials=("SN2", "SN1")
    )
    write_run(folder / "size.h5", at(300), shape=(32, SHAPE[1]))
    (folder / "notes.txt").write_text("no run\n")
    (folder / "folder").mkdir()
    return folder


@pytest.fixture
def thermacq(monkeypatch, capsys, runs):
    """Run a command in the folder of the runs; give exit status and stderr. Nothing may be left behind."""

    def run(*arguments):
        monkeypatch.chdir(runs)
        monkeypatch.setattr(sys, "argv", ["thermacq", *map(str, arguments)])
        before = set(runs.iterdir())
        with pytest.raises(SystemExit) as ended:
            main()
        err = " ".join(capsys.readouterr().err.split())
        assert "Traceback" not in err
        assert set(runs.iterdir()) == before
        return ended.value.code or 0, err

    return run


@pytest.fixture(scope="module")
def correction(runs):
    """Correction file of the left camera."""
    from thermacq.imaging.making import make_corrections
    from thermacq.imaging.references import Reference

    made = make_corrections(Reference(runs / "cold.h5", 290.0), Reference(runs / "hot.h5", 300.0))
    path = runs / "left.correction.h5"
    made["left"].correction.save(path)
    return path


NO_VIEWS = [
    ("saturated.h5@300", "are constant: 100% of the pixels have the count 16383"),
    ("dark.h5@300", "are constant: 100% of the pixels have the count 0"),
    ("half.h5@300", "50.0% of the pixels of view half.h5, camera 'left' never change; most stand at 16383"),
    ("right.h5@300", "view right.h5, camera 'right' are constant"),
    ("frozen.h5@300", "has 1 different frame, fewer than 16"),
    ("short.h5@300", "has 8 different frames, fewer than 16"),
    ("others.h5@300", "did not take part in 'others.h5' (left is SN7, right is SN8)"),
    ("size.h5@300", "pictures of different sizes"),
    ("notes.txt", "is not an HDF5 file"),
    ("folder", "there is no run file 'folder'"),
    ("nothing.h5", "there is no run file 'nothing.h5'"),
    ("hot.h5@27", "no temperature in kelvin Write RUN@293.15"),
    ("hot.h5@nan", "no temperature in kelvin"),
    ("hot.h5@300@5:6:7", "no range of frames"),
    ("hot.h5@300@100:200", "no good frames"),
    ("cold.h5@290", "less than 1 K apart: gains would be noise"),
    ("hot.h5@290.2", "less than 1 K apart: gains would be noise"),
    ("cold-again.h5@300", "differ by 0 counts only"),
    ("cold.h5@280", "Exchange --cold and --hot"),
]


@pytest.mark.parametrize(("hot", "words"), NO_VIEWS)
def test_no_correction_is_made_of_such_views(thermacq, hot, words):
    code, err = thermacq("correction", "make", "--cold", "cold.h5@290", "--hot", hot, "-o", "x")
    assert code == 1
    assert words in err


def test_equal_temperatures_are_seen_in_the_counts_when_no_temperature_is_given(thermacq):
    code, err = thermacq("correction", "make", "--cold", "cold.h5", "--hot", "cold-again.h5", "-o", "x")
    assert code == 1
    assert "gains would be noise" in err


def test_a_check_on_the_very_frames_of_the_correction_is_no_check(thermacq):
    views = ["--cold", "cold.h5@290", "--hot", "hot.h5@300"]
    code, err = thermacq("correction", "make", *views, "--check", "hot.h5@300", "-o", "x")
    assert code == 1
    assert "a view that was not used, at a third temperature" in err


@pytest.mark.parametrize("option", ["--check", "--uniform", "--shutter"])
def test_further_views_are_looked_at_likewise(thermacq, option):
    views = ["--cold", "cold.h5@290", "--hot", "hot.h5@300"]
    code, err = thermacq("correction", "make", *views, option, "saturated.h5@295", "-o", "x")
    assert code == 1
    assert "are constant" in err


def test_cameras_that_were_exchanged_are_known_by_their_serial_numbers(runs, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    views = ["--cold", f"{runs / 'cold.h5'}@290", "--hot", f"{runs / 'exchanged.h5'}@300", "--json"]
    monkeypatch.setattr(sys, "argv", ["thermacq", "correction", "make", *views, "-o", "x"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    # Gains of another camera's views would differ by far more than 3 %.
    assert '"gain_sd": 0.03' in capsys.readouterr().out
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("command", ["update", "check"])
@pytest.mark.parametrize(
    ("view", "words"),
    [
        ("saturated.h5", "are constant"),
        ("frozen.h5", "has 1 different frame"),
        ("others.h5", "did not take part"),
        ("size.h5", "correction"),
        ("notes.txt", "is not an HDF5 file"),
    ],
)
def test_a_correction_is_not_updated_or_judged_by_such_views(thermacq, correction, command, view, words):
    options = ["--shutter", view, "-o", "new.h5"] if command == "update" else [view]
    code, err = thermacq("correction", command, correction, *options)
    assert code == 1
    assert words in err


@pytest.mark.parametrize("file", ["notes.txt", "cold.h5", "folder", "nothing.h5"])
def test_what_is_no_correction_is_said_to_be_none(thermacq, file):
    code, err = thermacq("correction", "show", file)
    assert code == 1
    assert f"'{file}'" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["saturated.h5"], "are constant"),
        (["half.h5"], "never change"),
        (["frozen.h5"], "has 1 different frame"),
        (["short.h5"], "has 8 different frames"),
        (["notes.txt"], "is not an HDF5 file"),
        (["folder"], "there is no run file"),
        (["middle.h5@nan"], "no temperature in kelvin"),
        (["middle.h5", "--counts-per-kelvin", "0"], "it must be above 0"),
        (["middle.h5", "--counts-per-kelvin", "nan"], "it must be above 0"),
        (["middle.h5", "--sitf", "cold.h5@290", "--sitf", "hot.h5@300"], "needs 3 different temperatures"),
        (
            ["middle.h5", *(f"--sitf={name}@290" for name in ("cold.h5", "cold-again.h5", "hot.h5"))],
            "needs 3 different temperatures, there are 1",
        ),
        (
            ["middle.h5", "--sitf=cold.h5@290", "--sitf=middle.h5@295", "--sitf=size.h5@300"],
            "pictures of another size",
        ),
        (
            ["middle.h5", "--sitf=cold.h5@290", "--sitf=middle.h5@295", "--sitf=others.h5@300"],
            "did not take part",
        ),
        (["middle.h5", "-o", "nowhere/noise.html"], "there is no folder 'nowhere'"),
        (["middle.h5", "--correction", "notes.txt"], "is no camera correction"),
    ],
)
def test_no_noise_report_of_such_input(thermacq, arguments, words):
    code, err = thermacq("noise", *arguments)
    assert code == 1
    assert words in err


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        (saturated, "the picture is constant: each pixel has the count 16383"),
        (half_saturated, "the picture is saturated: 50% of the pixels have the largest count, 16383"),
        (frozen, "the camera has repeated one and the same picture for 40.1 min"),
    ],
)
def test_broken_pictures_are_no_warm_camera(tmp_path, monkeypatch, capsys, counts, words):
    """Nothing drifts less than a picture that stands still."""
    path = tmp_path / "preheat.h5"
    write_run(path, counts, frames=482, step_s=5.0)
    monkeypatch.setattr(sys, "argv", ["thermacq", "preheat", str(path), "--counts-per-kelvin", "100"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 3
    said = capsys.readouterr().out
    assert words in " ".join(said.split())
    assert said.rstrip().endswith("no-go")


def test_a_working_camera_is_warm_after_the_same_time(tmp_path, monkeypatch, capsys):
    path = tmp_path / "preheat.h5"
    write_run(path, at(295), frames=482, step_s=5.0)
    monkeypatch.setattr(sys, "argv", ["thermacq", "preheat", str(path), "--counts-per-kelvin", "100"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    assert capsys.readouterr().out.rstrip().endswith("go")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["notes.txt"], 1, "is not an HDF5 file"),
        (["folder"], 1, "there is no run file"),
        (["nothing.toml"], 2, "-o RUN"),
        (["cold.h5", "--counts-per-kelvin", "nan"], 1, "above 0"),
        (["cold.h5", "--correction", "notes.txt"], 1, "is no camera correction"),
        (["cold.h5", "--picture", "warm.jpg"], 2, ".png"),
    ],
)
def test_wrong_input_of_preheat(thermacq, arguments, code, words):
    done, err = thermacq("preheat", *arguments)
    assert done == code
    assert words in err


def test_a_missing_rig_leaves_no_run(thermacq):
    code, err = thermacq("preheat", "nothing.toml", "-o", "run.h5")
    assert code == 1
    assert "nothing.toml" in err
    assert not Path("run.h5").exists()
