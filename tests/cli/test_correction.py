"""``thermacq correction`` and recordings with corrections, as a user runs them, on the simulated flume."""

from __future__ import annotations

import json
import sys

import pytest

from thermacq.acquisition import record
from thermacq.cli import main
from thermacq.rig import Rig, load_rig
from thermacq.store import open_run

SMALL = {"rows": 96, "columns": 128}
SCENE = {
    "view": "uniform",
    "seed": 3,
    "uniform": {"temperatures_k": [290.0, 300.0, 295.0], "frames_per_temperature": 40},
    "camera": {
        "sensor": {
            "offset_k": 2.0,
            "gain": 0.03,
            "shading_k": 1.0,
            "bad_pixel_fraction": 0.003,
            "bad_pixels": "raw",
        }
    },
}


def rig(scene, **tables):
    cameras = {
        side: {"driver": "sim-camera", "settings": {"side": side, **SMALL}} for side in ("left", "right")
    }
    return Rig.model_validate({"clock": {"kind": "virtual"}, "cameras": cameras, "scene": scene, **tables})


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """A run of a blackbody at three temperatures."""
    path = tmp_path_factory.mktemp("views") / "views.h5"
    record(rig(SCENE), path, frames=120)
    return path


@pytest.fixture(scope="module")
def made(views, tmp_path_factory):
    """Correction files made from it by the command."""
    from typer.testing import CliRunner

    from thermacq.cli.app import app

    name = tmp_path_factory.mktemp("made") / "irt"
    words = [
        "correction",
        "make",
        "--cold",
        f"{views}@290",
        "--hot",
        f"{views}@300",
        "--check",
        f"{views}@295",
    ]
    result = CliRunner().invoke(app, [*words, "-o", str(name)])
    assert result.exit_code == 0, result.output
    return result.output, {side: name.with_name(f"irt-{side}.correction.h5") for side in ("left", "right")}


@pytest.fixture
def thermacq(monkeypatch, capsys):
    """Run a command; give exit status, stdout and stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["thermacq", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return ended.value.code or 0, captured.out, captured.err

    return run


def test_make_writes_a_file_for_each_camera_and_judges_it(made):
    output, files = made
    assert all(file.is_file() for file in files.values())
    assert "camera left (SIM-left): two-point, 128 x 96" in output
    assert "residual non-uniformity at 295 K" in output


def test_show_for_people_programs_and_as_picture(made, thermacq, tmp_path):
    file = made[1]["right"]
    status, out, _ = thermacq("correction", "show", file, "--picture", tmp_path / "c.png")
    assert status == 0
    assert "camera right (SIM-right)" in out
    assert (tmp_path / "c.png").stat().st_size > 10_000
    status, out, _ = thermacq("correction", "show", file, "--json")
    facts = json.loads(out)
    assert facts["serial"] == "SIM-right"
    assert facts["counts_per_kelvin"] == pytest.approx(100, rel=0.02)
    assert facts["bad_pixels"]["all"] > 10
    status, _, err = thermacq("correction", "show", file, "--picture", tmp_path / "c.png")
    assert status == 1
    assert "exists" in err


def test_update_and_check(made, views, thermacq, tmp_path):
    new = tmp_path / "new.correction.h5"
    file = made[1]["left"]
    status, out, err = thermacq("correction", "update", file, "--shutter", f"{views}@295", "-o", new)
    assert status == 0, err
    assert "offsets of" in out
    status, out, err = thermacq("correction", "check", new, f"{views}@295", "--json")
    judged = json.loads(out)
    assert status == (0 if judged["ok"] else 3)
    assert judged["uniformity"]["sigma_vh_counts"] < 1.0
    status, _, err = thermacq("correction", "update", file, "--shutter", f"{views}@295", "-o", new)
    assert status == 1
    assert "exists already" in err


@pytest.mark.parametrize(
    ("cold", "hot", "message"),
    [
        ("@290", "@290", "gains would be noise"),
        ("@300", "@290", "Exchange --cold and --hot"),
        ("", "@300", "one after the other"),
        ("@20", "@300", "no temperature in kelvin"),
    ],
)
def test_wrong_views_are_explained_and_nothing_is_written(views, thermacq, tmp_path, cold, hot, message):
    status, _, err = thermacq(
        "correction", "make", "--cold", f"{views}{cold}", "--hot", f"{views}{hot}", "-o", tmp_path / "x"
    )
    assert status == 1
    assert message in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_a_saturated_view_is_refused(thermacq, tmp_path):
    hot = tmp_path / "hot.h5"
    record(rig({**SCENE, "uniform": {"temperatures_k": [480.0]}}), hot, frames=32)
    status, _, err = thermacq("correction", "make", "--cold", hot, "-o", tmp_path / "x")
    assert status == 1
    assert "saturated" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hot.h5"]


def test_a_rig_records_its_corrections_and_raw_counts_stay(made, views, tmp_path, thermacq):
    files = {side: str(file) for side, file in made[1].items()}
    run_path = tmp_path / "run.h5"
    record(rig(SCENE, correction={"files": files}), run_path, frames=2)
    with open_run(run_path) as run, open_run(views) as plain:
        assert {name: one.camera for name, one in run.corrections().items()} == {
            "left": "left",
            "right": "right",
        }
        assert (run.counts("left", 1) == plain.counts("left", 1)).all()
    status, out, _ = thermacq("info", run_path, "--json")
    assert status == 0
    assert set(json.loads(out)["corrections"]) == {"left", "right"}


def test_a_rig_with_the_wrong_files_does_not_record(made, tmp_path, thermacq):
    path = tmp_path / "rig.toml"
    left, right = (f'"{made[1][side]}"' for side in ("left", "right"))
    text = '[clock]\nkind = "virtual"\n' + "".join(
        f'[cameras.{side}]\ndriver = "sim-camera"\nsettings = {{ side = "{side}", rows = 96, columns = 128 }}\n'
        for side in ("left", "right")
    )
    path.write_text(text + f"[correction.files]\nleft = {right}\nright = {left}\n")
    assert load_rig(path).correction.files["left"].endswith("irt-right.correction.h5")
    status, _, err = thermacq("record", path, "--frames", 2, "-o", tmp_path / "run.h5")
    assert status == 1
    assert "belongs to camera SIM-right, this one is SIM-left" in err
    assert not (tmp_path / "run.h5").exists()
    path.write_text(text + '[correction.files]\nleft = "nowhere.correction.h5"\n')
    status, _, err = thermacq("record", path, "--frames", 2, "-o", tmp_path / "run.h5")
    assert status == 1
    assert "there is no file" in err
