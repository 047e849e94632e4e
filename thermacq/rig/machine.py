"""What this computer has for a recording: cores, memory, disk."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

LARGEST_RING_PART = 0.8
"""Part of the free memory that rings may take: the system would rather kill processes than refuse memory."""


@dataclass(frozen=True)
class Machine:
    """What the computer has: processor cores, bytes of memory and of disk that are free."""

    cores: int
    memory_bytes: int
    disk_bytes: int


def this_machine(folder: Path) -> Machine:
    """Measure this computer; `folder` says which disk."""
    return Machine(os.cpu_count() or 1, available_memory_bytes(), shutil.disk_usage(folder).free)


def available_memory_bytes() -> int:
    """Memory that can be had without swapping."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable":
            return int(value.split()[0]) * 1024
    return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
