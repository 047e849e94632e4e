"""Frame ids of GigE Vision and USB3 Vision, made continuous."""

from __future__ import annotations

_TURN = 1 << 16


class FrameIds:
    """Makes the 16-bit frame ids of one acquisition continuous.

    GigE Vision 1.x wraps from 65535 to 1: the id 0 belongs to test packets and is skipped. A camera that is
    once seen to deliver 0 is taken to count through it. Up to half a turn may be lost between two frames.
    Wider ids (GigE Vision 2 with extended ids, USB3 Vision) are continuous already.
    """

    def __init__(self) -> None:
        self._turn = _TURN - 1
        self._previous = -1
        self._count = -1

    def count(self, frame_id: int) -> int:
        """Continuous count of a frame: its own id for the first one, then one more for each id."""
        if frame_id == 0:
            self._turn = _TURN
        if self._previous < 0 or max(frame_id, self._previous) >= _TURN:
            step = frame_id - self._count
        else:
            step = (frame_id - self._previous) % self._turn
            if step >= self._turn // 2:
                step -= self._turn
        self._previous = frame_id
        # An id that goes back further than the first one seen means that the camera started anew.
        self._count = self._count + step if self._count + step >= 0 else frame_id
        return self._count
