"""One acquisition of a GenICam camera, from arming to disarming: triggers out, frames in, losses named."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from thermacq.devices import Counts, Frame, FrameFlag, FrameHost, TriggerMode
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceOverrun, DeviceTimeout, IncompleteFrame
from thermacq.timing.clock import Clock
from thermacq_drivers.gige.frame_ids import FrameIds
from thermacq_drivers.gige.link import AravisLink, Delivery
from thermacq_drivers.gige.settings import GigeSettings

GONE_REMEDY = "Check power and cable; `thermacq devices` lists the cameras that answer."
_SILENT_REMEDY = (
    "Check the trigger line; without triggers check the firewall and the packet size "
    "(settings packet_size: 1400 passes everywhere)."
)
_POLL_S = 0.1


class Acquisition:
    """Frames and triggers of an armed camera.

    Parameters
    ----------
    name
        Name of the device in the rig.
    link
        The camera, with its stream prepared.
    settings
        Those in force.
    mode
        Who triggers.
    patience_s
        Longest silence before the camera is given up.
    clock
        Host clock.
    """

    def __init__(
        self,
        name: str,
        link: AravisLink,
        settings: GigeSettings,
        mode: TriggerMode,
        patience_s: float,
        clock: Clock,
    ) -> None:
        self._name = name
        self._link = link
        self._settings = settings
        self._mode = mode
        self._patience_s = patience_s
        self._clock = clock
        self._ids = FrameIds()
        self._counter = -1
        self._good = 0
        self._held: Delivery | None = None
        self._trigger_index = -1
        self._fired_s = 0.0
        self._heard_s = 0.0
        self._started = False
        self._over = False

    @property
    def is_software(self) -> bool:
        """Whether `trigger` exposes."""
        return self._mode is TriggerMode.SOFTWARE

    def start(self) -> None:
        """Let frames come."""
        if not self._started:
            self._link.start()
            self._started = True

    def trigger(self, index: int) -> None:
        """Expose now; whatever still comes from an earlier trigger was given up and is thrown away."""
        while self._link.pop(0.0) is not None:
            pass
        self._trigger_index, self._fired_s = index, time.monotonic()
        self._link.software_trigger()

    def end(self) -> None:
        """No frame is yielded from now on."""
        self._over = True

    def frames(self, host: FrameHost) -> Iterator[Frame]:
        """See `thermacq.devices.Camera.frames`; raises `LinkError` when the camera cannot be started."""
        self.start()
        self._heard_s = time.monotonic()
        while not self._over and not host.stopping():
            if self._link.lost:
                raise self._fault(DeviceDisconnected, "its control channel was lost", GONE_REMEDY)
            delivery, self._held = self._held or self._link.pop(_POLL_S), None
            if delivery is None:
                self._check_silence()
                continue
            self._heard_s = time.monotonic()
            frame = self._take(delivery, host)
            if frame is not None:
                yield frame

    def _take(self, delivery: Delivery, host: FrameHost) -> Frame | None:
        """Frame of a delivery; None when it belongs to a trigger that was given up."""
        counter = self._ids.count(delivery.frame_id)
        self._check_overrun(delivery, counter)
        index, self._trigger_index = self._trigger_index, -1
        if self.is_software and index < 0:
            return None
        counts = host.buffer()
        pixels = np.frombuffer(delivery.data, "u1" if self._settings.pixel_format == "Mono8" else "<u2")
        problem = delivery.problem
        if not problem and (delivery.rows, delivery.columns) != counts.shape:
            problem = f"it has {delivery.columns} x {delivery.rows} pixels"
        if problem and self._settings.incomplete_frames == "drop":
            raise self._fault(IncompleteFrame, f"frame id {delivery.frame_id} came incomplete: {problem}")
        _fill(counts, pixels)
        self._good += 1
        return Frame(
            counts=counts,
            counter=counter,
            ticks=delivery.timestamp_ns or -1,
            host_ns=self._clock.now_ns(),
            trigger_index=index,
            flags=FrameFlag.INCOMPLETE if problem else FrameFlag.NONE,
        )

    def _check_overrun(self, delivery: Delivery, counter: int) -> None:
        """Frames that are missing because no buffer was free were lost by the host, not by the network."""
        lost = counter - self._counter - 1 if self._counter >= 0 else 0
        self._counter = counter
        if lost > 0 and self._link.ran_short_of_buffers():
            self._held = delivery
            raise self._fault(DeviceOverrun, f"{lost} frames found no free buffer: the host was late")

    def _check_silence(self) -> None:
        now_s = time.monotonic()
        index, limit_s = self._trigger_index, self._settings.trigger_timeout_s
        if index >= 0 and now_s - self._fired_s > limit_s:
            self._trigger_index = -1
            raise self._fault(IncompleteFrame, f"trigger {index} gave no frame within {limit_s:g} s")
        if now_s - self._heard_s > self._patience_s:
            silence = f"no frame came for {self._patience_s:g} s"
            if self._link.alive():
                what = f"{silence}, though the camera answers"
                raise self._fault(DeviceTimeout, what, _SILENT_REMEDY)
            raise self._fault(DeviceDisconnected, f"{silence}, and the camera does not answer", GONE_REMEDY)

    def _fault(self, kind: type[DeviceFault], what: str, remedy: str = "") -> DeviceFault:
        return kind(self._name, "acquire", what, last_frame=self._good - 1, remedy=remedy)


def _fill(counts: Counts, pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Copy what there is; pixels of an incomplete frame that did not come are 0."""
    flat = counts.reshape(-1)
    there = min(pixels.size, flat.size)
    flat[:there] = pixels[:there]
    flat[there:] = 0
