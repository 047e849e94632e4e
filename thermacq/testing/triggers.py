"""What holds for trigger sources: counting, the period and its grid, rates, stopping."""

from __future__ import annotations

from itertools import pairwise

from thermacq.devices import TriggerCapabilities, TriggerPulse
from thermacq.errors import ThermacqError
from thermacq.testing.bench import Bench, NotApplicable, StopSwitch, Subject, demand, demand_abort, demand_end
from thermacq.testing.streams import GENTLE_RATE_HZ, gentle_pulse_rate_hz, take_items


def pulses_are_counted_from_zero(subject: Subject) -> None:
    """Pulses carry 0, 1, 2 ... and rising host times, after every arming."""
    with subject.bench() as bench:
        bench.start()
        for start in ("first", "second"):
            bench.verb("arm", _gentle(bench), None)
            pulses = take_items(bench, "pulses", 6)
            bench.verb("disarm")
            for pulse in pulses:
                demand(
                    isinstance(pulse, TriggerPulse),
                    f"pulses() yielded a {type(pulse).__name__}: yield TriggerPulse",
                )
            indices = [pulse.index for pulse in pulses]
            demand(
                indices == list(range(len(indices))),
                f"after the {start} arm() the pulses are numbered {indices}",
            )
            demand(
                all(one.host_ns < two.host_ns for one, two in pairwise(pulses)),
                "host_ns does not rise from pulse to pulse",
            )


def the_asked_number_is_emitted(subject: Subject) -> None:
    """Armed for a number of pulses, the source emits exactly those and then ends by itself."""
    with subject.bench() as bench:
        bench.start()
        bench.verb("arm", _gentle(bench), 4)
        host = StopSwitch()
        pulses = bench.do("pulses()", lambda: list(bench.device.pulses(host)))
        demand(len(pulses) == 4, f"armed for 4 pulses it emitted {len(pulses)}")


def the_period_is_on_its_grid(subject: Subject) -> None:
    """The mean period is the asked one; one off the declared grid is moved to the grid, or refused."""
    with subject.bench() as bench:
        bench.start()
        declared: TriggerCapabilities = bench.capabilities
        rate_hz = min(GENTLE_RATE_HZ, declared.max_rate_hz)
        try:
            bench.do("arm()", lambda: bench.device.arm(rate_hz, None))
        except ThermacqError:
            rate_hz = _gentle(bench)
            bench.verb("arm", rate_hz, None)
        pulses = take_items(bench, "pulses", 20, 5.0)
        demand(len(pulses) >= 3, f"only {len(pulses)} pulses came in 5 s at {rate_hz:g} Hz")
        mean_s = (pulses[-1].host_ns - pulses[0].host_ns) / 1e9 / (len(pulses) - 1)
        wanted_s, step_s = 1 / rate_hz, declared.period_step_s
        if step_s > 0:
            wanted_s = max(1, round(wanted_s / step_s)) * step_s
        demand(
            abs(mean_s / wanted_s - 1) < 0.05,
            f"asked for {rate_hz:g} Hz, the mean period is {mean_s * 1e3:.4g} ms; the nearest period on the "
            f"declared grid is {wanted_s * 1e3:.4g} ms",
        )


def too_fast_is_refused(subject: Subject) -> None:
    """`arm` takes the declared highest rate and refuses more."""
    with subject.bench() as bench:
        bench.start()
        fastest_hz = bench.capabilities.max_rate_hz
        bench.refused(f"the declared max_rate_hz is {fastest_hz:g}", "arm", 2 * fastest_hz, None)
        bench.verb("arm", fastest_hz, None)


def waiting_for_a_pulse_can_be_aborted(subject: Subject) -> None:
    """A source that emits one pulse in ten seconds ends soon after the host asks it to."""
    with subject.bench() as bench:
        bench.start()
        try:
            bench.do("arm()", lambda: bench.device.arm(0.1, None))
        except ThermacqError as error:
            raise NotApplicable(f"it does not run this slowly: {error}") from None
        host = StopSwitch()
        generator = bench.device.pulses(host)
        bench.do("pulses()", lambda: next(generator), 15.0)
        demand_abort(bench, "pulses", host, generator)
        demand_end(bench, "pulses", host, generator)


def _gentle(bench: Bench) -> float:
    return gentle_pulse_rate_hz(bench.capabilities)
