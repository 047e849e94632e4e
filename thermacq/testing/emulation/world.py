"""The transports that an emulator hands to a driver: whatever emulated things are plugged in at the moment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from thermacq.transports import SerialNode, Video, VideoNode

if TYPE_CHECKING:
    from thermacq.testing.emulation.usb import UsbPlug


class SerialEnd(Protocol):
    """The far end of a serial port: `thermacq.testing.emulation.pty.PtyPort`."""

    def node(self) -> SerialNode | None:
        """The port as the host sees it; None while it is unplugged."""
        ...


class VideoEnd(Protocol):
    """The far end of a video node: `thermacq.testing.emulation.video.VideoPlug`."""

    def node(self) -> VideoNode | None:
        """The node as the host sees it; None while it is unplugged."""
        ...

    def open(self) -> Video:
        """Open the node as OpenCV does."""
        ...


class EmulatedTransports:
    """`thermacq.transports.Transports` on which emulated devices are plugged in, and nothing else.

    Parameters
    ----------
    serial, usb, video
        Far ends. One device can have several, like a camera with a video node and a serial port.
    """

    def __init__(
        self,
        *,
        serial: Sequence[SerialEnd] = (),
        usb: Sequence[UsbPlug] = (),
        video: Sequence[VideoEnd] = (),
    ) -> None:
        self.serial, self.usb, self.video = tuple(serial), tuple(usb), tuple(video)

    def __add__(self, other: EmulatedTransports) -> EmulatedTransports:
        """Both sets of devices on one computer."""
        return EmulatedTransports(
            serial=self.serial + other.serial, usb=self.usb + other.usb, video=self.video + other.video
        )

    def usb_backend(self) -> Any:
        """See `Transports.usb_backend`."""
        from thermacq.testing.emulation.usb_backend import EmulatedBackend

        return EmulatedBackend(self.usb)

    def serial_ports(self) -> list[SerialNode]:
        """See `Transports.serial_ports`."""
        return [node for end in self.serial if (node := end.node()) is not None]

    def video_nodes(self) -> list[VideoNode]:
        """See `Transports.video_nodes`."""
        return [node for _, node in self._videos()]

    def open_video(self, path: str) -> Video:
        """See `Transports.open_video`."""
        from thermacq.testing.emulation.video import NoVideo

        return next((end.open() for end, node in self._videos() if node.path == path), NoVideo())

    def _videos(self) -> Iterator[tuple[VideoEnd, VideoNode]]:
        return ((end, node) for end in self.video if (node := end.node()) is not None)
