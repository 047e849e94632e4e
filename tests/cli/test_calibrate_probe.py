"""``calibrate probe`` and ``probe-drift`` as a user runs them; the simulated probe is the truth."""

from __future__ import annotations

import json
import re
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

from thermacq.cli.app import app
from thermacq.store import CameraStream, ProbeStream, RunHeader, RunWriter

DEPTHS = (0.0, 0.05, 0.1, 0.15, 0.1, 0.05)
LIST = "0,0.05,0.1,0.15,0.1,0.05"
RATE_HZ = 50.0


def run(*words):
    return CliRunner().invoke(app, ["calibrate", *map(str, words)])


def failure(*words):
    result = run(*words)
    assert result.exit_code != 0
    assert hasattr(result.exception, "what"), result.output
    return f"{result.exception.what} {result.exception.kept}"


def volts(coefficient=20.0, seed=0, noise_m=2e-4, position_m=0.0):
    """Five seconds at each depth, 2.5 V in still water."""
    rng = np.random.default_rng(seed)
    held = np.array(DEPTHS) + position_m * rng.standard_normal(len(DEPTHS))
    depth = np.repeat(held, round(5 * RATE_HZ))
    return 2.5 + coefficient * (depth + noise_m * rng.standard_normal(depth.size))


def write_table(path, raw):
    rows = "\n".join(f"{index / RATE_HZ:.3f},{value:.6f}" for index, value in enumerate(raw))
    path.write_text(f"time_s,volts\n{rows}\n")
    return path


@pytest.fixture
def probe_run(tmp_path):
    path, raw = tmp_path / "probe.h5", volts(20.08)
    rig = {"cameras": {"left": {"driver": "x"}}, "probes": {"P1": {"driver": "y"}}}
    header = RunHeader("run-1", "", "2026-01-02T03:04:05Z", 0, 10**9, "virtual", True, rig, None)
    stream = ProbeStream("P1", ("elevation",), "V", 1e6, identity={"serial": "SIM-P1"})
    with RunWriter.create(path, header, [CameraStream("left", 8, 8)], [stream]) as writer:
        ticks = np.rint(np.arange(raw.size) / RATE_HZ * 1e6).astype(np.int64)
        for start in range(0, raw.size, 50):
            block = slice(start, start + 50)
            writer.append_samples(
                "P1", raw[block, None], ticks[block], start, 10**9 + int(ticks[block][-1]) * 1000
            )
        writer.finish({}, "done")
    return path


def test_a_recorded_calibration_gives_coefficient_errors_and_the_rig_table(probe_run, tmp_path):
    output, toml = tmp_path / "p.json", tmp_path / "p.toml"
    result = run("probe", probe_run, "--immersion", LIST, "-o", output, "--toml", toml)
    assert result.exit_code == 0, result.output
    table = tomllib.loads(toml.read_text())["probes"]["P1"]
    assert table["coefficient_m_per_unit"] == pytest.approx(1 / 20.08, rel=1e-3)
    assert 0 < table["coefficient_u_rel"] < 2e-3
    assert table["zero_raw"] == pytest.approx(2.5, abs=2e-3)
    assert "for the rig file" in result.stdout
    values = json.loads(output.read_text())
    assert (values["serial"], values["unit"], len(values["steps"])) == ("SIM-P1", "V", 6)
    assert "exists" in failure("probe", probe_run, "--immersion", LIST, "-o", output)


def test_the_coefficient_is_within_its_uncertainty_over_repeats(tmp_path):
    """Depths set to 0.1 mm by hand: errors follow Student's t with 4 degrees of freedom."""
    scores = []
    for seed in range(24):
        path = write_table(tmp_path / "t.csv", volts(seed=seed, position_m=1e-4))
        output = tmp_path / f"{seed}.json"
        assert run("probe", path, "--immersion", LIST, "-o", output).exit_code == 0
        line = json.loads(output.read_text())["line"]
        scores.append((line["coefficient_m_per_unit"] * 20 - 1) / line["coefficient_u_rel"])
    assert 0.4 < np.median(np.abs(scores)) < 1.1
    assert np.mean(np.abs(scores) < 2.776) > 0.85


def test_history_gives_the_spread_and_puts_it_into_the_table(tmp_path):
    folder = tmp_path / "history"
    folder.mkdir()
    (folder / "other.json").write_text("{}")
    for index, factor in enumerate((1.0, 1.0044, 0.9956)):
        path = write_table(tmp_path / "t.csv", volts(20 * factor, seed=index))
        words = (
            "probe",
            path,
            "--immersion",
            LIST,
            "-o",
            folder / f"{index}.json",
            "--history",
            folder,
            "--json",
        )
        result = run(*words)
        assert result.exit_code == 0, result.output
        assert "not in the history: other.json" in result.stderr
    values = json.loads(result.stdout)
    assert values["spread"]["sd_rel"] == pytest.approx(0.0044, rel=0.1)
    assert f"coefficient_u_rel = {values['spread']['sd_rel']:.3g}" in values["rig_table"]
    assert "spread of 3 coefficients" in run(*words[:-4], tmp_path / "n.json", *words[-3:-1]).stdout


def test_drift_between_two_calibrations(tmp_path):
    for name, coefficient in (("before", 20.0), ("same", 20.0), ("after", 20.3)):
        path = write_table(tmp_path / "t.csv", volts(coefficient, seed=len(name)))
        assert run("probe", path, "--immersion", LIST, "-o", tmp_path / f"{name}.json").exit_code == 0
    steady = run("probe-drift", tmp_path / "before.json", tmp_path / "before.json")
    assert (steady.exit_code, steady.stdout.count("no drift")) == (0, 2)
    drifted = run("probe-drift", tmp_path / "before.json", tmp_path / "after.json", "--json")
    assert drifted.exit_code == 3
    values = json.loads(drifted.stdout)
    assert values["coefficient_rel"] == pytest.approx(20 / 20.3 - 1, abs=2e-3)
    assert values["coefficient_significant"]
    assert "no file" in failure("probe-drift", tmp_path / "before.json", tmp_path / "none.json")


def test_a_table_with_its_immersions(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("depth;raw\n0;2,5\n0,05;3,5\n0,1;4,5\n0,15;5,49\n")
    result = run("probe", path, "--immersion-column", "depth", "--channel", "raw", "-o", tmp_path / "p.json")
    assert result.exit_code == 0, result.output
    values = json.loads((tmp_path / "p.json").read_text())
    assert values["line"]["coefficient_m_per_unit"] == pytest.approx(0.05, rel=0.01)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--immersion", "0"), "1 immersion:"),
        (("--immersion", "0.1,0.1,0.1"), "all immersions are 0.1 m"),
        (("--immersion", "0,0.05,0.1,0.15,0.1,0.05,0,0.05"), "does not (hold that many|stand still)"),
        (("--immersion", "0,0.05,0.1"), "does not stand still"),
        (("--immersion", "0,0.05,0.1,0.15,0.2,0.25"), "do not follow the immersions"),
        (("--immersion", "0,50,100,150,100,50"), "in metres"),
        (("--immersion", LIST, "--channel", "other"), "no channel 'other'"),
        (("--immersion", LIST, "--probe", "P9"), "P9"),
    ],
)
def test_bad_input_is_explained_and_writes_nothing(probe_run, tmp_path, words, message):
    output = tmp_path / "p.json"
    said = failure("probe", probe_run, *words, "-o", output)
    assert re.search(message, said), said
    assert not output.exists()


def test_noise_holes_and_missing_files_are_explained(tmp_path):
    output = tmp_path / "p.json"
    noisy = write_table(tmp_path / "noisy.csv", volts(noise_m=0.5))
    assert "does not" in failure("probe", noisy, "--immersion", LIST, "-o", output)
    raw = volts()
    raw[::3] = np.nan
    holes = write_table(tmp_path / "holes.csv", raw)
    assert "33 %" in failure("probe", holes, "--immersion", LIST, "-o", output)
    assert "no file" in failure("probe", tmp_path / "none.csv", "--immersion", LIST, "-o", output)
    good = write_table(tmp_path / "good.csv", volts())
    assert "no folder" in failure(
        "probe", good, "--immersion", LIST, "-o", output, "--history", tmp_path / "x"
    )
    for words in ((), ("--immersion", "a,b"), ("--immersion", LIST, "--immersion-column", "1")):
        assert run("probe", holes, *words, "-o", output).exit_code == 2
    assert not output.exists()
