"""Is this computer fit to record? Libraries, permissions, USB, network, clock, disk, priority, each with its remedy.

`examine` looks at everything and changes nothing but a test file that it removes.
"""

from thermacq.doctor.checks import PAPER_BYTES_PER_S, examine, plugin_failures
from thermacq.doctor.findings import Check, Verdict
from thermacq.doctor.usb_bus import udev_rules

__all__ = ["PAPER_BYTES_PER_S", "Check", "Verdict", "examine", "plugin_failures", "udev_rules"]
