"""The checks: each a function that looks at one thing and returns what it found and what to do.

Facts are read below `root`, so that tests can bring their own ``/proc`` and ``/sys``.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from thermacq.doctor import usb_bus
from thermacq.doctor.findings import Check, Verdict, read
from thermacq.hooks import Driver

ROOT = Path("/")
# Two cameras of the paper: 2 x 640 x 512 x 2 bytes x 50 frames/s.
PAPER_BYTES_PER_S = 2 * 640 * 512 * 2 * 50
_SOCKET_BYTES = 4 * 1024 * 1024
_USBFS_MB = 64
_DISK_TEST_BYTES = 128 * 1024 * 1024
_CHUNK_BYTES = 4 * 1024 * 1024
_SPARE_CORES = 2


def examine(
    drivers: Sequence[Driver], folder: Path, needed_bytes_per_s: float = PAPER_BYTES_PER_S, root: Path = ROOT
) -> list[Check]:
    """Look at everything.

    Parameters
    ----------
    drivers
        Drivers whose devices shall work here.
    folder
        Where runs will be written; a test file is written there and removed.
    needed_bytes_per_s
        Rate at which the cameras will deliver.
    root
        Where ``/proc``, ``/sys`` and ``/dev`` stand.
    """
    return [
        *libraries(),
        *usb_bus.permissions(drivers, root),
        *usb_bus.shared_buses(drivers, root),
        usb_memory(root),
        socket_memory(root),
        clock_source(root),
        power_saving(root),
        realtime_priority(),
        cores(),
        disk_speed(folder, needed_bytes_per_s),
    ]


def plugin_failures(failures: Mapping[str, str]) -> list[Check]:
    """Plugins that could not be loaded, by name with the error; their drivers are missing."""
    remedy = "`thermacq plugins` says more; install what it needs, or remove it."
    return [
        Check(f"plugin '{name}'", Verdict.PROBLEM, f"was not loaded: {error}", remedy)
        for name, error in failures.items()
    ] or [Check("plugins", Verdict.OK, "all loaded")]


def libraries() -> list[Check]:
    """Libraries that are no Python packages: libusb, and Aravis with its typelib."""
    checks = [_library("libusb", _has_libusb(), "USB cameras and the LabJack", "libusb-1.0-0")]
    packages = "gir1.2-aravis-0.8, then `pip install thermacq[gige]`"
    checks.append(_library("Aravis", _has_aravis(), "GigE Vision and USB3 Vision cameras", packages))
    return checks


def _library(name: str, present: bool, use: str, packages: str) -> Check:
    if present:
        return Check(name, Verdict.OK, f"found; for {use}")
    return Check(
        name, Verdict.WARNING, f"not found; {use} cannot be used", f"On Debian: apt install {packages}."
    )


def _has_libusb() -> bool:
    from usb.backend import libusb1

    return libusb1.get_backend() is not None


def _has_aravis() -> bool:
    try:
        import gi

        gi.require_version("Aravis", "0.8")
    except (ImportError, ValueError):
        return False
    return True


def usb_memory(root: Path = ROOT) -> Check:
    """Memory of the kernel for USB transfers; several cameras exhaust the usual 16 MB."""
    name = "memory for USB"
    text = read(root / "sys/module/usbcore/parameters/usbfs_memory_mb")
    if not text.isdigit():
        return Check(
            name, Verdict.WARNING, "unknown: this kernel does not tell", "Nothing, without USB cameras."
        )
    # 0 means without limit.
    if int(text) == 0 or int(text) >= _USBFS_MB:
        return Check(name, Verdict.OK, f"{text} MB" if int(text) else "no limit")
    return Check(
        name,
        Verdict.WARNING,
        f"{text} MB for all USB devices together; {_USBFS_MB} MB or more lets several cameras stream",
        "As root: echo 256 > /sys/module/usbcore/parameters/usbfs_memory_mb; for good: usbcore.usbfs_memory_mb=256 "
        "on the kernel's command line.",
    )


def socket_memory(root: Path = ROOT) -> Check:
    """Largest receive buffer of a socket; a small one loses packets of GigE Vision cameras."""
    name = "memory for sockets"
    text = read(root / "proc/sys/net/core/rmem_max")
    if not text.isdigit():
        return Check(name, Verdict.WARNING, "unknown: this kernel does not tell")
    if int(text) >= _SOCKET_BYTES:
        return Check(name, Verdict.OK, f"{int(text) / 2**20:.1f} MiB")
    return Check(
        name,
        Verdict.WARNING,
        f"{int(text) / 2**20:.2f} MiB; a GigE Vision camera wants {_SOCKET_BYTES / 2**20:.0f} MiB",
        f"As root: sysctl -w net.core.rmem_max={_SOCKET_BYTES}; for good: a line in /etc/sysctl.d/.",
    )


def clock_source(root: Path = ROOT) -> Check:
    """Where the kernel takes its time from; slow sources cost microseconds at each reading."""
    name = "clock source"
    found = read(root / "sys/devices/system/clocksource/clocksource0/current_clocksource")
    if found in ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page"):
        return Check(name, Verdict.OK, found)
    if not found:
        return Check(name, Verdict.WARNING, "unknown: this kernel does not tell")
    return Check(
        name,
        Verdict.WARNING,
        f"{found}: each reading of the time takes microseconds, and triggers scatter by them",
        "Look into the kernel log for why the tsc was rejected; firmware updates often cure it.",
    )


def power_saving(root: Path = ROOT) -> Check:
    """Frequency governor of the processors; sleepy cores wake late for a software trigger."""
    name = "power saving"
    files = sorted((root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"))
    governors = sorted({read(file) for file in files})
    if not governors or governors == ["performance"]:
        return Check(
            name, Verdict.OK, "performance" if governors else "the processors' clock is not managed here"
        )
    return Check(
        name,
        Verdict.WARNING,
        f"governor {', '.join(governors)}: software triggers can come late by fractions of a millisecond",
        "For the time of the measurements: cpupower frequency-set -g performance (as root), or a hardware trigger.",
    )


def realtime_priority() -> Check:
    """Whether this user may raise a process above all others around a software trigger."""
    name = "real-time priority"
    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if os.geteuid() == 0 or limit > 0 or limit == resource.RLIM_INFINITY:
        return Check(name, Verdict.OK, "permitted")
    return Check(
        name,
        Verdict.WARNING,
        "not permitted: under load software triggers scatter by up to a millisecond",
        "As root, a line in /etc/security/limits.d/thermacq.conf: '@video - rtprio 20'; then log in again. "
        "A hardware trigger does not need it.",
    )


def cores() -> Check:
    """Cores for two cameras, the writer and everything else."""
    count = len(os.sched_getaffinity(0))
    if count >= 2 + _SPARE_CORES:
        return Check("processor cores", Verdict.OK, str(count))
    return Check(
        "processor cores",
        Verdict.WARNING,
        f"{count}; two cameras and the writer share them with everything else",
        "Close other programs while recording, and look at the late triggers in the sync report.",
    )


def disk_speed(folder: Path, needed_bytes_per_s: float, test_bytes: int = _DISK_TEST_BYTES) -> Check:
    """Write a file to the disk, through to the platter, and take the time."""
    name = f"disk of '{folder}'"
    try:
        speed = _written_bytes_per_s(folder / f".thermacq-disk-test-{os.getpid()}", test_bytes)
    except OSError as error:
        return Check(
            name, Verdict.PROBLEM, f"cannot be written: {error.strerror}", "Choose another folder: --folder."
        )
    found = (
        f"{speed / 1e6:.0f} MB/s written and synced; the cameras deliver {needed_bytes_per_s / 1e6:.0f} MB/s"
    )
    # Compression halves what is written at the least; twice the uncompressed rate leaves room for both.
    if speed >= 2 * needed_bytes_per_s:
        return Check(name, Verdict.OK, found)
    verdict = Verdict.WARNING if speed >= needed_bytes_per_s else Verdict.PROBLEM
    return Check(name, verdict, found, "Record to a local solid-state disk; copy to the network afterwards.")


def _written_bytes_per_s(path: Path, test_bytes: int) -> float:
    chunk = os.urandom(min(_CHUNK_BYTES, test_bytes))
    try:
        with path.open("xb", buffering=0) as file:
            start_s = time.perf_counter()
            for _ in range(max(1, test_bytes // len(chunk))):
                file.write(chunk)
            os.fsync(file.fileno())
            return test_bytes / (time.perf_counter() - start_s)
    finally:
        with suppress(OSError):
            path.unlink()
