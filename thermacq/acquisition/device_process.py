"""The process of one device: makes its driver, runs it, and reports to the recorder.

Vendor libraries live here and nowhere else. Whatever a driver does wrong ends this process, not the
recording.
"""

from __future__ import annotations

import json
import signal
import time
import traceback
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection

import numpy as np

from thermacq.acquisition import priority
from thermacq.acquisition.board import Board, Order
from thermacq.acquisition.camera_loop import CameraLoop
from thermacq.acquisition.lifeline import Lifeline, event_kind
from thermacq.acquisition.messages import Armed, ArmOrder, DeviceSpec, Ended, Opened, plain
from thermacq.acquisition.outbox import Outbox
from thermacq.acquisition.ring import FrameRing
from thermacq.acquisition.ring_host import RingHost
from thermacq.acquisition.shared import SharedBlock
from thermacq.acquisition.station import Station
from thermacq.acquisition.streams import ProbeLoop, TriggerLoop
from thermacq.devices import (
    Camera,
    Device,
    DeviceContext,
    DeviceKind,
    TriggerMode,
    TriggerSource,
    WaveProbe,
)
from thermacq.errors import DeviceFault
from thermacq.hooks import Emulation
from thermacq.plugins import plugins
from thermacq.rig.reconnect import check_policy
from thermacq.rig.rehearsal import transports_for
from thermacq.store import Event, EventKind
from thermacq.timing import make_clock

_POLL_S = 0.05
_GO_POLL_S = 0.001
_CLOSING_PATIENCE_S = 2.0
_PROTOCOLS: dict[DeviceKind, type] = {
    DeviceKind.CAMERA: Camera,
    DeviceKind.WAVE_PROBE: WaveProbe,
    DeviceKind.TRIGGER_SOURCE: TriggerSource,
}


def device_main(
    spec: DeviceSpec, board: Board, block: SharedBlock, recorder: Connection, mail: Connection
) -> None:
    """Run a device from `open` to `close`; the target of a spawned process.

    Parameters
    ----------
    spec
        Which device.
    board
        Orders and counts shared by the recording.
    block
        Memory of the camera's ring; allocated by the recorder before it orders to arm.
    recorder
        Pipe to the recorder: orders in, `Opened`, `Armed`, `Ended` out.
    mail
        Pipe to the writer.
    """
    # Ctrl-C is the recorder's business; it stops the devices in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    priority.pin(spec.core)
    outbox = Outbox(mail)
    station = Station(spec.name, spec.index, board, make_clock(spec.clock), outbox, spec.recorder_pid)
    fault: DeviceFault | None = None
    try:
        _live(spec, station, block, recorder)
    except DeviceFault as problem:
        fault = problem
        station.event(event_kind(problem), problem.last_frame, problem.what)
    _tell_injected_faults(spec, station)
    if outbox.thrown_away:
        outbox.send(_CLOSING_PATIENCE_S)
        station.event(EventKind.NOTE, -1, f"{outbox.thrown_away} events were lost: the writer was late")
    outbox.close(_CLOSING_PATIENCE_S)
    with suppress(OSError):
        recorder.send(Ended(fault))


def _live(spec: DeviceSpec, station: Station, block: SharedBlock, recorder: Connection) -> None:
    device: Device | None = None
    attached = ExitStack()
    stage = "open"
    try:
        device = _make(spec, station, attached)
        identity = device.open()
        stage = "configure"
        opened = Opened(identity, plain(dict(device.configure(spec.settings))), device.capabilities)
        recorder.send(opened)
        order = _wait_for_order(recorder, station)
        if order is None:
            return
        stage = "arm"
        _arm(device, order)
        real_time_triggers = isinstance(device, Camera) and order.mode is TriggerMode.SOFTWARE
        real_time_triggers = real_time_triggers and not station.clock.is_virtual
        trigger_priority = priority.TriggerPriority() if real_time_triggers else None
        recorder.send(Armed(trigger_priority.name if trigger_priority else ""))
        if not _wait_for_go(station):
            return
        stage = "acquire"
        lifeline = Lifeline(
            device,
            station,
            spec.reconnect,
            spec.settings,
            opened,
            lambda news: _tell(recorder, news),
        )
        _run(device, order, station, block, trigger_priority, lifeline)
    except DeviceFault:
        raise
    # A driver is foreign code: whatever it raises ends this device only, and is told as its fault.
    except Exception as error:
        traceback.print_exc()
        raise DeviceFault(spec.name, stage, f"{type(error).__name__}: {error}") from error
    finally:
        if device is not None:
            with suppress(Exception):
                device.disarm()
            with suppress(Exception):
                device.close()
        with suppress(Exception):
            attached.close()


def _make(spec: DeviceSpec, station: Station, attached: ExitStack) -> Device:
    """Make the device; an emulator that plays it lives until `attached` is closed."""
    driver = plugins().driver(spec.driver, spec.kind)
    transports = attached.enter_context(
        transports_for(spec.driver, spec.name, station.clock, spec.runtime_dir, spec.emulation)
    )
    context = DeviceContext(
        spec.name,
        station.clock,
        spec.scene,
        spec.runtime_dir,
        transports,
        serial=spec.serial,
        settings=spec.settings,
    )
    device = driver.make(context)
    if not isinstance(device, _PROTOCOLS[spec.kind]):
        raise DeviceFault(spec.name, "open", f"driver '{spec.driver}' makes no {spec.kind.value}")
    check_policy(device, spec.name, spec.driver, spec.reconnect)
    return device


def _tell(recorder: Connection, news: object) -> None:
    with suppress(OSError):
        recorder.send(news)


def _tell_injected_faults(spec: DeviceSpec, station: Station) -> None:
    """Store what an emulator acted out beside what the recording made of it."""
    log = Emulation(spec.name, station.clock, spec.runtime_dir).fault_log
    if spec.emulation is None or not log.is_file():
        return
    for line in log.read_text(encoding="utf-8").splitlines():
        injected = json.loads(line)
        detail = f"emulator acted out: {injected['fault']}"
        station.outbox.post(Event(injected["host_ns"], spec.name, EventKind.NOTE, injected["item"], detail))


def _wait_for_order(recorder: Connection, station: Station) -> ArmOrder | None:
    """Recorder's order to arm; None when it says stop instead."""
    while not station.stopping():
        if recorder.poll(_POLL_S):
            order: ArmOrder = recorder.recv()
            return order
    return None


def _arm(device: Device, order: ArmOrder) -> None:
    if isinstance(device, Camera):
        device.arm(order.mode, order.rate_hz)
    elif isinstance(device, TriggerSource):
        device.arm(order.rate_hz, order.count)
    else:
        device.arm()


def _wait_for_go(station: Station) -> bool:
    priority.settle()
    while not station.stopping():
        if station.board.order(Order.GO):
            station.clock.start()
            return True
        time.sleep(_GO_POLL_S)
    return False


def _run(
    device: Device,
    order: ArmOrder,
    station: Station,
    block: SharedBlock,
    trigger_priority: priority.TriggerPriority | None,
    lifeline: Lifeline,
) -> None:
    start_ns = station.board.order(Order.START_NS)
    station.end_ns = None if order.end_ns is None else start_ns + order.end_ns
    if isinstance(device, Camera):
        size = device.capabilities.rows, device.capabilities.columns
        host = RingHost(station, FrameRing(block, *size, order.slots), np.zeros(size, np.uint16))
        CameraLoop(device, station, host, order, trigger_priority, lifeline).run(start_ns)
    elif isinstance(device, TriggerSource):
        TriggerLoop(device, station, order, lifeline).run(start_ns)
    else:
        ProbeLoop(device, station, lifeline).run()
