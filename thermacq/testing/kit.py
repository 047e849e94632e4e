"""The kit for tests of one's own: which checks there are for which kind of device.

A check raises `Nonconformity`, whose message tells what to mend, or `NotApplicable` with the reason::

    for check in checks_for(driver.kind):
        check(Subject(driver))
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from thermacq.devices import DeviceKind
from thermacq.testing import cameras, faults, lifecycle, probes, triggers
from thermacq.testing.bench import Bench, Nonconformity, NotApplicable, Subject

__all__ = ["Bench", "Check", "Nonconformity", "NotApplicable", "Subject", "checks_for"]

Check: TypeAlias = Callable[[Subject], None]
"""A function whose docstring is the rule that it checks."""

_COMMON: tuple[Check, ...] = (
    lifecycle.identity,
    lifecycle.discovery,
    lifecycle.capabilities,
    lifecycle.settings_are_returned,
    lifecycle.unknown_settings_are_refused,
    lifecycle.stop_from_every_state,
    lifecycle.repeated_starts,
    lifecycle.nothing_is_left_behind,
    faults.disconnection,
    faults.timeout,
    faults.incomplete_frame,
    faults.overrun,
)
_BY_KIND: dict[DeviceKind, tuple[Check, ...]] = {
    DeviceKind.CAMERA: (
        cameras.frames_fill_the_buffer,
        cameras.counter_is_consistent,
        cameras.ticks_follow_the_declared_rate,
        cameras.host_times_are_of_the_hosts_clock,
        cameras.flags_and_temperatures_are_as_declared,
        cameras.software_triggers_give_their_index,
        cameras.trigger_returns_at_once,
        cameras.free_running_frames_have_no_trigger,
        cameras.only_declared_modes_are_accepted,
        cameras.frame_rates_are_kept_or_refused,
        cameras.waiting_for_a_trigger_can_be_aborted,
        cameras.waiting_for_a_slow_frame_can_be_aborted,
    ),
    DeviceKind.WAVE_PROBE: (
        probes.blocks_are_arrays_of_the_declared_shape,
        probes.blocks_are_short,
        probes.samples_are_counted,
        probes.ticks_follow_the_declared_rate,
        probes.sampling_can_be_aborted,
    ),
    DeviceKind.TRIGGER_SOURCE: (
        triggers.pulses_are_counted_from_zero,
        triggers.the_asked_number_is_emitted,
        triggers.the_period_is_on_its_grid,
        triggers.too_fast_is_refused,
        triggers.waiting_for_a_pulse_can_be_aborted,
    ),
}


def checks_for(kind: DeviceKind) -> tuple[Check, ...]:
    """All checks for one kind of device."""
    return _COMMON + _BY_KIND[kind]
