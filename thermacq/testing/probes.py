"""What holds for wave probes: blocks, their sizes, their counting and their clock."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from thermacq.devices import ProbeCapabilities, SampleBlock
from thermacq.testing.bench import Bench, Subject, demand, demand_abort, demand_end
from thermacq.testing.bench import StopSwitch as Host
from thermacq.testing.streams import demand_same_pace, take_items

LONGEST_BLOCK_S = 0.25


def blocks_are_arrays_of_the_declared_shape(subject: Subject) -> None:
    """Values are (samples, channels) float64, ticks (samples,) int64, pulse ticks (pulses,) int64."""
    with subject.bench() as bench:
        declared, blocks = _take(bench, 0.4)
        channels = len(declared.channels)
        for block in blocks:
            demand(
                isinstance(block, SampleBlock),
                f"samples() yielded a {type(block).__name__}: yield SampleBlock",
            )
            values, ticks, pulses = block.values, block.ticks, block.pulse_ticks
            demand(
                values.ndim == 2 and values.shape[1] == channels and values.dtype == np.float64,
                f"values is {values.shape} {values.dtype}: make it (samples, {channels}) float64",
            )
            demand(len(values) > 0, "a block holds no samples: wait for some before yielding")
            demand(
                ticks.shape == (len(values),) and ticks.dtype == np.int64,
                f"ticks is {ticks.shape} {ticks.dtype}: make it ({len(values)},) int64",
            )
            demand(
                pulses.ndim == 1 and pulses.dtype == np.int64,
                f"pulse_ticks is {pulses.shape} {pulses.dtype}: make it (pulses,) int64",
            )
            demand(
                declared.has_trigger_line or len(pulses) == 0,
                "pulse_ticks holds pulses but has_trigger_line is False",
            )


def blocks_are_short(subject: Subject) -> None:
    """A block spans at most 0.25 s, so that whoever watches sees the water move."""
    with subject.bench() as bench:
        declared, blocks = _take(bench, 0.6)
        if declared.tick_rate_hz > 0:
            spans_s = [int(block.ticks[-1] - block.ticks[0]) / declared.tick_rate_hz for block in blocks]
        else:
            spans_s = [(two.host_ns - one.host_ns) / 1e9 for one, two in pairwise(blocks)]
        longest_s = max(spans_s, default=0.0)
        slack_s = 0.01 if declared.tick_rate_hz > 0 else 0.5
        demand(
            longest_s <= LONGEST_BLOCK_S + slack_s,
            f"a block spans {longest_s:.3g} s: yield at least every {LONGEST_BLOCK_S} s",
        )


def samples_are_counted(subject: Subject) -> None:
    """`first_index` counts the samples since arming, so that lost ones show as a jump."""
    with subject.bench() as bench:
        for start in ("first", "second"):
            _, blocks = _take(bench, 0.6)
            demand(
                blocks[0].first_index == 0,
                f"after the {start} arm() first_index starts at {blocks[0].first_index}: count from 0",
            )
            for one, two in pairwise(blocks):
                expected = one.first_index + len(one.values)
                demand(
                    two.first_index >= expected,
                    f"first_index is {two.first_index} after a block that ends at {expected}",
                )
            delivered = sum(len(block.values) for block in blocks)
            counted = blocks[-1].first_index + len(blocks[-1].values)
            demand(counted < 2 * delivered, f"of {counted} counted samples only {delivered} were delivered")


def ticks_follow_the_declared_rate(subject: Subject) -> None:
    """Ticks rise, a second of host time is a second of ticks (within 25 %), and no sample is faster than declared."""
    with subject.bench() as bench:
        declared, blocks = _take(bench, 0.4)
        ticks = np.concatenate([block.ticks for block in blocks])
        if declared.tick_rate_hz == 0:
            demand(bool(np.all(ticks == -1)), "tick_rate_hz is 0: give ticks of -1, or declare the rate")
            return
        steps = np.diff(ticks)
        demand(bool(np.all(steps > 0)), "ticks do not rise from sample to sample")
        rate_hz = declared.tick_rate_hz / float(np.median(steps))
        demand(
            rate_hz < 1.02 * declared.max_sample_rate_hz,
            f"by its ticks it samples at {rate_hz:.4g} Hz, above max_sample_rate_hz {declared.max_sample_rate_hz:g}",
        )
        demand_same_pace(declared.tick_rate_hz, lambda: _pace(bench, declared.tick_rate_hz))


def sampling_can_be_aborted(subject: Subject) -> None:
    """A probe ends soon after the host asks it to."""
    with subject.bench() as bench:
        bench.start()
        bench.verb("arm")
        host = Host()
        generator = bench.device.samples(host)
        demand_abort(bench, "samples", host, generator)
        demand_end(bench, "samples", host, generator)


def _pace(bench: Bench, tick_rate_hz: float) -> tuple[float, float]:
    """Seconds that passed by the ticks and by the host's clock while the probe sampled."""
    _, blocks = _take(bench, 1.0)
    ticks = int(blocks[-1].ticks[-1] - blocks[0].ticks[-1])
    return ticks / tick_rate_hz, (blocks[-1].host_ns - blocks[0].host_ns) / 1e9


def _take(bench: Bench, for_s: float) -> tuple[ProbeCapabilities, list[SampleBlock]]:
    """Start the probe, sample for some time, stop it."""
    bench.start()
    bench.verb("arm")
    blocks = take_items(bench, "samples", 10**6, for_s)
    bench.verb("disarm")
    demand(len(blocks) >= 2, f"only {len(blocks)} blocks came in {for_s:g} s")
    return bench.capabilities, blocks
