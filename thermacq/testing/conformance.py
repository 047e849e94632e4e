"""The conformance suite as pytest tests: one for each rule of the device interface.

``pytest --pyargs thermacq.testing.conformance --driver NAME [--driver-settings FILE.toml]``

A driver whose device has an emulator is checked on that, unless ``--real-device`` is given.
"""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from thermacq.errors import RigError, ThermacqError
from thermacq.plugins import plugins
from thermacq.rig import explain, parse_toml, read_toml_text
from thermacq.testing.kit import Check, Nonconformity, NotApplicable, Subject, checks_for


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One test for each check that applies to the kind of the driver."""
    subject = _subject(metafunc.config)
    checks = checks_for(subject.driver.kind)
    names = [f"{check.__module__.rpartition('.')[2]}-{check.__name__}" for check in checks]
    metafunc.parametrize(("check", "subject"), [(check, subject) for check in checks], ids=names)


def test_driver(check: Check, subject: Subject) -> None:
    """The driver keeps this rule."""
    broken: Nonconformity | None = None
    try:
        check(subject)
    except NotApplicable as reason:
        pytest.skip(str(reason))
    except Nonconformity as error:
        broken = error
    if broken is not None:
        pytest.fail(f"{check.__doc__}\n\n{broken}\n{_origin(broken)}", pytrace=False)


def _origin(broken: Nonconformity) -> str:
    """Where in the driver an untyped error came from; typed ones explain themselves."""
    cause = broken.__cause__
    if cause is None or isinstance(cause, ThermacqError | Nonconformity):
        return ""
    return "".join(traceback.format_exception(cause))


def _subject(config: pytest.Config) -> Subject:
    """Driver and settings that the options name; a message without traceback when they name none."""
    name, file = config.getoption("--driver"), config.getoption("--driver-settings")
    trouble = "say which driver to check: --driver NAME (`thermacq devices` lists them)"
    try:
        if name:
            emulator = None if config.getoption("--real-device") else plugins().emulators().get(name)
            return Subject(plugins().driver(name), _settings(name, file) if file else {}, emulator)
    except ThermacqError as error:
        trouble = str(error)
    raise pytest.Collector.CollectError(trouble)


def _settings(name: str, file: str) -> dict[str, Any]:
    """Settings from a TOML file, checked with their lines."""
    text = read_toml_text(Path(file))
    settings = parse_toml(text, file)
    model = plugins().driver(name).settings()
    try:
        model.model_validate(settings)
    except ValidationError as error:
        raise RigError(explain(error, model, file, text)) from None
    return settings
