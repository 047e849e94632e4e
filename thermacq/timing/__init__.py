"""Time: host clocks, frame pairing, device-clock models and the synchronisation report.

Arrays in, records out; nothing here touches a device or a file.
"""

from thermacq.timing.clock import NS_PER_S, Clock, ClockSettings, RealClock, VirtualClock, make_clock
from thermacq.timing.counters import lost_between, unwrap_counter
from thermacq.timing.line import (
    CameraEvidence,
    LineFrames,
    ProbeEvidence,
    TriggerLine,
    follow_line,
    line_of_probes,
)
from thermacq.timing.models import ClockModel, fit_clock, fit_clock_to_pulses
from thermacq.timing.pairing import FrameTimes, Pairs, frame_times_ns, pair_frames
from thermacq.timing.report import line_rows, skew_figures, sync_report
from thermacq.timing.restarts import (
    DeviceTimes,
    RestartedClock,
    fit_device_clock,
    fit_stretches,
    pulse_times_ns,
)

__all__ = [
    "NS_PER_S",
    "CameraEvidence",
    "Clock",
    "ClockModel",
    "ClockSettings",
    "DeviceTimes",
    "FrameTimes",
    "LineFrames",
    "Pairs",
    "ProbeEvidence",
    "RealClock",
    "RestartedClock",
    "TriggerLine",
    "VirtualClock",
    "fit_clock",
    "fit_clock_to_pulses",
    "fit_device_clock",
    "fit_stretches",
    "follow_line",
    "frame_times_ns",
    "line_of_probes",
    "line_rows",
    "lost_between",
    "make_clock",
    "pair_frames",
    "pulse_times_ns",
    "skew_figures",
    "sync_report",
    "unwrap_counter",
]
