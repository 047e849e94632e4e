"""What holds when a device fails: the typed error, in time, naming the device, and leaving it closable.

Only drivers whose record, or whose emulator's, names settings that act out a fault can be checked
(``Driver.faults``, ``Emulator.faults``).
"""

from __future__ import annotations

import time
from typing import Any

from thermacq.devices import DeviceKind, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.testing.bench import (
    DEVICE_NAME,
    Bench,
    Nonconformity,
    NotApplicable,
    StopSwitch,
    Subject,
    demand,
    demand_end,
)
from thermacq.testing.streams import FrameSink, begin, sensible_mode

COMES_WITHIN_S = 10.0


def disconnection(subject: Subject) -> None:
    """A device that is unplugged raises `DeviceDisconnected`."""
    _act_out(subject, DeviceDisconnected)


def timeout(subject: Subject) -> None:
    """A device that falls silent raises `DeviceTimeout`."""
    _act_out(subject, DeviceTimeout)


def incomplete_frame(subject: Subject) -> None:
    """A frame or block that arrives short raises `IncompleteFrame`, and the stream goes on."""
    _act_out(subject, IncompleteFrame)


def overrun(subject: Subject) -> None:
    """Data lost to a late host raises `DeviceOverrun`, and the stream goes on."""
    _act_out(subject, DeviceOverrun)


def _act_out(subject: Subject, kind: type[DeviceFault]) -> None:
    """Run until the fault comes, then check it, and what can be done after it."""
    if kind not in subject.faults:
        raise NotApplicable(
            f"the driver declares no settings that act out {kind.__name__} (Driver.faults), nor does an emulator"
        )
    with subject.bench(kind) as bench:
        bench.start()
        begin(subject.driver.kind, bench)
        host, stream = _host(subject.driver.kind, bench)
        generator = stream()
        fault = bench.do(
            "the stream", lambda: _run_to_fault(subject, bench, host, generator, kind), 2 * COMES_WITHIN_S
        )
        demand(fault.device == DEVICE_NAME, f"the fault names '{fault.device}': pass context.name")
        demand(bool(fault.stage), "the fault does not say at which stage it happened")
        if kind in (IncompleteFrame, DeviceOverrun):
            after = stream()
            bench.do("the stream after the fault", lambda: _step(subject, bench, after, 0))
            demand_end(bench, "the stream", host, after)
        bench.verb("disarm")


def _run_to_fault(
    subject: Subject, bench: Bench, host: StopSwitch, generator: Any, kind: type[DeviceFault]
) -> DeviceFault:
    deadline_s = time.monotonic() + COMES_WITHIN_S
    index = 0
    while time.monotonic() < deadline_s:
        try:
            _step(subject, bench, generator, index)
        except kind as fault:
            return fault
        except Exception as error:
            raise Nonconformity(f"expected {kind.__name__}, got {type(error).__name__}: {error}") from error
        if isinstance(host, FrameSink):
            host.advance()
        index += 1
    raise Nonconformity(
        f"{kind.__name__} did not come within {COMES_WITHIN_S:g} s although the device acts it out"
    )


def _step(subject: Subject, bench: Bench, generator: Any, index: int) -> None:
    """One item, as the host asks for it; a software trigger comes first where the camera needs one."""
    if subject.driver.kind is DeviceKind.CAMERA and _needs_triggers(bench):
        bench.device.trigger(index)
    if next(generator, None) is None:
        raise Nonconformity("the stream ended although the host did not ask it to")


def _needs_triggers(bench: Bench) -> bool:
    return sensible_mode(bench.device.capabilities) is TriggerMode.SOFTWARE


def _host(kind: DeviceKind, bench: Bench) -> tuple[StopSwitch, Any]:
    """The host's side, and a function that makes a new generator of the device."""
    if kind is DeviceKind.CAMERA:
        capabilities = bench.capabilities
        sink = FrameSink(capabilities.rows, capabilities.columns)
        return sink, lambda: bench.device.frames(sink)
    host = StopSwitch()
    verb = "samples" if kind is DeviceKind.WAVE_PROBE else "pulses"
    return host, lambda: getattr(bench.device, verb)(host)
