"""How a driver reaches the world: USB, serial ports and video nodes; real ones, or those of an emulator.

A driver never opens a port by itself: it asks the `Transports` of its `DeviceContext`, so that the same
driver code, with the same libraries (pyusb, pyserial, OpenCV), meets a real device or an emulated one.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_VIDEO_CLASS = Path("/sys/class/video4linux")
# How many folders above the video node the USB device (not its interface) lies at most.
_LEVELS = 6


@dataclass(frozen=True)
class SerialNode:
    """A serial port: its path, and the USB device behind it (zeros and empty when there is none)."""

    path: str
    vid: int = 0
    pid: int = 0
    serial: str = ""
    product: str = ""


@dataclass(frozen=True)
class VideoNode:
    """A video device node: its path, and the USB device behind it; `location` is the socket, e.g. ``1-2.3``."""

    path: str
    vid: int = 0
    pid: int = 0
    serial: str = ""
    product: str = ""
    location: str = ""


class Video(Protocol):
    """What drivers use of ``cv2.VideoCapture``; property numbers are OpenCV's."""

    def isOpened(self) -> bool:
        """Whether the device is open."""
        ...

    def set(self, propId: int, value: float) -> bool:
        """Ask for a property."""
        ...

    def get(self, propId: int) -> float:
        """Value of a property that is in force."""
        ...

    def read(self) -> tuple[bool, NDArray[np.generic] | None]:
        """Wait for the next picture; (False, None) when none came."""
        ...

    def release(self) -> None:
        """Close the device."""
        ...


class Transports(Protocol):
    """The world as a driver may reach it."""

    def usb_backend(self) -> Any:
        """Backend for ``usb.core.find(backend=...)``; None lets pyusb choose the real libusb."""
        ...

    def serial_ports(self) -> Sequence[SerialNode]:
        """Serial ports that exist now; their paths are opened with ``serial.Serial``."""
        ...

    def video_nodes(self) -> Sequence[VideoNode]:
        """Video capture nodes that exist now."""
        ...

    def open_video(self, path: str) -> Video:
        """Open a video node; `Video.isOpened` tells whether that worked."""
        ...


class RealTransports:
    """The real world: libusb, the system's serial ports, Video4Linux through OpenCV."""

    def usb_backend(self) -> Any:
        """See `Transports.usb_backend`."""
        return None

    def serial_ports(self) -> Sequence[SerialNode]:
        """See `Transports.serial_ports`."""
        from serial.tools.list_ports import comports

        return [
            SerialNode(
                port.device, port.vid or 0, port.pid or 0, port.serial_number or "", port.product or ""
            )
            for port in comports()
        ]

    def video_nodes(self) -> Sequence[VideoNode]:
        """See `Transports.video_nodes`."""
        nodes = sorted(_VIDEO_CLASS.iterdir()) if _VIDEO_CLASS.is_dir() else []
        # The second node of a UVC device (index 1) carries metadata only.
        return [_video_node(node) for node in nodes if _read(node / "index") in ("", "0")]

    def open_video(self, path: str) -> Video:
        """See `Transports.open_video`."""
        # Seconds that a read of a silent camera takes at most; OpenCV looks at it with the first read.
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")
        import cv2

        return cv2.VideoCapture(path, cv2.CAP_V4L2)


def _video_node(node: Path) -> VideoNode:
    path = f"/dev/{node.name}"
    folder = (node / "device").resolve()
    for _ in range(_LEVELS):
        if (folder / "idVendor").is_file():
            vid, pid = int(_read(folder / "idVendor"), 16), int(_read(folder / "idProduct"), 16)
            serial, product = _read(folder / "serial"), _read(folder / "product")
            return VideoNode(path, vid, pid, serial, product, folder.name)
        folder = folder.parent
    return VideoNode(path, product=_read(node / "name"))


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
