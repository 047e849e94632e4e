"""A UVC camera at the boundary of OpenCV: what `cv2.VideoCapture` would be, with emulated pictures.

OpenCV itself cannot be handed a device that is not there, so emulation begins one call above it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from thermacq.transports import VideoNode

# Property numbers of OpenCV (videoio.hpp), so that this needs no OpenCV.
FRAME_WIDTH, FRAME_HEIGHT, FPS, FOURCC, CONVERT_RGB = 3, 4, 5, 6, 16
OPEN_TIMEOUT_MS, READ_TIMEOUT_MS = 53, 54
_READ_TIMEOUT_MS = 10_000.0


@dataclass(frozen=True)
class VideoFormat:
    """One format that the device offers; `fourcc` is as in UVC, e.g. ``Y16 `` or ``YUYV``."""

    columns: int
    rows: int
    fourcc: str
    rate_hz: float

    @property
    def code(self) -> int:
        """The number that OpenCV makes of the four letters."""
        return int.from_bytes(self.fourcc.encode("ascii"), "little")


class VideoDevice(Protocol):
    """A camera that streams: the picture of the format that was started, whenever there is one."""

    formats: tuple[VideoFormat, ...]

    def start(self, chosen: VideoFormat) -> None:
        """Begin to stream."""
        ...

    def picture(self, timeout_s: float, gone: Callable[[], bool]) -> NDArray[np.generic] | None:
        """Wait for the next picture as it comes over the wire; None when none came in time, or `gone`.

        ``Y16`` is (rows, columns) uint16; ``YUYV`` is (rows, columns, 2) uint8.
        """
        ...

    def stop(self) -> None:
        """Stop streaming; legal in every state."""
        ...


class VideoPlug:
    """The socket of one emulated camera: plugged in, pulled, and plugged in again."""

    def __init__(self, device: VideoDevice, node: VideoNode) -> None:
        self.device = device
        self._node = node
        self._plugged = True
        self._replug_s: float | None = None
        # Counts how often it was plugged in: what was opened before that is dead.
        self.life = 0
        self._lock = threading.Lock()

    def node(self) -> VideoNode | None:
        """The node as the host sees it; None while it is unplugged."""
        return replace(self._node) if self.plugged else None

    @property
    def plugged(self) -> bool:
        """Whether it is plugged in now."""
        with self._lock:
            if not self._plugged and self._replug_s is not None and time.monotonic() >= self._replug_s:
                self._plug()
            return self._plugged

    def plug(self) -> None:
        """Plug it in; what was opened before stays dead."""
        with self._lock:
            if not self._plugged:
                self._plug()

    def _plug(self) -> None:
        self._plugged, self._replug_s = True, None
        self.life += 1

    def unplug(self, replug_after_s: float = 0.0) -> None:
        """Pull the cable; it is plugged in again after so many real seconds, or not when 0."""
        with self._lock:
            self._plugged = False
            self._replug_s = time.monotonic() + replug_after_s if replug_after_s > 0 else None
        self.device.stop()

    def open(self) -> EmulatedVideo:
        """Open the node as OpenCV does."""
        return EmulatedVideo(self)


class EmulatedVideo:
    """`thermacq.transports.Video` over an emulated camera; the names are those of `cv2.VideoCapture`."""

    def __init__(self, plug: VideoPlug) -> None:
        self._plug = plug
        self._life = plug.life
        self._open = plug.plugged
        self._chosen = plug.device.formats[0]
        self._convert_rgb = True
        self._timeout_ms = _READ_TIMEOUT_MS
        self._streaming = False

    def isOpened(self) -> bool:
        """Whether it is open; an unplugged camera still counts as open, as with OpenCV."""
        return self._open

    def set(self, propId: int, value: float) -> bool:
        """Ask for a property; a size or format that the camera lacks moves to one that it has."""
        if not self._open:
            return False
        if propId == CONVERT_RGB:
            self._convert_rgb = bool(value)
        elif propId == READ_TIMEOUT_MS:
            self._timeout_ms = value
        elif propId in (FRAME_WIDTH, FRAME_HEIGHT, FPS, FOURCC):
            return self._choose(propId, value)
        else:
            return False
        return True

    def _choose(self, prop: int, value: float) -> bool:
        self._stop()
        offered = self._plug.device.formats
        fits: dict[int, Callable[[VideoFormat], bool]] = {
            FRAME_WIDTH: lambda item: item.columns == value,
            FRAME_HEIGHT: lambda item: item.rows == value,
            FPS: lambda item: abs(item.rate_hz - value) < 0.5,
            FOURCC: lambda item: item.code == int(value),
        }
        found = [item for item in offered if fits[prop](item)]
        if found:
            self._chosen = max(found, key=self._likeness)
        return bool(found)

    def _likeness(self, item: VideoFormat) -> int:
        """How many properties stay as they are; a size or a pixel format changes one property at a time."""
        chosen = self._chosen
        return (
            (item.columns == chosen.columns)
            + (item.rows == chosen.rows)
            + (item.fourcc == chosen.fourcc)
            + (item.rate_hz == chosen.rate_hz)
        )

    def get(self, propId: int) -> float:
        """Value of a property that is in force; 0 for one that there is not."""
        return {
            FRAME_WIDTH: float(self._chosen.columns),
            FRAME_HEIGHT: float(self._chosen.rows),
            FPS: self._chosen.rate_hz,
            FOURCC: float(self._chosen.code),
            CONVERT_RGB: float(self._convert_rgb),
            READ_TIMEOUT_MS: self._timeout_ms,
        }.get(propId, 0.0)

    def read(self) -> tuple[bool, NDArray[np.generic] | None]:
        """Wait for the next picture; (False, None) after the timeout, or at once when it is unplugged."""
        if self._gone():
            return False, None
        if not self._streaming:
            self._plug.device.start(self._chosen)
            self._streaming = True
        picture = self._plug.device.picture(self._timeout_ms / 1000, self._gone)
        if picture is None or self._gone():
            return False, None
        return True, _as_bgr(picture) if self._convert_rgb else picture

    def release(self) -> None:
        """Close; legal in every state."""
        self._stop()
        self._open = False

    def _stop(self) -> None:
        if self._streaming and not self._gone():
            self._plug.device.stop()
        self._streaming = False

    def _gone(self) -> bool:
        return not (self._open and self._plug.plugged and self._plug.life == self._life)


class NoVideo:
    """What opening a node gives that does not exist."""

    def isOpened(self) -> bool:
        """Never."""
        return False

    def set(self, propId: int, value: float) -> bool:  # noqa: ARG002
        """Refuses."""
        return False

    def get(self, propId: int) -> float:  # noqa: ARG002
        """Nothing."""
        return 0.0

    def read(self) -> tuple[bool, NDArray[np.generic] | None]:
        """Nothing."""
        return False, None

    def release(self) -> None:
        """Nothing to close."""


def _as_bgr(picture: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Eight bits in three channels: what OpenCV makes of 16 bits unless it is told not to convert."""
    grey = (picture >> 8).astype(np.uint8) if picture.ndim == 2 else picture[..., 0].astype(np.uint8)  # type: ignore[operator]
    return np.repeat(grey[..., None], 3, axis=2)
