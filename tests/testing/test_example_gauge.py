"""The afternoon's guide tells the truth: its code is the example's, which conforms and survives a rehearsal."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

REPOSITORY = Path(__file__).resolve().parents[2]
EXAMPLE = REPOSITORY / "examples" / "gauge_driver"
GUIDE = (REPOSITORY / "docs" / "how-to" / "write-a-driver-in-an-afternoon.md").read_text()
BLOCKS = re.findall(r"^```(?:python|toml)\n(.*?)^```", GUIDE, re.MULTILINE | re.DOTALL)
RIG = next(block for block in BLOCKS if block.startswith("[trigger]"))


@pytest.fixture
def installed(tmp_path):
    """Environment of an interpreter in which the example is installed."""
    information = tmp_path / "thermacq_lab_gauge-0.1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: thermacq-lab-gauge\nVersion: 0.1.0\n")
    (information / "entry_points.txt").write_text("[thermacq]\nlab-gauge = lab_gauge\n")
    shutil.copy(EXAMPLE / "lab_gauge.py", tmp_path)
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


def run(environment, folder, *arguments) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


def load():
    specification = importlib.util.spec_from_file_location("lab_gauge", EXAMPLE / "lab_gauge.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize("block", [block for block in BLOCKS if block != RIG])
def test_every_block_of_the_guide_is_text_of_the_example(block):
    files = [(EXAMPLE / name).read_text() for name in ("lab_gauge.py", "pyproject.toml")]
    assert any(block in text for text in files), block


def test_the_example_is_as_short_as_the_guide_says():
    lines = len((EXAMPLE / "lab_gauge.py").read_text().splitlines())
    assert lines < 150
    assert f"{lines} lines" in GUIDE


def test_its_parser_reads_the_worked_message():
    values, rest = load().parse(bytes.fromhex("A5 2C 01 D2 A5 2C"))
    assert (values, rest) == ([pytest.approx(0.03)], bytes.fromhex("A5 2C"))


@given(st.binary(max_size=60))
def test_no_bytes_break_its_parser(data):
    values, rest = load().parse(data)
    assert len(rest) < 4
    assert len(values) <= len(data)


@pytest.mark.slow
def test_the_example_conforms(installed, tmp_path):
    suite = ("pytest", "--pyargs", "thermacq.testing.conformance", "-p", "no:cacheprovider")
    done = run(installed, tmp_path, *suite, "--driver", "lab-gauge")
    assert done.returncode == 0, done.stdout
    assert re.search(r"15 passed, 2 skipped", done.stdout), done.stdout


@pytest.mark.slow
def test_the_guides_rehearsal_counts_what_was_injected(installed, tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    command = ("thermacq", "record", "rig.toml", "--emulate", "-o", "run.h5", "--duration", "4", "--json")
    done = run(installed, tmp_path, *command)
    assert done.returncode == 0, done.stderr
    lost = json.loads(done.stdout)["summary"]["sync"]["devices"]["gauge"]["lost"]
    # The damaged message is one; a message that never left the gauge cannot be noticed.
    assert lost == {"probe_gap": 1}
    assert "EMULATED, not hardware: gauge" in run(installed, tmp_path, "thermacq", "info", "run.h5").stdout
