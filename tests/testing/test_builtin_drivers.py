"""Every built-in driver keeps every rule of the device interface."""

from __future__ import annotations

import pytest

from thermacq.hooks import Evidence
from thermacq.plugins import plugins
from thermacq.testing.kit import NotApplicable, Subject, checks_for

# Smaller pictures keep the run short; the rules are the same.
SETTINGS = {name: {"rows": 64, "columns": 80} for name in ("test-pattern", "sim-camera")}

# A driver that needs a real peer meets it, and this suite, in the folder of its own tests. Emulated devices
# take their time, as those that they play do: all of them together make the suite last for minutes.
BUILT_IN = [
    pytest.param(
        driver,
        check,
        id=f"{driver.name}-{check.__name__}",
        marks=pytest.mark.slow if driver.name in plugins().emulators() else (),
    )
    for driver in plugins().drivers().values()
    if driver.evidence is not Evidence.REAL_PEER
    for check in checks_for(driver.kind)
]


@pytest.mark.parametrize(("driver", "check"), BUILT_IN)
def test_driver_conforms(driver, check):
    try:
        check(Subject(driver, SETTINGS.get(driver.name, {}), plugins().emulators().get(driver.name)))
    except NotApplicable as reason:
        pytest.skip(str(reason))
