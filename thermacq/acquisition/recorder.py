"""The recorder process: opens the devices, arms them, lets them run, and closes the run file.

It is started by a client, outlives it, and is watched and stopped through `thermacq.acquisition.control`.
The order of a recording: open all devices - check that they fit - arm the followers, then the leader -
create the file - go - until the end - stop the devices - write what is left - close the file.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, TypeVar

from thermacq.acquisition import plan
from thermacq.acquisition.board import Board, Cell, Order
from thermacq.acquisition.children import Child, DeviceChild, faults_of, spawn_device, spawn_writer
from thermacq.acquisition.control import Desk
from thermacq.acquisition.job import Job, RecordingResult
from thermacq.acquisition.messages import (
    ASKED_FOR,
    Created,
    CreateOrder,
    DiskReserve,
    EndReason,
    FinishOrder,
    WriterEnded,
)
from thermacq.acquisition.ring import ring_bytes
from thermacq.acquisition.status import Phase, Rates, make_status
from thermacq.devices import DeviceKind
from thermacq.errors import AcquisitionError, DeviceTimeout
from thermacq.plugins import plugins
from thermacq.rig.load import check_drivers
from thermacq.store import Event, EventKind, check_room
from thermacq.timing import NS_PER_S

OPEN_TIMEOUT_S = 60.0
ARM_TIMEOUT_S = 120.0
CREATE_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 5.0
WRITE_STALL_S = 60.0
HUNG_AFTER_S = 10.0
"""A device that gives no sign of life for so long is killed."""
END_AFTER_LOSS_S = 5.0
"""The other cameras go on for so long after one was lost that is not to be brought back; then the run ends."""
LAST_FRAMES_S = 1.0
"""After the last pulse, cameras get so long without a new frame."""
LAST_SAMPLES_S = 2.0
"""After the last frame, probes get so long to reach the end of the recording."""
_START_LEAD_NS = 500_000_000
_PUMP_S = 0.02
_PUBLISH_S = 0.2
_SILENT_PROBE_S = 5.0
# Two blocks of the longest permitted length: a probe that is just between blocks is not silent.
_FALLEN_SILENT_S = 0.5

_Message = TypeVar("_Message")


class Recorder:
    """Makes one recording."""

    def __init__(self, job: Job, folder: Path, desk: Desk) -> None:
        self.stop_wanted = False
        self._job = job
        self._desk = desk
        self._virtual = job.rig.clock.kind == "virtual"
        self._specs = plan.device_specs(job.rig, folder, job.emulate)
        self._board = Board(len(self._specs))
        self._devices: list[DeviceChild] = []
        self._writer: Child | None = None
        self._writer_said: list[Any] = []
        self._start_ns = 0
        self._phase = Phase.STARTING
        self._rates = Rates()
        self._warnings: list[str] = []
        self._published_s = 0.0
        self._cameras_over_s: float | None = None
        self._frames_seen = (0, 0.0)

    def run(self) -> RecordingResult:
        """Record from beginning to end.

        Raises
        ------
        ThermacqError
            The recording could not start, or its file could not be written to the end.
        """
        try:
            self._open_devices()
            self._arm()
            self._create_file()
            self._board.give(Order.GO)
            self._phase = Phase.RECORDING
            while (reason := self._reason_to_end()) is None:
                self._pump()
            self._phase = Phase.FINISHING
            self._stop_devices()
            return self._finish(reason)
        finally:
            for device in self._devices:
                device.child.end()
                device.block.close()
            if self._writer is not None:
                self._writer.end()
            self._board.close()

    def status(self) -> dict[str, Any]:
        """Status for clients."""
        writer_pid = self._writer.process.pid if self._writer else None
        return make_status(
            self._phase,
            self._job,
            self._board,
            self._devices,
            writer_pid,
            self._start_ns,
            self._rates,
            self._warnings,
        )

    def _of_kind(self, kind: DeviceKind) -> list[DeviceChild]:
        return [device for device in self._devices if device.spec.kind is kind]

    def _open_devices(self) -> None:
        """Spawn all processes at once; check what the devices say of themselves."""
        plan.check_time(self._job)
        check_drivers(self._job.rig, plugins())
        mail: dict[str, Connection] = {}
        for spec in self._specs:
            device, mail[spec.name] = spawn_device(spec, self._board)
            self._devices.append(device)
        self._writer = spawn_writer(self._devices, self._board, mail)
        self._await(self._devices, "open", lambda device: device.opened is not None, OPEN_TIMEOUT_S)
        self._opened = {device.name: device.opened for device in self._devices if device.opened}
        self._warnings += plan.check_fit(self._job, self._opened)
        needed = plan.expected_bytes(self._job, self._opened)
        check_room(self._job.output, needed, round(self._job.rig.store.reserve_mb * 1e6))

    def _arm(self) -> None:
        """Followers first, then the leader, who fires only when all are ready."""
        slots = plan.ring_slots(self._job.rig)
        cameras = plan.cameras_of(self._opened)
        followers = [d for d in self._devices if d.spec.kind is not DeviceKind.TRIGGER_SOURCE]
        for group in (followers, self._of_kind(DeviceKind.TRIGGER_SOURCE)):
            for device in group:
                if camera := cameras.get(device.name):
                    device.block.allocate(ring_bytes(camera.rows, camera.columns, slots))
                device.child.send(plan.arm_order(self._job, device.spec.kind))
            self._await(group, "arm", lambda device: device.armed is not None, ARM_TIMEOUT_S)

    def _create_file(self) -> None:
        """Set the start, which the header tells, and let the writer make the file."""
        now_ns = time.perf_counter_ns()
        self._start_ns = 0 if self._virtual else now_ns + _START_LEAD_NS
        start_unix_ns = time.time_ns() + (0 if self._virtual else _START_LEAD_NS)
        self._board.give(Order.START_NS, self._start_ns)
        cameras, probes = plan.streams(self._opened)
        rig = self._job.rig
        self._tell_writer(
            CreateOrder(
                path=self._job.output,
                header=plan.header(self._job, self._specs, self._opened, self._start_ns, start_unix_ns),
                cameras=cameras,
                probes=probes,
                store=rig.store,
                slots=plan.ring_slots(rig),
                mode=rig.trigger.mode,
                corrections=plan.corrections(rig),
            )
        )
        deadline_s = time.monotonic() + CREATE_TIMEOUT_S
        while self._from_writer(Created) is None:
            self._pump()
            ended = self._from_writer(WriterEnded)
            if ended is not None and ended.error is not None:
                raise ended.error
            if self._writer_lost or time.monotonic() > deadline_s:
                raise self._writer_loss()

    def _reason_to_end(self) -> EndReason | None:
        """Whether and why the recording shall end now."""
        cameras, sources = self._of_kind(DeviceKind.CAMERA), self._of_kind(DeviceKind.TRIGGER_SOURCE)
        lost = [device for device in cameras if device.lost_s is not None]
        now = time.monotonic()
        writer_over = self._writer_lost or self._from_writer(WriterEnded) is not None
        # One that was away was waited for already.
        lost_for_long = any(d.away or now - (d.lost_s or now) > END_AFTER_LOSS_S for d in lost)
        done = self._all_recorded(cameras, sources, now)
        reasons = (
            (writer_over, EndReason.WRITER_LOST),
            (self._from_writer(DiskReserve) is not None, EndReason.DISK_RESERVE),
            (len(lost) == len(cameras) or lost_for_long, EndReason.CAMERA_LOST),
            (any(source.fault for source in sources), EndReason.TRIGGER_LOST),
            (self._stop_asked, EndReason.STOPPED),
            (done, EndReason.CAMERA_LOST if lost else EndReason.COMPLETED),
        )
        return next((reason for happened, reason in reasons if happened), None)

    def _all_recorded(self, cameras: list[DeviceChild], sources: list[DeviceChild], now: float) -> bool:
        """Whether cameras, and probes that record for a set time, have done what was asked."""
        frames = sum(self._board.get(camera.spec.index, Cell.RECEIVED) for camera in cameras)
        if frames != self._frames_seen[0] or not all(source.over for source in sources):
            self._frames_seen = (frames, now)
        pulses_are_over = bool(sources) and now - self._frames_seen[1] > LAST_FRAMES_S
        if not (all(camera.over for camera in cameras) or pulses_are_over):
            self._cameras_over_s = None
            return False
        self._cameras_over_s = self._cameras_over_s or now
        probes = self._of_kind(DeviceKind.WAVE_PROBE)
        probes_end = plan.arm_order(self._job, DeviceKind.WAVE_PROBE).end_ns is not None
        if not probes_end or all(probe.over for probe in probes):
            return True
        return not self._virtual and now - self._cameras_over_s > LAST_SAMPLES_S

    def _stop_devices(self) -> None:
        """Tell all to stop; end by force those who do not."""
        self._board.give(Order.STOP)
        deadline_s = time.monotonic() + STOP_TIMEOUT_S
        while not all(device.over for device in self._devices) and time.monotonic() < deadline_s:
            self._pump()
        for device in self._devices:
            if not device.over:
                self._kill(device, "did not stop when told")
        self._look_for_silent_probes()

    def _look_for_silent_probes(self) -> None:
        """Warn of probes that said nothing, or nothing any more long before the cameras ended."""
        cameras = self._of_kind(DeviceKind.CAMERA)
        cameras_end_ns = max(self._board.get(camera.spec.index, Cell.LAST_HOST_NS) for camera in cameras)
        for probe in self._of_kind(DeviceKind.WAVE_PROBE):
            if probe.fault:
                continue
            silent_s = (cameras_end_ns - self._board.get(probe.spec.index, Cell.LAST_HOST_NS)) / NS_PER_S
            if self._board.get(probe.spec.index, Cell.RECEIVED) == 0:
                self._warn(f"probe '{probe.name}' delivered no sample")
                self._post(probe, EventKind.TIMEOUT, "no sample came")
            elif silent_s > _FALLEN_SILENT_S:
                self._warn(f"probe '{probe.name}' fell silent {silent_s:.1f} s before the cameras ended")
                self._post(probe, EventKind.TIMEOUT, f"no sample in the last {silent_s:.1f} s")

    def _finish(self, reason: EndReason) -> RecordingResult:
        """Have the file closed, and say how it went; raises when the writer could not."""
        message = self._explain(reason)
        self._tell_writer(
            FinishOrder(
                reason,
                message,
                {
                    "warnings": list(self._warnings),
                    "scheduling": {d.name: d.armed.scheduling for d in self._devices if d.armed},
                },
                tuple(outage.to_dict(self._start_ns) for d in self._devices for outage in d.outages),
            )
        )
        written, progress_s = -1, time.monotonic()
        while (ended := self._from_writer(WriterEnded)) is None:
            self._pump()
            count = sum(self._board.get(device.spec.index, Cell.WRITTEN) for device in self._devices)
            if count != written:
                written, progress_s = count, time.monotonic()
            if self._writer_lost or time.monotonic() - progress_s > WRITE_STALL_S:
                raise self._writer_loss()
        if ended.error is not None:
            raise ended.error
        self._phase = Phase.ENDED
        self._publish()
        return RecordingResult(
            path=self._job.output,
            end_reason=reason.value,
            message=message,
            asked_for=reason in ASKED_FOR,
            summary=ended.summary,
            warnings=tuple(self._warnings),
        )

    def _explain(self, reason: EndReason) -> str:
        cameras, sources = self._of_kind(DeviceKind.CAMERA), self._of_kind(DeviceKind.TRIGGER_SOURCE)
        return {
            EndReason.CAMERA_LOST: f"a camera was lost: {faults_of(cameras)}",
            EndReason.TRIGGER_LOST: f"the trigger source was lost: {faults_of(sources)}",
            EndReason.STOPPED: "stopped on request",
            EndReason.DISK_RESERVE: (
                f"the disk is filled to its reserve of {self._job.rig.store.reserve_mb:.0f} MB"
            ),
        }.get(reason, "")

    def _await(
        self,
        devices: list[DeviceChild],
        stage: str,
        done: Callable[[DeviceChild], bool],
        timeout_s: float,
    ) -> None:
        """Wait until all these devices have done a step; raise the first fault instead."""
        deadline_s = time.monotonic() + timeout_s
        while not all(done(device) for device in devices):
            self._pump()
            for device in self._devices:
                if device.fault is not None:
                    raise device.fault
            if self._stop_asked:
                raise AcquisitionError("stopped before the recording began", kept="No file was made.")
            if time.monotonic() > deadline_s:
                late = next(device for device in devices if not done(device))
                raise DeviceTimeout(late.name, stage, f"no answer within {timeout_s:.0f} s")

    def _pump(self) -> None:
        """Wait a moment for news; take in what children and clients say; publish the status."""
        waited_for: list[Any] = [d.child.pipe for d in self._devices if not d.over]
        waited_for += [device.child.process.sentinel for device in self._devices if not device.over]
        if self._writer is not None and not self._writer.gone:
            waited_for += [self._writer.pipe, self._writer.process.sentinel]
        wait(waited_for, _PUMP_S)
        for device in self._devices:
            fault_known = device.fault is not None
            device.listen()
            for tiding in (text for outage in device.outages for text in outage.tidings):
                self._warn(tiding)
            if device.fault is not None and not fault_known:
                self._warn(device.fault.what)
                if not device.ended:
                    self._post(device, EventKind.DISCONNECTED, device.fault.what)
        if self._writer is not None:
            self._writer_said += self._writer.receive()
        if self._phase is Phase.RECORDING:
            self._look_after_devices()
        self._desk.serve(self.status)
        self._write_notes()
        if time.monotonic() - self._published_s >= _PUBLISH_S:
            self._publish()

    def _write_notes(self) -> None:
        """Have notes of clients written, once there is a file; their time is that of the latest news."""
        while self._phase is Phase.RECORDING and self._desk.notes:
            latest_ns = max(self._board.get(one.spec.index, Cell.LAST_HOST_NS) for one in self._devices)
            self._tell_writer(Event(latest_ns, "operator", EventKind.NOTE, -1, self._desk.notes.pop(0)))

    def _publish(self) -> None:
        self._published_s = time.monotonic()
        self._desk.publish(self.status())

    def _look_after_devices(self) -> None:
        """End devices that hang, warn of probes that say nothing."""
        for device in self._devices:
            limit_s = OPEN_TIMEOUT_S if device.away else HUNG_AFTER_S
            if not device.over and device.silent_s(self._board) > limit_s:
                self._kill(device, f"gave no sign of life for {limit_s:.0f} s")
        since_start_s = (time.perf_counter_ns() - self._start_ns) / NS_PER_S
        if not self._virtual and since_start_s > _SILENT_PROBE_S:
            for probe in self._of_kind(DeviceKind.WAVE_PROBE):
                if not probe.over and self._board.get(probe.spec.index, Cell.RECEIVED) == 0:
                    self._warn(f"probe '{probe.name}' delivered no sample")

    def _kill(self, device: DeviceChild, why: str) -> None:
        device.child.end()
        device.give_up(DeviceTimeout(device.name, "acquire", why))
        self._warn(f"device '{device.name}' {why} and was killed")
        self._post(device, EventKind.TIMEOUT, f"{why}; its process was killed")

    def _warn(self, warning: str) -> None:
        if warning not in self._warnings:
            self._warnings.append(warning)

    def _post(self, device: DeviceChild, kind: EventKind, detail: str) -> None:
        """Have an event about a device written that cannot post it any more."""
        latest_ns = self._board.get(device.spec.index, Cell.LAST_HOST_NS)
        host_ns = latest_ns if self._virtual else time.perf_counter_ns()
        if self._phase is not Phase.STARTING:
            self._tell_writer(Event(host_ns, device.name, kind, -1, detail))

    @property
    def _stop_asked(self) -> bool:
        return self.stop_wanted or self._desk.stop_wanted

    def _tell_writer(self, message: object) -> None:
        if self._writer is not None:
            self._writer.send(message)

    def _from_writer(self, kind: type[_Message]) -> _Message | None:
        """First message of a kind that the writer sent, None when there was none yet."""
        return next((message for message in self._writer_said if isinstance(message, kind)), None)

    @property
    def _writer_lost(self) -> bool:
        return self._writer is not None and self._writer.gone and self._from_writer(WriterEnded) is None

    def _writer_loss(self) -> AcquisitionError:
        how = self._writer.obituary() if self._writer and self._writer.gone else "it hangs"
        path = self._job.output
        written = ((one.name, one.spec.index) for one in self._of_kind(DeviceKind.CAMERA))
        committed = ", ".join(f"{name} {self._board.get(index, Cell.WRITTEN)}" for name, index in written)
        return AcquisitionError(
            f"the writer was lost: {how}",
            kept=f"Everything committed is in '{path}'; frames: {committed}.",
            remedy=f"`thermacq recover {path} -o NEW.h5` makes a clean file of it.",
        )
