"""A video node found by its USB identity and read with patience, over what `cv2.VideoCapture` is.

OpenCV's V4L2 reads cannot be cut short: a camera that waits for a trigger holds `read` for up to a second. So
a thread of its own makes the reads, one at a time and only when asked for a picture; whoever waits can stop
waiting at any time. Pictures that nobody asked for stay in the kernel's few buffers.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from thermacq.errors import DeviceDisconnected, DeviceFault
from thermacq.transports import Transports, Video, VideoNode

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from thermacq.timing.clock import Clock

# Property numbers of OpenCV (videoio.hpp); importing it only for them would be slow.
FRAME_WIDTH, FRAME_HEIGHT, FPS, FOURCC, CONVERT_RGB, READ_TIMEOUT_MS = 3, 4, 5, 6, 16, 54
# OpenCV's V4L2 backend does not know this property; its own limit is set where the node is opened.
_READ_TIMEOUT_S = 0.25
# A read that fails sooner than this did not wait for a picture: the device is gone.
_QUICK_S = 0.1
_QUICK_FAILURES = 5
_FAILED_PAUSE_S = 0.02
_CLOSING_S = 5.0
_REMEDY = "Check power and cable; `thermacq devices` lists what is attached."
_RIGHTS = (
    "Close other programs that show its picture; let the user join the group that owns the node (video), "
    "then log in again; `thermacq doctor` checks that."
)


@dataclass(frozen=True)
class VideoFormat:
    """Size, pixel format (four letters, as in UVC) and frame rate of a stream."""

    columns: int
    rows: int
    fourcc: str
    rate_hz: float

    def __str__(self) -> str:
        return f"{self.columns} x {self.rows} '{self.fourcc}' at {self.rate_hz:g} frames/s"


@dataclass(frozen=True)
class Shot:
    """One picture as it came, and the host time when it was there."""

    picture: NDArray[np.generic]
    host_ns: int


def find_video(nodes: Sequence[VideoNode], device: str, *, serial: str = "", path: str = "") -> VideoNode:
    """Choose the video node of a device among those that exist.

    Parameters
    ----------
    nodes
        Candidates, e.g. those with the right USB ids.
    device
        Name of the device in the rig, for messages.
    serial, path
        What the rig says; empty accepts any, if there is only one. `serial` is that of `identity_of`.

    Raises
    ------
    DeviceDisconnected
        There is none, or no such one.
    DeviceFault
        There are several and nothing says which.
    """
    fitting = [node for node in nodes if serial in ("", identity_of(node)) and path in ("", node.path)]
    if not fitting:
        seen = ", ".join(identity_of(node) for node in nodes) or "none"
        wanted = serial or path
        what = f"camera '{wanted}' was not found" if wanted else "its video node was not found"
        raise DeviceDisconnected(device, "open", f"{what}; attached: {seen}", remedy=_REMEDY)
    if len(fitting) > 1:
        seen = ", ".join(identity_of(node) for node in fitting)
        remedy = "Say in the rig which one is meant: its serial."
        raise DeviceFault(device, "open", f"several cameras fit: {seen}", remedy=remedy)
    return fitting[0]


def identity_of(node: VideoNode) -> str:
    """USB serial number of a camera; without one its ids and the USB socket that it hangs on; else the path."""
    if node.serial:
        return node.serial
    return f"{node.vid:04x}:{node.pid:04x}@{node.location}" if node.location else node.path


def as_counts(picture: NDArray[Any], wanted: VideoFormat) -> NDArray[np.uint16]:
    """Counts of a picture as OpenCV hands it out unconverted, in whatever shape.

    Parameters
    ----------
    picture
        The bytes of ``Y16`` (as 16-bit pixels, pairs of bytes or one row of bytes), ``GREY``, or of the
        luminance with chrominance between, ``YUYV`` or ``UYVY``.
    wanted
        What was agreed on.

    Returns
    -------
    numpy.ndarray
        (rows, columns) uint16; 8-bit luminance keeps its values from 0 to 255.

    Raises
    ------
    ValueError
        It is of another size, or of a format that has no luminance of its own.
    """
    import numpy as np

    data = np.ascontiguousarray(picture).reshape(-1).view(np.uint8)
    pixels = wanted.rows * wanted.columns
    size = pixels if wanted.fourcc == "GREY" else 2 * pixels
    if wanted.fourcc not in FOURCCS:
        raise ValueError(f"format '{wanted.fourcc}' is none of {', '.join(FOURCCS)}")
    if data.size != size:
        raise ValueError(f"{data.size} bytes came, {size} make a picture of {wanted}")
    if wanted.fourcc == "Y16 ":
        counts = data.view("<u2")
    elif wanted.fourcc == "GREY":
        counts = data
    else:
        counts = data[int(wanted.fourcc == "UYVY") :: 2]
    return counts.astype(np.uint16, copy=False).reshape(wanted.rows, wanted.columns)


FOURCCS = ("Y16 ", "GREY", "YUYV", "UYVY")
"""Formats that `as_counts` understands."""


class VideoStream:
    """An open video node of one device.

    Parameters
    ----------
    device
        Name of the device in the rig, for faults.
    transports, path
        Where the node is.
    clock
        Host clock.
    stage
        Verb during which it is opened, for faults.

    Raises
    ------
    DeviceFault
        It cannot be opened.
    """

    def __init__(
        self, device: str, transports: Transports, path: str, clock: Clock, stage: str = "open"
    ) -> None:
        self._device = device
        self._clock = clock
        self._path = path
        self._video: Video = transports.open_video(path)
        if not self._video.isOpened():
            what = f"the video node {path} cannot be opened"
            raise DeviceFault(device, stage, what, remedy=_RIGHTS)
        self._video.set(READ_TIMEOUT_MS, 1000 * _READ_TIMEOUT_S)
        self._thread: threading.Thread | None = None
        self._orders: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[Shot | float] = queue.SimpleQueue()
        self._asked = False
        self._quick_failures = 0

    def ask_for(self, columns: int = 0, rows: int = 0, fourcc: str = "", rate_hz: float = 0) -> VideoFormat:
        """Ask for a format, without conversion, and return what is in force; 0 and empty leave it as it is.

        Only before the first picture was asked for.
        """
        # The size first, then the letters: some cameras are known to need this order.
        for number, value in (
            (FRAME_WIDTH, columns),
            (FRAME_HEIGHT, rows),
            (FOURCC, int.from_bytes(fourcc.encode("ascii"), "little")),
            (FPS, rate_hz),
            (CONVERT_RGB, 0),
        ):
            if value or number == CONVERT_RGB:
                self._video.set(number, value)
        return self.granted()

    def granted(self) -> VideoFormat:
        """The format in force."""
        letters = int(self._video.get(FOURCC)) & 0xFFFFFFFF
        return VideoFormat(
            int(self._video.get(FRAME_WIDTH)),
            int(self._video.get(FRAME_HEIGHT)),
            letters.to_bytes(4, "little").decode("ascii", "replace"),
            float(self._video.get(FPS)),
        )

    def begin(self) -> None:
        """Ask for the next picture; the first time, the camera starts to stream."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._serve, name=f"video of {self._device}", daemon=True)
            self._thread.start()
        if not self._asked:
            self._asked = True
            self._orders.put(True)

    def take(self, wait_s: float, stage: str = "acquire") -> Shot | None:
        """Wait for the next picture; None when none came yet.

        Raises
        ------
        DeviceDisconnected
            The node gives nothing any more, without waiting.
        """
        self.begin()
        try:
            answer = self._answers.get(timeout=wait_s)
        except queue.Empty:
            return None
        self._asked = False
        if isinstance(answer, Shot):
            self._quick_failures = 0
            return answer
        self._quick_failures = self._quick_failures + 1 if answer < _QUICK_S else 0
        if self._quick_failures >= _QUICK_FAILURES:
            raise DeviceDisconnected(
                self._device, stage, f"the camera at {self._path} is gone", remedy=_REMEDY
            )
        return None

    def _serve(self) -> None:
        """Make the reads that are ordered, and release the node at the end: no other thread may touch it."""
        while self._orders.get():
            began_s = time.monotonic()
            # OpenCV raises an error of its own for some states of a pulled camera.
            try:
                there, picture = self._video.read()
            except Exception:
                there, picture = False, None
            now_ns = self._clock.now_ns()
            if there and picture is not None:
                self._answers.put(Shot(picture, now_ns))
            else:
                took_s = time.monotonic() - began_s
                time.sleep(_FAILED_PAUSE_S)
                self._answers.put(took_s)
        self._video.release()

    def close(self) -> None:
        """Let go of the node; never raises, for it may be gone."""
        if self._thread is None:
            self._video.release()
        elif self._thread.is_alive():
            self._orders.put(False)
            self._thread.join(_CLOSING_S)
