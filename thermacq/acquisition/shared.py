"""Memory shared between the processes of one recording, which vanishes with the last of them.

A block is an anonymous file in memory that spawned children inherit. It has no name, so that nothing is left
behind however its processes end, and no tracker is needed to clean up. It can be sized after the children
were spawned: how large a ring must be is only known once its camera is open.
"""

from __future__ import annotations

import mmap
import os
from multiprocessing.reduction import DupFd
from typing import Any

from thermacq.errors import AcquisitionError
from thermacq.rig.machine import LARGEST_RING_PART, available_memory_bytes


class SharedBlock:
    """A block of memory. Pickling it, possible only while a process is being spawned, shares it."""

    def __init__(self) -> None:
        self._fd = os.memfd_create("thermacq")

    def allocate(self, size: int) -> None:
        """Give the block its size in bytes, once.

        Raises
        ------
        AcquisitionError
            There is not enough memory.
        """
        # Asked first, because the system would rather kill processes than refuse memory.
        if size > LARGEST_RING_PART * available_memory_bytes():
            raise AcquisitionError(
                f"there is no room in memory for a ring of {size / 1e6:.0f} MB",
                remedy="Shorten `ring_s` in the rig's [store] table, or close other programs.",
            )
        # All pages at once: no fault, and no surprise, when a frame comes.
        os.posix_fallocate(self._fd, 0, size)

    def map(self) -> mmap.mmap:
        """Map the whole block, readable and writable."""
        return mmap.mmap(self._fd, os.fstat(self._fd).st_size)

    def close(self) -> None:
        """Let go of the block; what is mapped stays mapped."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __getstate__(self) -> Any:
        return DupFd(self._fd)

    def __setstate__(self, state: Any) -> None:
        self._fd = state.detach()
