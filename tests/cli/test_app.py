"""The command line as a whole: plugin commands behind a guard, errors without tracebacks."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PLUGIN = """
import typer
from thermacq.hooks import Command, hookimpl

def _make_good():
    app = typer.Typer(help="Measure the tide.")

    @app.command()
    def high():
        print("high tide")

    @app.command()
    def low():
        from thermacq.errors import StoreError
        raise StoreError("no water [left]", kept="the sand", remedy="wait")

    return app

def _make_broken():
    raise SystemExit("no licence")

@hookimpl
def thermacq_commands():
    return [Command("tide", _make_good), Command("broken", _make_broken), Command("rig", _make_good)]
"""


@pytest.fixture
def thermacq(tmp_path):
    """Run the command in a fresh interpreter where a plugin with commands is installed."""
    (tmp_path / "tide_plugin.py").write_text(PLUGIN)
    information = tmp_path / "tide-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: tide\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[thermacq]\ntide = tide_plugin\n")

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        command = [sys.executable, "-m", "thermacq", *arguments]
        return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)

    return run


def test_help_lists_plugin_commands_and_survives_a_broken_one(thermacq):
    done = thermacq("--help")
    assert done.returncode == 0
    assert "tide" in done.stdout
    assert "Measure the tide." in done.stdout
    assert "devices" in done.stdout
    assert "broken" not in done.stdout
    assert "command 'broken' of a plugin cannot be used: SystemExit: no licence" in done.stderr


def test_a_plugin_command_runs(thermacq):
    done = thermacq("tide", "high")
    assert (done.returncode, done.stdout) == (0, "high tide\n")


def test_a_plugin_cannot_take_the_name_of_a_command_of_ours(thermacq):
    assert "schema" in thermacq("rig", "--help").stdout


def test_an_error_is_explained_and_not_traced(thermacq):
    done = thermacq("tide", "low")
    assert done.returncode == 1
    assert done.stderr.splitlines() == ["error: no water [left]", "  the sand", "  wait"]


def test_an_unknown_command_is_wrong_usage(thermacq):
    done = thermacq("tidal")
    assert done.returncode == 2
    assert "No such command 'tidal'" in done.stderr


def test_our_own_commands_load_no_plugin(thermacq):
    done = thermacq("rig", "schema")
    assert (done.returncode, done.stderr) == (0, "")
