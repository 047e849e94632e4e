"""The conformance checks of probes and trigger sources: good ones pass, each broken one fails its check."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict

from thermacq.devices import (
    DeviceIdentity,
    DeviceKind,
    ProbeCapabilities,
    SampleBlock,
    TriggerCapabilities,
    TriggerPulse,
)
from thermacq.errors import DeviceDisconnected, DeviceFault
from thermacq.hooks import Driver, Evidence
from thermacq.settings import check_settings
from thermacq.testing import bench as bench_module
from thermacq.testing import faults, probes, triggers
from thermacq.testing.kit import Nonconformity, Subject, checks_for

RATE_HZ = 200.0


class Settings(BaseModel):
    model_config = ConfigDict(extra="forbid")
    fail_after: int = -1


class _Device:
    """What the good probe and the good source share."""

    driver = ""

    def __init__(self, context) -> None:
        self.name, self.clock = context.name, context.clock
        self.settings, self.armed = Settings(), False

    def open(self) -> DeviceIdentity:
        return DeviceIdentity(self.driver, "good", "1")

    def configure(self, settings: Mapping) -> Mapping:
        self.settings = check_settings(Settings, settings, self.name)
        return self.settings.model_dump()

    def disarm(self) -> None:
        self.armed = False

    def close(self) -> None:
        self.disarm()

    def wait(self, seconds: float, host) -> None:
        self.clock.wait_until_ns(self.clock.now_ns() + round(seconds * 1e9), host.stopping)


class Probe(_Device):
    driver = "good-probe"
    capabilities = ProbeCapabilities(("near", "far"), "V", RATE_HZ, tick_rate_hz=1e6)
    block_s = 0.1

    def arm(self) -> None:
        self.armed, self.sent = True, 0

    def samples(self, host):
        number = round(self.block_s * RATE_HZ)
        while self.armed and not host.stopping():
            if self.sent == self.settings.fail_after:
                raise DeviceDisconnected(self.name, "acquire", "gone")
            self.wait(self.block_s, host)
            index = self.sent * number
            ticks = (np.arange(index, index + number) * 1e6 / RATE_HZ).astype(np.int64)
            self.sent += 1
            yield SampleBlock(np.zeros((number, 2)), ticks, index, self.clock.now_ns())


class Source(_Device):
    driver = "good-source"
    capabilities = TriggerCapabilities(max_rate_hz=500.0, period_step_s=1e-3)

    def arm(self, rate_hz: float, count) -> None:
        if rate_hz > self.capabilities.max_rate_hz:
            raise DeviceFault(self.name, "arm", "too fast")
        self.armed, self.left = True, count
        self.period_ns = round(1e3 / rate_hz) * 1_000_000

    def pulses(self, host):
        index, start_ns = 0, self.clock.now_ns()
        while self.armed and self.left != index and not host.stopping():
            if index == self.settings.fail_after:
                raise DeviceDisconnected(self.name, "acquire", "gone")
            due_ns = start_ns + index * self.period_ns
            self.clock.wait_until_ns(due_ns, host.stopping)
            if not host.stopping():
                yield TriggerPulse(index, due_ns)
                index += 1


def subject(device: type[_Device]) -> Subject:
    kind = DeviceKind.WAVE_PROBE if issubclass(device, Probe) else DeviceKind.TRIGGER_SOURCE
    gone = {DeviceDisconnected: {"fail_after": 2}}
    return Subject(Driver(device.driver, kind, "", Evidence.SIMULATED, device, lambda: Settings, faults=gone))


def checks_of(device: type[_Device]):
    not_declared = {faults.timeout, faults.incomplete_frame, faults.overrun}
    return [(check, device) for check in checks_for(subject(device).driver.kind) if check not in not_declared]


@pytest.mark.parametrize(
    ("check", "device"),
    checks_of(Probe) + checks_of(Source),
    ids=lambda value: value.__name__,
)
def test_good_devices_pass(check, device):
    check(subject(device))


def probe(**overrides) -> type[Probe]:
    return type("Bent", (Probe,), overrides)


def blocks(change) -> type[Probe]:
    def samples(self, host):
        for block in Probe.samples(self, host):
            fields = {name: getattr(block, name) for name in SampleBlock.__slots__}
            yield SampleBlock(**{**fields, **change(block)})

    return probe(samples=samples)


def source(**overrides) -> type[Source]:
    return type("Bent", (Source,), overrides)


def deaf(verb):
    def stream(self, host):
        yield from (item for item, _ in zip(verb(self, host), range(1), strict=False))
        time.sleep(3.0)

    return stream


def declared(**changes) -> dict:
    return {"capabilities": ProbeCapabilities(**{**vars(Probe.capabilities), **changes})}


def one_more(self, rate_hz, count):
    Source.arm(self, rate_hz, None if count is None else count + 1)


def half_rate(self, rate_hz, count):
    Source.arm(self, rate_hz / 2, count)


def any_rate(self, rate_hz, count):
    Source.arm(self, min(rate_hz, 500.0), count)


def numbered_from_one(self, host):
    return (TriggerPulse(pulse.index + 1, pulse.host_ns) for pulse in Source.pulses(self, host))


def stuck_time(self, host):
    return (TriggerPulse(pulse.index, 5) for pulse in Source.pulses(self, host))


def bare_numbers(self, host):
    return (pulse.index for pulse in Source.pulses(self, host))


shape = probes.blocks_are_arrays_of_the_declared_shape
rate = probes.ticks_follow_the_declared_rate
BROKEN = [
    (shape, blocks(lambda block: {"values": block.values[:, 0]}), r"make it \(samples, 2\) float64"),
    (shape, blocks(lambda block: {"values": block.values.astype(np.float32)}), "float32: make it"),
    (shape, blocks(lambda block: {"ticks": block.ticks[:-1]}), r"ticks is \(19,\) int64: make it \(20,\)"),
    (shape, blocks(lambda block: {"values": np.empty((0, 2)), "ticks": block.ticks[:0]}), "holds no samples"),
    (shape, blocks(lambda block: {"pulse_ticks": np.zeros(1)}), r"make it \(pulses,\) int64"),
    (shape, blocks(lambda block: {"pulse_ticks": block.ticks[:1]}), "has_trigger_line is False"),
    (shape, probe(samples=lambda self, host: (0 for _ in Probe.samples(self, host))), "yielded a int"),
    (probes.blocks_are_short, probe(block_s=0.5), "yield at least every 0.25 s"),
    (probes.samples_are_counted, blocks(lambda block: {"first_index": block.first_index + 7}), "starts at 7"),
    (probes.samples_are_counted, blocks(lambda block: {"first_index": 0}), "first_index is 0 after a block"),
    (probes.samples_are_counted, blocks(lambda block: {"first_index": 9 * block.first_index}), "only"),
    (rate, blocks(lambda block: {"ticks": block.ticks * 0}), "do not rise"),
    (rate, blocks(lambda block: {"ticks": block.ticks // 2}), "above max_sample_rate_hz"),
    (rate, probe(**declared(tick_rate_hz=1e4, max_sample_rate_hz=1e9)), "at which the device counts"),
    (rate, probe(**declared(tick_rate_hz=0.0)), "ticks of -1"),
    (
        probes.sampling_can_be_aborted,
        probe(samples=deaf(lambda self, host: iter(()))),
        "did not return within",
    ),
    (triggers.pulses_are_counted_from_zero, source(pulses=numbered_from_one), r"numbered \[1, 2"),
    (triggers.pulses_are_counted_from_zero, source(pulses=stuck_time), "does not rise"),
    (triggers.pulses_are_counted_from_zero, source(pulses=bare_numbers), "yield TriggerPulse"),
    (triggers.the_asked_number_is_emitted, source(arm=one_more), "armed for 4 pulses it emitted 5"),
    (triggers.the_period_is_on_its_grid, source(arm=half_rate), "the mean period is 67 ms"),
    (triggers.too_fast_is_refused, source(arm=any_rate), "the declared max_rate_hz is 500"),
    (
        triggers.waiting_for_a_pulse_can_be_aborted,
        source(pulses=deaf(Source.pulses)),
        "did not return within",
    ),
    (
        faults.disconnection,
        source(configure=lambda self, settings: dict(settings)),
        "did not come within 1 s",
    ),
]


@pytest.mark.parametrize(
    ("check", "device", "message"),
    BROKEN,
    ids=[f"{check.__name__}-{message[:24]}" for check, _, message in BROKEN],
)
def test_a_broken_device_fails_and_is_told_what_to_mend(check, device, message, monkeypatch):
    monkeypatch.setattr(bench_module, "STOP_TIMEOUT_S", 1.0)
    monkeypatch.setattr(faults, "COMES_WITHIN_S", 1.0)
    with pytest.raises(Nonconformity, match=message):
        check(subject(device))


@pytest.mark.parametrize("kind", [DeviceKind.WAVE_PROBE, DeviceKind.TRIGGER_SOURCE])
def test_every_check_of_its_own_has_a_device_that_fails_it(kind):
    own = {check for check in checks_for(kind) if check.__module__ in (probes.__name__, triggers.__name__)}
    assert own - {check for check, _, _ in BROKEN} == set()
