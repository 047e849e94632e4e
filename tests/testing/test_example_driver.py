"""The driver author's guide tells the truth: its code is the example's, and the example conforms."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
EXAMPLE = REPOSITORY / "examples" / "driver"
GUIDE = REPOSITORY / "docs" / "how-to" / "write-a-driver.md"

BLOCKS = re.findall(r"^```(?:python|toml)\n(.*?)^```", GUIDE.read_text(), re.MULTILINE | re.DOTALL)
# How to use the kit and the driver; these stand in no file of the example.
USE = ("from thermacq.testing.kit import", "[cameras.left]")


@pytest.fixture
def installed(tmp_path):
    """Environment of an interpreter in which the example is installed as its pyproject says."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    information = tmp_path / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    information.mkdir()
    metadata = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (information / "METADATA").write_text(metadata)
    entries = [f"{name} = {value}" for name, value in project["entry-points"]["thermacq"].items()]
    (information / "entry_points.txt").write_text("\n".join(["[thermacq]", *entries, ""]))
    shutil.copy(EXAMPLE / "noise_camera.py", tmp_path)
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


def run(environment, folder, *arguments) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        env=environment,
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("block", [block for block in BLOCKS if not block.startswith(USE)])
def test_every_block_of_the_guide_is_text_of_the_example(block):
    files = [(EXAMPLE / name).read_text() for name in ("noise_camera.py", "pyproject.toml")]
    assert any(block in text for text in files), block


def test_the_guide_shows_every_verb():
    shown = "\n".join(BLOCKS)
    for verb in ("open", "configure", "arm", "trigger", "frames", "disarm", "close", "capabilities"):
        assert f"def {verb}(self" in shown


def test_the_example_is_short():
    assert len((EXAMPLE / "noise_camera.py").read_text().splitlines()) < 150


@pytest.mark.slow
def test_the_example_conforms(installed, tmp_path):
    suite = ("pytest", "--pyargs", "thermacq.testing.conformance", "-p", "no:cacheprovider", "-rs")
    done = run(installed, tmp_path, *suite, "--driver", "noise-camera")
    assert done.returncode == 0, done.stdout
    assert re.search(r"21 passed, 3 skipped", done.stdout), done.stdout
    assert "declares no settings that act out DeviceOverrun" in done.stdout


@pytest.mark.slow
def test_the_suite_says_what_is_wrong_with_its_options(installed, tmp_path):
    suite = ("pytest", "--pyargs", "thermacq.testing.conformance", "-p", "no:cacheprovider")
    assert "say which driver to check" in run(installed, tmp_path, *suite).stdout
    unknown = run(installed, tmp_path, *suite, "--driver", "noise-camra")
    assert unknown.returncode != 0
    assert "Did you mean 'noise-camera'?" in unknown.stdout
    (tmp_path / "settings.toml").write_text("rows = 20\ncolums = 3\n")
    wrong = run(installed, tmp_path, *suite, "--driver", "noise-camera", "--driver-settings", "settings.toml")
    assert "settings.toml, line 2: unknown key 'colums'; did you mean 'columns'?" in wrong.stdout


def test_a_failure_quotes_the_rule_and_shows_where_the_error_came_from(installed, tmp_path):
    module = tmp_path / "noise_camera.py"
    module.write_text(module.read_text().replace("check_settings(NoiseSettings,", "dict(NoiseSettings,"))
    suite = ("pytest", "--pyargs", "thermacq.testing.conformance", "-p", "no:cacheprovider", "-k", "identity")
    assert run(installed, tmp_path, *suite, "--driver", "noise-camera").returncode == 0
    suite = (*suite[:-1], "settings_are_returned")
    done = run(installed, tmp_path, *suite, "--driver", "noise-camera")
    assert done.returncode == 1
    assert "`configure` returns everything in force, defaults included, as plain values." in done.stdout
    assert "noise_camera.py" in done.stdout


def test_the_guides_rig_file_fits(installed, tmp_path):
    block = next(block for block in BLOCKS if block.startswith("[cameras.left]"))
    (tmp_path / "rig.toml").write_text(block)
    done = run(installed, tmp_path, "thermacq", "rig", "check", "rig.toml")
    assert done.returncode == 0, done.stderr
    assert "rows = 240" in done.stdout
