from __future__ import annotations

import csv
import json

import pytest
from typer.testing import CliRunner

from thermacq.cli.app import app
from thermacq.errors import ImportDataError, PluginError, ReconstructionError, StoreError

pytestmark = pytest.mark.usefixtures("known_truth")


def run_command(*words: object):
    return CliRunner().invoke(app, [str(word) for word in words])


def run_json(*words: object):
    result = run_command(*words, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout, parse_constant=pytest.fail)


@pytest.fixture
def series(tmp_path):
    path = tmp_path / "series.csv"
    lines = [
        f"{i * 0.02:.3f},{40 * ((i % 40 < 20) * 2 - 1) * (1 - abs(i % 20 - 10) / 10):.4f}" for i in range(400)
    ]
    path.write_text("t,eta\n" + "\n".join(lines) + "\n")
    return path


def test_waves_as_table_and_json(series):
    found = run_json("waves", series, "--value-column", "eta", "--unit", "mm", "--crest", "sample")
    assert found["mean_height_m"] == pytest.approx(0.08, rel=1e-6)
    assert found["mean_period_s"] == pytest.approx(0.8, rel=1e-6)
    table = run_command("waves", series, "--unit", "mm", "--crossing", "down")
    assert table.exit_code == 0
    assert "between zero down-crossings" in table.stdout
    assert "0.8000 ± 0.0000 s" in table.stdout


def test_waves_explains_bad_files(tmp_path):
    assert isinstance(run_command("waves", tmp_path / "none.txt").exception, ImportDataError)


def test_compare_as_table(measured_wave):
    result = run_command("compare", measured_wave.product, measured_wave.run)
    assert result.exit_code == 0, result.output
    assert "simulated run" in result.stdout
    assert "stereo / probe P1" in result.stdout
    assert "0.9703" in result.stdout
    assert "lag taken out before comparing  no" in result.stdout


def test_compare_as_json_and_csv(measured_wave, tmp_path):
    pairs = tmp_path / "pairs.csv"
    found = run_json("compare", measured_wave.product, measured_wave.run, "--csv", pairs, "--apply-lag")
    assert found["simulated"]
    comparison = found["comparisons"][0]
    assert comparison["agreement"]["slope"] == pytest.approx(0.98 / 1.01, abs=1e-3)
    assert comparison["lag"]["applied"]
    with pairs.open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["reference"] == "probe P1"]
    assert len(rows) == 200
    again = run_command("compare", measured_wave.product, measured_wave.run, "--csv", pairs)
    assert isinstance(again.exception, StoreError)


def test_compare_at_another_place(measured_wave):
    result = run_command("compare", measured_wave.product, measured_wave.run, "--at", "0.25", "0.0")
    assert "note: the surface was read at x = 0.250 m" in result.stdout
    outside = run_command("compare", measured_wave.product, measured_wave.run, "--at", "-9", "0.0")
    assert isinstance(outside.exception, ReconstructionError)


def test_export_of_a_frame_and_of_a_virtual_probe(measured_wave, tmp_path):
    cloud = tmp_path / "frame.ply"
    result = run_command("export", measured_wave.product, "--format", "ply", "--frame", "7", "-o", cloud)
    assert result.exit_code == 0, result.output
    assert cloud.read_bytes().startswith(b"ply\n")
    history = tmp_path / "history.csv"
    assert run_command("export", measured_wave.product, "--probe", "0.3", "0.0", "-o", history).exit_code == 0
    with history.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 200
    expected = 0.98 * measured_wave.elevation(0.5, 0.3)
    assert float(rows[25]["eta_m"]) == pytest.approx(expected, abs=2e-6)
    blind = tmp_path / "blind.csv"
    assert run_command("export", measured_wave.product, "--probe", "0.1", "0.0", "-o", blind).exit_code == 0
    assert blind.read_text().splitlines()[1] == "0.000000,,0.000500,0"


def test_export_refuses(measured_wave, tmp_path):
    taken = tmp_path / "taken.ply"
    taken.touch()
    product = measured_wave.product
    assert isinstance(run_command("export", product, "--format", "ply", "-o", taken).exception, StoreError)
    output = tmp_path / "new"
    misnamed = run_command("export", product, "--format", "vtk", "-o", output.with_suffix(".vtk"))
    assert "should end in '.vts'" in str(misnamed.exception)
    assert isinstance(run_command("export", product, "--format", "pyl", "-o", output).exception, PluginError)
    outside = run_command("export", product, "--probe", "7", "0", "-o", output)
    assert isinstance(outside.exception, ReconstructionError)
    assert run_command("export", product, "-o", output).exit_code == 2
    assert run_command("export", product, "--format", "csv", "--probe", "0", "0", "-o", output).exit_code == 2
    assert not output.exists()


def test_report(measured_wave, tmp_path):
    page = tmp_path / "report.html"
    result = run_command(
        "report",
        measured_wave.product,
        "--run",
        measured_wave.run,
        "--still",
        measured_wave.still,
        "-o",
        page,
    )
    assert result.exit_code == 0, result.output
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    again = run_command("report", measured_wave.product, "-o", page)
    assert isinstance(again.exception, StoreError)
    assert run_command("report", measured_wave.product, "-o", page, "--overwrite").exit_code == 0
