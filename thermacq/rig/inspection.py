"""Open every device of a rig once, each in a process of its own, and note what it says of itself.

Spawned processes with bounded waits: a vendor library that hangs or crashes costs one finding, not the
check. All devices stay open until the last one has answered, as in a recording.
"""

from __future__ import annotations

import multiprocessing
import signal
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from thermacq.devices import (
    CameraCapabilities,
    DeviceContext,
    DeviceIdentity,
    DeviceKind,
    ProbeCapabilities,
    Settings,
    TriggerCapabilities,
)
from thermacq.errors import ThermacqError
from thermacq.hooks import Evidence
from thermacq.plugins import plugins
from thermacq.rig.load import DeviceTable, devices_of
from thermacq.rig.model import Rig
from thermacq.rig.reconnect import check_policy
from thermacq.rig.rehearsal import transports_for
from thermacq.timing.clock import ClockSettings, make_clock

OPENING_TIMEOUT_S = 30.0
_CLOSING_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class DeviceReport:
    """What one device said when it was opened and configured.

    Parameters
    ----------
    name, kind, driver
        Which device of the rig.
    evidence
        What its driver was proven on.
    requested
        Settings in the rig file.
    identity, applied, capabilities
        What the device answered; `identity` and `capabilities` are None when it did not get so far.
    error, remedy
        Why it did not get to the end; `error` is empty when it did.
    emulated
        Whether an emulator played it.
    """

    name: str
    kind: DeviceKind
    driver: str
    requested: dict[str, Any]
    evidence: Evidence | None = None
    identity: DeviceIdentity | None = None
    applied: dict[str, Any] = field(default_factory=dict)
    capabilities: CameraCapabilities | ProbeCapabilities | TriggerCapabilities | None = None
    error: str = ""
    remedy: str = ""
    emulated: bool = False


def flat(settings: Mapping[str, Any], place: str = "") -> dict[str, Any]:
    """Settings with the keys of inner tables written out: ``{"clock.drift_ppm": 8.0, "inputs[0].ain": 2}``."""
    found: dict[str, Any] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            found.update(flat(value, f"{place}{key}."))
        elif isinstance(value, list | tuple) and value and all(isinstance(item, Mapping) for item in value):
            for number, item in enumerate(value):
                found.update(flat(item, f"{place}{key}[{number}]."))
        else:
            found[f"{place}{key}"] = list(value) if isinstance(value, tuple) else value
    return found


def inspect_devices(
    rig: Rig, timeout_s: float = OPENING_TIMEOUT_S, emulated: Mapping[str, Settings] | None = None
) -> list[DeviceReport]:
    """Open, configure and close every device of a rig.

    Parameters
    ----------
    rig
        The resolved rig.
    timeout_s
        How long any device may take to open and answer, seconds.
    emulated
        Devices that emulators play, with the settings of the emulators (`thermacq.rig.rehearsal`).

    Returns
    -------
    list of DeviceReport
        One for each device, in the order of the rig file.
    """
    with tempfile.TemporaryDirectory(prefix="thermacq-") as folder:
        sessions = [
            _Session(rig, place[1], kind, table, Path(folder), (emulated or {}).get(place[1]))
            for place, kind, table in devices_of(rig)
        ]
        deadline_s = time.monotonic() + timeout_s
        try:
            return [session.report(deadline_s, timeout_s) for session in sessions]
        finally:
            for session in sessions:
                session.let_go()
            for session in sessions:
                session.end()


class _Session:
    """The parent's side of one opened device."""

    def __init__(
        self,
        rig: Rig,
        name: str,
        kind: DeviceKind,
        table: DeviceTable,
        folder: Path,
        emulation: Settings | None,
    ) -> None:
        self._empty = DeviceReport(
            name, kind, table.driver, dict(table.settings), emulated=emulation is not None
        )
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process: BaseProcess = context.Process(
            target=_open_and_report,
            args=(theirs, self._empty, rig, folder, table, emulation),
            name=f"check-{name}",
            daemon=True,
        )
        self._process.start()
        theirs.close()

    def report(self, deadline_s: float, timeout_s: float) -> DeviceReport:
        """Wait for the answer, or for the end of the device's process."""
        stage = "start"
        while True:
            if not self._pipe.poll(max(0.0, deadline_s - time.monotonic())):
                self._process.kill()
                return self._failed(f"did not answer within {timeout_s:g} s (stage '{stage}')")
            try:
                message = self._pipe.recv()
            except EOFError:
                self._process.join(_CLOSING_TIMEOUT_S)
                code = self._process.exitcode
                return self._failed(f"its process ended with status {code} (stage '{stage}')")
            if isinstance(message, DeviceReport):
                return message
            stage = str(message)

    def let_go(self) -> None:
        """Tell the device's process to close the device."""
        self._pipe.close()

    def end(self) -> None:
        """Wait for the process; end it when it does not come."""
        self._process.join(_CLOSING_TIMEOUT_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def _failed(self, what: str) -> DeviceReport:
        empty = self._empty
        return replace(empty, error=what)


def _open_and_report(
    pipe: Connection,
    empty: DeviceReport,
    rig: Rig,
    folder: Path,
    table: DeviceTable,
    emulation: Settings | None,
) -> None:
    """Child process: open and configure, answer, hold the device until the parent lets go, close."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides, and closes the devices
    answer = dict(vars(empty))
    device, attached = None, ExitStack()
    try:
        pipe.send("load driver")
        driver = plugins().driver(empty.driver, empty.kind)
        answer["evidence"] = driver.evidence
        clock = make_clock(ClockSettings(rig.clock.kind, rig.clock.speed))
        transports = attached.enter_context(
            transports_for(empty.driver, empty.name, clock, folder, emulation)
        )
        context = DeviceContext(
            empty.name, clock, rig.scene, folder, transports, serial=table.serial, settings=empty.requested
        )
        device = driver.make(context)
        check_policy(device, empty.name, empty.driver, table.reconnect or rig.reconnect)
        pipe.send("open")
        answer["identity"] = device.open()
        pipe.send("configure")
        answer["applied"] = dict(device.configure(empty.requested))
        answer["capabilities"] = device.capabilities
    except ThermacqError as error:
        answer.update(error=error.what, remedy=error.remedy)
    # A driver is foreign code: whatever it raises is an answer, not the end of the check.
    except BaseException as error:
        answer["error"] = f"{type(error).__name__}: {error}"
    try:
        pipe.send(DeviceReport(**answer))
        pipe.poll(None)  # ready when the parent closes its end
    finally:
        if device is not None:
            device.close()
        attached.close()
