"""The suite checks a driver on its emulator: which settings it uses, and that discovery must find the device."""

from __future__ import annotations

from dataclasses import replace

import pytest

from thermacq.devices import DeviceIdentity
from thermacq.errors import DeviceDisconnected, DeviceTimeout
from thermacq.plugins import plugins
from thermacq.testing import faults, lifecycle
from thermacq.testing.kit import Nonconformity, NotApplicable, Subject
from thermacq.transports import RealTransports

EMULATOR = plugins().emulator("pulse_pal")


def subject(**changes):
    return Subject(replace(plugins().driver("pulse_pal"), **changes), {}, EMULATOR)


def test_the_device_is_made_with_the_emulators_transports():
    with subject().bench() as bench:
        assert [node.serial for node in bench.transports.serial_ports()] == ["EMU-under-test"]
        assert bench.verb("open").serial == "EMU-under-test"
    with Subject(plugins().driver("pulse_pal")).bench() as bench:
        assert isinstance(bench.transports, RealTransports)


def test_settings_of_the_subject_go_over_those_of_the_emulator():
    emulator = replace(EMULATOR, driver_settings={"high_v": 3.3, "low_v": 0.5})
    bench = Subject(plugins().driver("pulse_pal"), {"low_v": 0.0}, emulator).bench()
    with bench:
        assert bench.settings == {"high_v": 3.3, "low_v": 0.0}


def test_faults_of_the_emulator_are_acted_out():
    assert subject().faults == {DeviceDisconnected}
    faults.disconnection(subject())
    with pytest.raises(NotApplicable):
        faults.timeout(subject())


def test_a_fault_that_does_not_come_is_no_conformity(monkeypatch):
    monkeypatch.setattr(faults, "COMES_WITHIN_S", 0.5)
    dull = replace(EMULATOR, faults={DeviceTimeout: {}})
    with pytest.raises(Nonconformity, match="DeviceTimeout did not come within"):
        faults.timeout(Subject(plugins().driver("pulse_pal"), {}, dull))


def identity(serial):
    return DeviceIdentity("pulse_pal", "Pulse Pal 2", serial)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ([], "lists 0 devices where one is emulated"),
        ([identity("EMU-under-test"), identity("x")], "lists 2 devices"),
        ([identity("/dev/ttyACM0")], "make driver and serial the same"),
    ],
)
def test_discovery_must_find_the_emulated_device_as_it_is_opened(found, words):
    with pytest.raises(Nonconformity, match=words):
        lifecycle.discovery(subject(discover=lambda _: found))


def test_an_identity_that_changes_is_found():
    names = iter("ab")
    with pytest.raises(Nonconformity, match="asked twice"):
        lifecycle.discovery(subject(discover=lambda _: [identity(next(names))]))
