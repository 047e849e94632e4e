"""The plugin manager: a broken plugin is listed with its error and stops nothing."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest

from thermacq.devices import DeviceKind
from thermacq.errors import PluginError
from thermacq.hooks import GROUP, TruthRequest
from thermacq.plugins import ALLOW_VARIABLE, BLOCK_VARIABLE, Plugins, load_plugins
from thermacq.rig import parse_rig

DRIVER = """
from thermacq.devices import DeviceKind
from thermacq.hooks import Driver, Evidence, RigFinding, Command, hookimpl

def _driver(name, kind=DeviceKind.CAMERA):
    return Driver(name, kind, "for tests", Evidence.SIMULATED, make=None, settings=None)
"""

RIG = "[cameras.left]\ndriver = 'x'"


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Write modules with the given sources and load them as plugins; returns the manager."""
    monkeypatch.syspath_prepend(tmp_path)
    made = []

    def _load(**sources: str) -> Plugins:
        entries = []
        for name, source in sources.items():
            module = f"{tmp_path.name.replace('-', '_')}_{name}_{len(made)}"
            made.append(module)
            (tmp_path / f"{module}.py").write_text(DRIVER + source)
            entries.append(EntryPoint(name, module, GROUP))
        return load_plugins(entries)

    return _load


GOOD = "@hookimpl\ndef thermacq_drivers(): return [_driver('good')]"


def error_of(manager: Plugins, name: str) -> str:
    return next(status.error for status in manager.statuses if status.name == name)


@pytest.mark.parametrize(
    ("source", "error"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("raise SystemExit('vendor library missing')", "SystemExit: vendor library missing"),
        ("def ?", "SyntaxError"),
        ("1 / 0", "ZeroDivisionError"),
        ("@hookimpl\ndef thermacq_divers(): return []", "unknown hook 'thermacq_divers'"),
        ("@hookimpl\ndef thermacq_drivers(colour): return []", "Argument(s) {'colour'}"),
    ],
)
def test_a_plugin_that_cannot_be_loaded_is_listed_and_the_others_work(load, source, error):
    manager = load(aa_broken=source, good=GOOD)
    assert error in error_of(manager, "aa_broken")
    assert error_of(manager, "good") == ""
    assert list(manager.drivers()) == ["good"]


@pytest.mark.parametrize(
    ("source", "error"),
    [
        ("@hookimpl\ndef thermacq_drivers(): return None", "TypeError"),
        ("@hookimpl\ndef thermacq_drivers(): return ['camera']", "returned a str, not a Driver"),
        ("@hookimpl\ndef thermacq_drivers(): raise OSError('no bus')", "OSError: no bus"),
        ("@hookimpl\ndef thermacq_drivers(): return [_driver('good')]", "'good' is taken"),
    ],
)
def test_a_hook_that_returns_rubbish_is_noted_and_the_others_work(load, source, error):
    manager = load(good=GOOD, rubbish=source)
    assert list(manager.drivers()) == ["good"]
    assert error in error_of(manager, "rubbish")
    assert error_of(manager, "good") == ""


def test_loading_the_same_module_twice_keeps_the_first(load, tmp_path):
    manager = load(first=GOOD)
    module = manager.statuses[0].module
    twice = load_plugins([EntryPoint("a", module, GROUP), EntryPoint("b", module, GROUP)])
    assert "already registered" in error_of(twice, "b")
    assert list(twice.drivers()) == ["good"]


def test_the_allow_list_keeps_all_others_out(load, monkeypatch):
    monkeypatch.setenv(ALLOW_VARIABLE, " good , ")
    manager = load(good=GOOD, other="raise RuntimeError('must not be imported')")
    assert [(status.name, status.blocked, status.error) for status in manager.statuses] == [
        ("good", False, ""),
        ("other", True, ""),
    ]


def test_the_block_list_wins_over_the_allow_list(load, monkeypatch):
    monkeypatch.setenv(ALLOW_VARIABLE, "good")
    monkeypatch.setenv(BLOCK_VARIABLE, "good")
    assert load(good=GOOD).drivers() == {}


def test_an_interrupt_is_never_swallowed(load):
    with pytest.raises(KeyboardInterrupt):
        load(impatient="raise KeyboardInterrupt")


def test_drivers_are_chosen_by_kind_and_the_nearest_name_is_offered(load):
    source = "@hookimpl\ndef thermacq_drivers(): return [_driver('gauge', DeviceKind.WAVE_PROBE)]"
    manager = load(good=GOOD, gauges=source)
    assert list(manager.drivers(DeviceKind.WAVE_PROBE)) == ["gauge"]
    assert manager.driver("gauge").kind is DeviceKind.WAVE_PROBE
    with pytest.raises(PluginError, match="no camera driver named 'goood'") as caught:
        manager.driver("goood", DeviceKind.CAMERA)
    assert "Did you mean 'good'?" in caught.value.remedy
    with pytest.raises(PluginError, match="no camera driver named 'gauge'"):
        manager.driver("gauge", DeviceKind.CAMERA)


def test_rig_checks_of_all_plugins_are_gathered_and_a_failing_one_is_a_finding(load):
    manager = load(
        careful="@hookimpl\ndef thermacq_rig_checks(rig): return [RigFinding('error', rig.name)]",
        broken="@hookimpl\ndef thermacq_rig_checks(rig): return 1 / 0",
        rubbish="@hookimpl\ndef thermacq_rig_checks(rig): return ['wet']",
    )
    findings = manager.rig_checks(parse_rig(f"name = 'tank'\n{RIG}"))
    assert ("error", "tank") in [(finding.severity, finding.message) for finding in findings]
    failed = sorted(finding.message for finding in findings if finding.severity == "warning")
    assert [message.split("'")[1] for message in failed] == ["broken", "rubbish"]


def test_truth_comes_from_the_plugin_that_knows_the_scene(load):
    request = TruthRequest({"kind": "flume"}, None, None, None)
    silent = "@hookimpl\ndef thermacq_truth(request): return None"
    knowing = "@hookimpl\ndef thermacq_truth(request): return ('truth', request.scene['kind'])"
    assert load(silent=silent, knowing=knowing).truth(request) == ("truth", "flume")
    assert load(silent=silent).truth(request) is None
    with pytest.raises(PluginError, match="KeyError"):
        load(bad="@hookimpl\ndef thermacq_truth(request): return request.scene['x']").truth(request)


def test_the_built_in_plugins_load_without_error():
    assert [(status.name, status.error) for status in load_plugins().statuses if status.error] == []
