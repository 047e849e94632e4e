"""Time: host clocks, frame pairing, device-clock models and the synchronisation report.

Arrays in, records out; nothing here touches a device or a file.
"""

from thermacq.timing.clock import Clock, ClockSettings, RealClock, VirtualClock, make_clock

__all__ = ["Clock", "ClockSettings", "RealClock", "VirtualClock", "make_clock"]
