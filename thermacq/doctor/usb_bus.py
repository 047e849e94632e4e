"""USB: whether this user may open the devices that the drivers know, and whether cameras share a narrow bus."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from thermacq.devices import DeviceKind
from thermacq.doctor.findings import Check, Verdict, read
from thermacq.hooks import Driver

_HIGH_SPEED_MBIT = 480
# Where the kernel lists the serial ports and video nodes that it made of a device.
_NODES = ("*/tty/*", "*/ttyUSB*", "*/video4linux/*")
_RULES_FILE = "/etc/udev/rules.d/70-thermacq.rules"


@dataclass(frozen=True)
class UsbDevice:
    """A device that is plugged in now, as the kernel lists it."""

    vid: int
    pid: int
    bus: int
    device: int
    speed_mbit: float
    product: str
    drivers: tuple[str, ...]
    is_camera: bool
    has_nodes: bool
    """Whether the kernel made a serial port or a video node of it; most drivers need only that."""

    @property
    def node(self) -> str:
        """Its file, without the leading slash."""
        return f"dev/bus/usb/{self.bus:03d}/{self.device:03d}"


def attached(drivers: Sequence[Driver], root: Path) -> list[UsbDevice]:
    """Devices on USB whose ids one of the drivers claims."""
    claims: dict[tuple[int, int], list[Driver]] = defaultdict(list)
    for driver in drivers:
        for ids in driver.usb_ids:
            claims[ids].append(driver)
    folder = root / "sys/bus/usb/devices"
    found = []
    for entry in sorted(folder.iterdir()) if folder.is_dir() else []:
        try:
            ids = int(read(entry / "idVendor"), 16), int(read(entry / "idProduct"), 16)
            bus, device = int(read(entry / "busnum")), int(read(entry / "devnum"))
            speed = float(read(entry / "speed") or 0)
        except ValueError:
            continue  # an interface, or a hub without these files
        if takers := claims.get(ids):
            names = tuple(driver.name for driver in takers)
            camera = any(driver.kind is DeviceKind.CAMERA for driver in takers)
            nodes = any(True for pattern in _NODES for _ in entry.glob(pattern))
            product = read(entry / "product")
            found.append(UsbDevice(*ids, bus, device, speed, product, names, camera, nodes))
    return found


def permissions(drivers: Sequence[Driver], root: Path) -> list[Check]:
    """Whether each attached device, and each serial and video node, may be opened by this user."""
    checks = []
    for device in attached(drivers, root):
        name = f"{device.product or 'USB device'} ({device.vid:04x}:{device.pid:04x})"
        if os.access(root / device.node, os.R_OK | os.W_OK):
            checks.append(Check(name, Verdict.OK, f"may be opened; driver {' or '.join(device.drivers)}"))
        else:
            remedy = (
                f"As root: thermacq doctor --udev-rules > {_RULES_FILE}; udevadm control --reload; "
                "udevadm trigger. Then plug it in again."
            )
            what = f"/{device.node} may not be opened by this user"
            if device.has_nodes:
                what += "; drivers that use only its serial port or video node do not mind"
            verdict = Verdict.WARNING if device.has_nodes else Verdict.PROBLEM
            checks.append(Check(name, verdict, what, remedy))
    return [
        *checks,
        _nodes("serial ports", ("ttyACM*", "ttyUSB*"), "dialout", root),
        _nodes("video nodes", ("video*",), "video", root),
    ]


def _nodes(name: str, patterns: Sequence[str], group: str, root: Path) -> Check:
    nodes = sorted(node for pattern in patterns for node in (root / "dev").glob(pattern))
    shut = [node.name for node in nodes if not os.access(node, os.R_OK | os.W_OK)]
    if shut:
        remedy = f"As root: usermod -aG {group} USER; then log in again."
        return Check(name, Verdict.PROBLEM, f"may not be opened by this user: {', '.join(shut)}", remedy)
    return Check(name, Verdict.OK, ", ".join(node.name for node in nodes) or "none attached")


def shared_buses(drivers: Sequence[Driver], root: Path) -> list[Check]:
    """Cameras that share one high-speed (480 Mbit/s) bus, of which about 35 MB/s reach the program."""
    buses: dict[int, list[UsbDevice]] = defaultdict(list)
    cameras = [device for device in attached(drivers, root) if device.is_camera]
    for device in cameras:
        buses[device.bus].append(device)
    crowded = {
        bus: devices
        for bus, devices in buses.items()
        if len(devices) > 1 and max(device.speed_mbit for device in devices) <= _HIGH_SPEED_MBIT
    }
    slow = [device for device in cameras if device.speed_mbit < _HIGH_SPEED_MBIT]
    checks = [
        Check(
            f"USB bus {bus}",
            Verdict.WARNING,
            f"{len(devices)} cameras share one bus of {_HIGH_SPEED_MBIT} Mbit/s: 640x512 at 50 frames/s takes 33 "
            "MB/s each, and about 35 MB/s fit",
            "Plug the cameras into different USB controllers (`lsusb -t` shows them); a hub does not help.",
        )
        for bus, devices in crowded.items()
    ]
    checks += [
        Check(
            f"USB bus {device.bus}",
            Verdict.PROBLEM,
            f"{device.product} runs at {device.speed_mbit:g} Mbit/s",
            "Use another cable or port: this one makes the camera slow.",
        )
        for device in slow
    ]
    if not checks:
        found = f"{len(cameras)} cameras, none in another's way" if cameras else "no USB camera attached"
        checks.append(Check("USB bandwidth", Verdict.OK, found))
    return checks


def udev_rules(drivers: Sequence[Driver]) -> str:
    """Rules that let whoever sits at the computer open the devices that the drivers know."""
    lines = [
        "# Devices of thermacq: whoever is logged in at this computer, and group plugdev, may open them."
    ]
    for driver in sorted(drivers, key=lambda driver: driver.name):
        if driver.usb_ids:
            lines.append(f"# {driver.name}: {driver.summary}")
        lines += [
            f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vid:04x}", ATTR{{idProduct}}=="{pid:04x}", MODE="0660", '
            'GROUP="plugdev", TAG+="uaccess"'
            for vid, pid in driver.usb_ids
        ]
    return "\n".join(lines) + "\n"
