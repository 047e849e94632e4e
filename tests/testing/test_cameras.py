"""The conformance checks of cameras: each broken camera fails the check whose rule it breaks."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import threading
import time
from multiprocessing import shared_memory
from pathlib import Path

import numpy as np
import pytest

from thermacq.devices import DeviceIdentity, FrameFlag, TriggerMode
from thermacq.errors import DeviceFault, DeviceTimeout
from thermacq.testing import bench as bench_module
from thermacq.testing import cameras, faults, lifecycle
from thermacq.testing.kit import Nonconformity, NotApplicable, Subject, checks_for
from thermacq_drivers.simflume.exposures import SoftwareTriggers
from thermacq_drivers.testpattern import DRIVER, PatternCamera

SMALL = {"rows": 24, "columns": 32}
LEFTOVERS: list = []


def subject(camera=PatternCamera, **changes) -> Subject:
    return Subject(dataclasses.replace(DRIVER, make=camera, **changes), SMALL)


def bent(**overrides) -> type[PatternCamera]:
    """A test-pattern camera with some verbs replaced."""
    return type("Bent", (PatternCamera,), overrides)


def declaring(**changes) -> type[PatternCamera]:
    """A test-pattern camera that declares other capabilities than it has."""
    declared = PatternCamera.capabilities
    return bent(capabilities=property(lambda self: dataclasses.replace(declared.fget(self), **changes)))


def yielding(change) -> type[PatternCamera]:
    """A test-pattern camera whose frames were changed on the way."""

    def frames(self, host):
        for frame in PatternCamera.frames(self, host):
            yield change(frame)

    return bent(frames=frames)


def setting(**changes):
    return yielding(lambda frame: dataclasses.replace(frame, **changes))


def deaf_frames(self, host):
    """Waits without looking at host.stopping()."""
    time.sleep(3.0)
    yield from PatternCamera.frames(self, host)


def endless_frames(self, host):
    counts = host.buffer()
    for frame in PatternCamera.frames(self, _never_stopping(host)):
        counts[:] = frame.counts
        yield frame


def _never_stopping(host):
    host.stopping = lambda: False
    return host


def half_filled(self, host):
    for frame in PatternCamera.frames(self, host):
        frame.counts[12:] = 0xA5C3
        yield frame


def raising(error):
    def verb(self, *arguments):
        raise error

    return verb


def buggy_frames(self, host):
    raise KeyError("exposure")
    yield


def early_end(self, host):
    yield from (frame for _, frame in zip(range(1), PatternCamera.frames(self, host), strict=False))


def armed_once(self, mode, frame_rate_hz):
    if getattr(self, "was_armed", False):
        raise DeviceFault("under-test", "arm", "already armed once")
    self.was_armed = True
    PatternCamera.arm(self, mode, frame_rate_hz)


def strict_disarm(self):
    if self._exposures is None:
        raise DeviceFault("under-test", "disarm", "not armed")
    PatternCamera.disarm(self)


def leaving(make):
    def open_(self):
        LEFTOVERS.append(make())
        return PatternCamera.open(self)

    return bent(open=open_)


def left_thread():
    done = threading.Event()
    threading.Thread(target=done.wait, name="reader", daemon=True).start()
    return done.set


def left_file():
    descriptor = os.open(os.devnull, os.O_RDONLY)
    return lambda: os.close(descriptor)


def left_block():
    block = shared_memory.SharedMemory(create=True, size=64)
    block.buf[0] = 1

    def remove():
        block.close()
        block.unlink()

    return remove


def left_process():
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])

    def end():
        child.kill()
        child.wait()

    return end


@pytest.fixture
def clean_up():
    yield
    while LEFTOVERS:
        LEFTOVERS.pop()()


def changing_serial(self):
    self.times = getattr(self, "times", 0) + 1
    return DeviceIdentity("test-pattern", "m", str(self.times))


def deaf_to_unknown(self, settings):
    known = {key: value for key, value in settings.items() if key != "no_such_setting"}
    return PatternCamera.configure(self, known)


def value_error_on_unknown(self, settings):
    if "no_such_setting" in settings:
        raise ValueError("no_such_setting")
    return PatternCamera.configure(self, settings)


def any_rate(self, mode, frame_rate_hz):
    PatternCamera.arm(self, mode, min(frame_rate_hz, 1000.0))


def half_rate(self, mode, frame_rate_hz):
    if frame_rate_hz > 1000:
        raise DeviceFault("under-test", "arm", "too fast")
    PatternCamera.arm(self, mode, frame_rate_hz / 2)


def lost_index(self, index):
    PatternCamera.trigger(self, index + 1)


def slow_trigger(self, index):
    time.sleep(1.1)
    PatternCamera.trigger(self, index)


def untriggered(self, host):
    if isinstance(self._exposures, SoftwareTriggers):
        self.trigger(0)
    return PatternCamera.frames(self, host)


no_trigger = property(raising(AttributeError("trigger")))

BROKEN = [
    (lifecycle.identity, bent(open=lambda self: None), "return a DeviceIdentity"),
    (lifecycle.identity, bent(open=lambda self: DeviceIdentity("other", "m", "1")), "make it 'test-pattern'"),
    (lifecycle.identity, bent(open=lambda self: DeviceIdentity("test-pattern", "", "1")), "name the model"),
    (lifecycle.identity, bent(open=changing_serial), "opened again, the device calls itself"),
    (lifecycle.identity, bent(open=raising(OSError("no bus"))), r"open\(\) failed: OSError: no bus"),
    (lifecycle.capabilities, bent(trigger=no_trigger), "lacks a verb of Camera"),
    (lifecycle.capabilities, bent(capabilities={}), "return CameraCapabilities"),
    (lifecycle.capabilities, declaring(columns=0), "columns must be greater than 0"),
    (lifecycle.capabilities, declaring(line_time_s=float("nan")), "line_time_s is nan"),
    (lifecycle.capabilities, declaring(trigger_modes=frozenset()), "trigger_modes is empty"),
    (lifecycle.settings_are_returned, bent(configure=lambda self, s: None), "returned None"),
    (lifecycle.settings_are_returned, bent(configure=lambda self, s: s), "what it applied for: counter_bits"),
    (
        lifecycle.settings_are_returned,
        bent(configure=lambda self, s: {**PatternCamera.configure(self, s), "rows": Path("x")}),
        "values that no file can hold",
    ),
    (
        lifecycle.settings_are_returned,
        bent(configure=lambda self, s: {**PatternCamera.configure(self, s), "rows": s["rows"] * 2}),
        "configured with what it applied",
    ),
    (lifecycle.unknown_settings_are_refused, bent(configure=deaf_to_unknown), "was accepted: refuse unknown"),
    (lifecycle.unknown_settings_are_refused, bent(configure=value_error_on_unknown), "see as a traceback"),
    (lifecycle.stop_from_every_state, bent(disarm=strict_disarm), r"in state 'made', disarm\(\) failed"),
    (lifecycle.stop_from_every_state, bent(close=raising(OSError("gone"))), r"close\(\) failed: OSError"),
    (lifecycle.repeated_starts, bent(arm=armed_once), "start 2 after opening for the first time"),
    (lifecycle.repeated_starts, bent(frames=early_end), "ended although the host did not ask"),
    (lifecycle.repeated_starts, bent(frames=buggy_frames), "raised KeyError"),
    (lifecycle.repeated_starts, bent(frames=endless_frames), "still yields"),
    (lifecycle.nothing_is_left_behind, leaving(left_thread), r"threads: reader"),
    (lifecycle.nothing_is_left_behind, leaving(left_file), r"open files: /dev/null"),
    (lifecycle.nothing_is_left_behind, leaving(left_block), r"shared memory: /dev/shm/"),
    (lifecycle.nothing_is_left_behind, leaving(left_process), r"processes: \d+"),
    (cameras.frames_fill_the_buffer, setting(counts=np.zeros((24, 32), np.uint16)), "is not the buffer"),
    (cameras.frames_fill_the_buffer, setting(counts=np.zeros((32, 24), np.uint16)), r"is \(32, 24\) uint16"),
    (cameras.frames_fill_the_buffer, yielding(lambda frame: frame.counts), "yielded a ndarray"),
    (cameras.frames_fill_the_buffer, bent(frames=half_filled), "12 rows of the buffer were left"),
    (cameras.frames_fill_the_buffer, declaring(bit_depth=12), "declared bit_depth of 12"),
    (cameras.counter_is_consistent, declaring(counter_bits=0), "counter_bits is 0"),
    (cameras.counter_is_consistent, declaring(counter_bits=8), "do not fit in the declared 8 bits"),
    (cameras.counter_is_consistent, declaring(counter_bits=32), "the width at which the device really wraps"),
    (cameras.counter_is_consistent, setting(counter=7), "from 7 to 7"),
    (cameras.ticks_follow_the_declared_rate, declaring(tick_rate_hz=0.0), "tick_rate_hz is 0"),
    (cameras.ticks_follow_the_declared_rate, declaring(tick_rate_hz=1e9), "at which the device counts"),
    (cameras.ticks_follow_the_declared_rate, setting(ticks=3), "ticks goes from 3 to 3"),
    (
        cameras.host_times_are_of_the_hosts_clock,
        yielding(lambda frame: dataclasses.replace(frame, host_ns=time.time_ns())),
        "use context.clock.now_ns",
    ),
    (
        cameras.flags_and_temperatures_are_as_declared,
        declaring(has_temperature=True),
        "has_temperature is True",
    ),
    (
        cameras.flags_and_temperatures_are_as_declared,
        setting(fpa_temperature_k=300.0),
        "has_temperature is False",
    ),
    (
        cameras.flags_and_temperatures_are_as_declared,
        setting(flags=FrameFlag.SHUTTER),
        "has_shutter is False",
    ),
    (cameras.software_triggers_give_their_index, bent(trigger=lost_index), r"trigger_index \[1, 2, 3, 6"),
    (cameras.trigger_returns_at_once, bent(trigger=slow_trigger), "return at once"),
    (cameras.free_running_frames_have_no_trigger, setting(trigger_index=4), r"trigger_index \[4\]: give -1"),
    (
        cameras.only_declared_modes_are_accepted,
        declaring(trigger_modes=frozenset({TriggerMode.FREE_RUN})),
        "declare the mode",
    ),
    (cameras.frame_rates_are_kept_or_refused, bent(arm=any_rate), "declared max_frame_rate_hz is 1000"),
    (cameras.frame_rates_are_kept_or_refused, bent(arm=half_rate), "the camera makes 500"),
    (cameras.waiting_for_a_trigger_can_be_aborted, bent(frames=deaf_frames), "did not return within 1 s"),
    (cameras.waiting_for_a_trigger_can_be_aborted, bent(frames=untriggered), "without a trigger"),
    (cameras.waiting_for_a_slow_frame_can_be_aborted, bent(frames=deaf_frames), "bound every wait"),
    (faults.disconnection, bent(_act_out_fault=lambda self, number, host: None), "did not come within"),
    (
        faults.timeout,
        bent(_act_out_fault=raising(RuntimeError("usb"))),
        "DeviceTimeout, got RuntimeError",
    ),
    (faults.timeout, bent(_act_out_fault=raising(DeviceTimeout("x", "acquire", "s"))), "names 'x'"),
    (
        faults.disconnection,
        bent(_act_out_fault=raising(DeviceTimeout("x", "a", "s"))),
        "got DeviceTimeout",
    ),
    (
        faults.incomplete_frame,
        bent(_act_out_fault=raising(DeviceTimeout("x", "a", "s"))),
        "got DeviceT",
    ),
    (faults.overrun, bent(_act_out_fault=raising(OSError("late"))), "DeviceOverrun, got OSError"),
]


@pytest.mark.usefixtures("clean_up")
@pytest.mark.parametrize(
    ("check", "camera", "message"),
    BROKEN,
    ids=[f"{check.__name__}-{message[:24]}" for check, _, message in BROKEN],
)
def test_a_broken_camera_fails_and_is_told_what_to_mend(check, camera, message, monkeypatch):
    monkeypatch.setattr(bench_module, "STOP_TIMEOUT_S", 1.0)
    monkeypatch.setattr(faults, "COMES_WITHIN_S", 1.0)
    monkeypatch.setattr(lifecycle, "SETTLE_S", 0.2)
    with pytest.raises(Nonconformity, match=message):
        check(subject(camera))


def test_every_check_has_a_camera_that_fails_it():
    broken = {check for check, _, _ in BROKEN} | {lifecycle.discovery}
    assert set(checks_for(DRIVER.kind)) - broken == set()


def test_a_discovery_that_raises_fails():
    with pytest.raises(Nonconformity, match="return an empty list when nothing is there"):
        lifecycle.discovery(subject(discover=raising(OSError("no bus")).__get__(DRIVER)))
    with pytest.raises(Nonconformity, match="list DeviceIdentity records"):
        lifecycle.discovery(subject(discover=lambda transports: ["camera 1"]))


@pytest.mark.parametrize(
    "check", [faults.disconnection, faults.timeout, faults.incomplete_frame, faults.overrun]
)
def test_faults_that_no_setting_acts_out_are_skipped_with_the_reason(check):
    with pytest.raises(NotApplicable, match="declares no settings"):
        check(subject(faults={}))


def test_modes_that_are_not_declared_are_skipped_with_the_reason():
    def only(mode):
        def arm(self, asked, rate_hz):
            if asked != mode:
                raise DeviceFault("under-test", "arm", "no such mode")
            PatternCamera.arm(self, asked, rate_hz)

        return subject(type("Only", (declaring(trigger_modes=frozenset({mode})),), {"arm": arm}))

    free, soft = only(TriggerMode.FREE_RUN), only(TriggerMode.SOFTWARE)
    for check, camera in (
        (cameras.software_triggers_give_their_index, free),
        (cameras.trigger_returns_at_once, free),
        (cameras.waiting_for_a_trigger_can_be_aborted, free),
        (cameras.free_running_frames_have_no_trigger, soft),
        (cameras.waiting_for_a_slow_frame_can_be_aborted, soft),
    ):
        with pytest.raises(NotApplicable, match=r"is not declared|no triggered mode"):
            check(camera)
    cameras.only_declared_modes_are_accepted(soft)
    cameras.frames_fill_the_buffer(soft)
    with pytest.raises(NotApplicable, match="hardware line"):
        cameras.frames_fill_the_buffer(subject(declaring(trigger_modes=frozenset({TriggerMode.HARDWARE}))))
