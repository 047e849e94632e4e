"""Verbs in any order on every built-in device: only typed errors, and never a hang."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test

from thermacq.devices import DeviceKind, TriggerMode
from thermacq.errors import ThermacqError
from thermacq.plugins import plugins
from thermacq.testing.bench import StopSwitch
from thermacq.testing.kit import Subject
from thermacq.testing.streams import FrameSink
from thermacq_drivers.testpattern import DRIVER, PatternCamera

WITHIN_S = 10.0
SMALL = {name: {"rows": 16, "columns": 24, "timeout_s": 0.2} for name in ("test-pattern", "sim-camera")}
STREAMS = {
    DeviceKind.CAMERA: "frames",
    DeviceKind.WAVE_PROBE: "samples",
    DeviceKind.TRIGGER_SOURCE: "pulses",
}


def machine_for(driver):
    """A state machine that drives one device in random order."""

    class Machine(RuleBasedStateMachine):
        def __init__(self):
            super().__init__()
            self.bench = Subject(driver, SMALL.get(driver.name, {})).bench()
            self.generator = None
            self.host = StopSwitch()

        def call(self, what, action):
            """Anything but a typed error, or no answer, fails the test."""
            try:
                return self.bench.do(what, action, WITHIN_S)
            except (ThermacqError, StopIteration):
                return None

        @rule(name=st.sampled_from(["open", "disarm", "close"]))
        def plain_verb(self, name):
            self.call(name, getattr(self.bench.device, name))

        @rule(extra=st.sampled_from([{}, {}, {"no_such_setting": 1}, {"rows": -4}]))
        def configure(self, extra):
            self.call("configure", lambda: self.bench.device.configure({**self.bench.settings, **extra}))

        @rule(mode=st.sampled_from(TriggerMode), rate_hz=st.sampled_from([-1.0, 0.0, 40.0, 200.0, 1e9]))
        def arm(self, mode, rate_hz):
            arguments = {
                DeviceKind.CAMERA: (mode, rate_hz),
                DeviceKind.WAVE_PROBE: (),
                DeviceKind.TRIGGER_SOURCE: (rate_hz, 3),
            }[driver.kind]
            self.call("arm", lambda: self.bench.device.arm(*arguments))

        @precondition(lambda self: driver.kind is DeviceKind.CAMERA)
        @rule(index=st.integers(0, 9))
        def trigger(self, index):
            self.call("trigger", lambda: self.bench.device.trigger(index))

        @rule()
        def begin(self):
            self.host = StopSwitch()
            if driver.kind is DeviceKind.CAMERA:
                declared = self.call("capabilities", lambda: self.bench.device.capabilities)
                if declared is None:
                    return
                self.host = FrameSink(declared.rows, declared.columns)
            self.generator = self.call(
                "stream", lambda: getattr(self.bench.device, STREAMS[driver.kind])(self.host)
            )

        @precondition(lambda self: self.generator is not None)
        @rule()
        def step(self):
            waiting = self.bench.begin(lambda: next(self.generator, None))
            try:
                error = waiting.exception(0.5)
            except TimeoutError:  # it waits for a trigger that never comes
                self.host.stop()
                error = waiting.exception(WITHIN_S)
            assert error is None or isinstance(error, ThermacqError), repr(error)

        @rule()
        def stop(self):
            self.host.stop()

        def teardown(self):
            self.host.stop()
            with self.bench:
                pass

    return Machine


DRIVERS = list(plugins().drivers().values())


def run(driver, examples: int) -> None:
    run_state_machine_as_test(
        machine_for(driver),
        settings=settings(
            max_examples=examples,
            stateful_step_count=20,
            deadline=None,
            print_blob=False,
            report_multiple_bugs=False,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        ),
    )


@pytest.mark.slow
@pytest.mark.parametrize("driver", DRIVERS, ids=[driver.name for driver in DRIVERS])
def test_verbs_in_any_order(driver):
    run(driver, 12)


def test_an_untyped_error_in_some_order_is_found():
    class Forgetful(PatternCamera):
        def close(self):
            super().close()
            self.arm = None

    with pytest.raises(TypeError, match="not callable"):
        run(dataclasses.replace(DRIVER, make=Forgetful), 100)
