"""``thermacq plugins`` and ``thermacq devices``."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint

import pytest
from typer.testing import CliRunner

from thermacq import plugins as loaded
from thermacq.cli.app import app
from thermacq.hooks import GROUP

SOURCE = """
from thermacq.devices import DeviceIdentity, DeviceKind
from thermacq.hooks import Driver, Evidence, hookimpl

def _found(transports):
    return [DeviceIdentity("lab-camera", "Lab [M1]", "S1")]

def _broken(transports):
    raise OSError("no bus [3]")

@hookimpl
def thermacq_drivers():
    camera, made = DeviceKind.CAMERA, Evidence.HARDWARE
    return [
        Driver("lab-camera", camera, "a camera", made, make=None, settings=None, discover=_found),
        Driver("no-bus", camera, "a bus", made, make=None, settings=None, discover=_broken),
    ]
"""


@pytest.fixture
def runner(tmp_path, monkeypatch):
    """A command runner with one good plugin and one that cannot be imported."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "lab_plugin.py").write_text(SOURCE)
    (tmp_path / "rotten_plugin.py").write_text("raise ImportError('needs [x]')")
    entries = [EntryPoint("lab", "lab_plugin", GROUP), EntryPoint("rotten", "rotten_plugin", GROUP)]
    manager = loaded.load_plugins(entries)
    monkeypatch.setattr(loaded, "plugins", lambda: manager)
    yield CliRunner()
    import sys

    sys.modules.pop("lab_plugin")


def test_plugins_as_json(runner):
    done = runner.invoke(app, ["plugins", "--json"])
    assert done.exit_code == 0
    answer = json.loads(done.stdout)
    assert answer["drivers"] == ["lab-camera", "no-bus"]
    errors = {plugin["name"]: plugin["error"] for plugin in answer["plugins"]}
    assert errors["lab"] == ""
    assert errors["rotten"] == "ImportError: needs [x]"


def test_plugins_for_people_show_the_error(runner):
    done = runner.invoke(app, ["plugins"])
    assert done.exit_code == 0
    assert "ImportError: needs [x]" in done.stdout


def test_devices_as_json(runner):
    done = runner.invoke(app, ["devices", "--json"])
    rows = {row["driver"]: row for row in json.loads(done.stdout)["drivers"]}
    assert rows["lab-camera"]["found"] == [
        {"driver": "lab-camera", "model": "Lab [M1]", "serial": "S1", "firmware": ""}
    ]
    assert rows["lab-camera"]["proven_on"] == "hardware"
    assert rows["no-bus"]["error"] == "OSError: no bus [3]"
    assert rows["no-bus"]["found"] == []


def test_devices_for_people_show_names_and_errors_as_they_are(runner):
    done = runner.invoke(app, ["devices"])
    assert done.exit_code == 0
    assert "[M1]" in done.stdout
    assert "[3]" in done.stdout
