"""Bringing back a device that was lost: the same individual, with the settings that the policy says, armed."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from thermacq.acquisition.board import Cell
from thermacq.acquisition.messages import Away, Back, Capabilities, Opened, plain
from thermacq.acquisition.station import Station
from thermacq.devices import Adopting, CameraCapabilities, Device, ProbeCapabilities, Settings
from thermacq.errors import DeviceDisconnected, DeviceFault, DeviceTimeout
from thermacq.rig import ReconnectTable
from thermacq.store import Event, EventKind
from thermacq.timing import NS_PER_S

LOST = (DeviceDisconnected, DeviceTimeout)
"""Faults after which a device may come back."""

_TRY_EVERY_S = 0.25
_LOOK_EVERY_S = 0.05


def event_kind(fault: DeviceFault) -> EventKind:
    """Kind of event that a fault is stored as."""
    if isinstance(fault, DeviceTimeout):
        return EventKind.TIMEOUT
    return EventKind.DISCONNECTED if isinstance(fault, DeviceDisconnected) else EventKind.NOTE


class Lifeline:
    """Holds on to one device through its outages.

    An outage begins with the fault and ends with the first frame, sample or pulse after it: a device that
    lets itself be opened but delivers nothing is still away.

    Parameters
    ----------
    device
        The device, which was armed once.
    station
        Its place in the recording.
    policy
        What the rig says about outages.
    settings
        Settings in the rig.
    opened
        What the device said of itself when the recording began.
    tell
        Sends `Away` and `Back` to the recorder.
    """

    def __init__(
        self,
        device: Device,
        station: Station,
        policy: ReconnectTable,
        settings: Settings,
        opened: Opened,
        tell: Callable[[object], None],
    ) -> None:
        self._device = device
        self._station = station
        self._policy = policy
        self._settings = settings
        self._opened = opened
        self._tell = tell
        self._applied: dict[str, Any] = opened.applied
        self._lost_s: float | None = None
        self._lost_ns = 0
        self._back_ns = 0
        self._told: set[str] = set()

    @property
    def is_away(self) -> bool:
        """Whether nothing was delivered since the last fault."""
        return self._lost_s is not None

    def bring_back(
        self, fault: DeviceFault, index: int, until_ns: int | None, arm: Callable[[], None]
    ) -> bool:
        """Try to arm the device again until that is done; False when the recorder said stop meanwhile.

        Parameters
        ----------
        fault
            How it was lost.
        index
            Frame, sample or pulse at which that was noticed.
        until_ns
            Host time at which its part of the recording is over; None: no end.
        arm
            Arms it for the rest of the recording.

        Raises
        ------
        DeviceFault
            It is lost for good: the policy says so, or it did not come back in time.
        """
        if self._policy.policy == "fail":
            raise fault
        if self._lost_s is None:
            self._note_loss(fault, index)
        problem = fault.reason
        while not self._station.ordered_to_stop():
            self._check_patience(fault, problem, until_ns)
            problem = self._try(arm)
            if not problem:
                return True
            self._tell_once(f"not back yet: {problem}")
            self._pause()
        self._station.event(EventKind.NOTE, -1, "still away when the recording was stopped")
        return False

    def deliver(self, missed: int, index: int, what: str) -> None:
        """Note the end of an outage with the first frame, sample or pulse after it.

        Parameters
        ----------
        missed
            How many are missing.
        index
            The first one's index, -1 when it has none.
        what
            What they are called.
        """
        station = self._station
        away_s = (station.clock.now_ns() - self._lost_ns) / NS_PER_S
        before, now = self._opened.applied, self._applied
        changed = tuple(sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key)))
        settings = f"settings differ: {', '.join(changed)}" if changed else "settings as before"
        detail = f"away {away_s:.2f} s, {missed} {what} missing; {settings}"
        station.board.add(station.index, Cell.DISCONNECTED, missed)
        station.outbox.post(Event(self._back_ns, station.name, EventKind.RECONNECTED, index, detail))
        self._tell(Back(self._back_ns, away_s, missed, now, changed))
        self._lost_s = None

    def _note_loss(self, fault: DeviceFault, index: int) -> None:
        self._lost_s, self._lost_ns = time.monotonic(), self._station.clock.now_ns()
        self._told.clear()
        self._station.event(event_kind(fault), index, fault.what)
        self._tell(Away(self._lost_ns, fault.what))

    def _tell_once(self, why: str) -> None:
        """Say why it is not back, each reason once in an outage."""
        if why not in self._told:
            self._told.add(why)
            self._station.event(EventKind.NOTE, -1, why)
            self._tell(Away(self._lost_ns, f"device '{self._station.name}' is {why}"))

    def _check_patience(self, fault: DeviceFault, problem: str, until_ns: int | None) -> None:
        limit_s = self._policy.give_up_after_s
        if self._lost_s is not None and time.monotonic() - self._lost_s > limit_s:
            end = f"did not come back within {limit_s:g} s"
        elif until_ns is not None and self._station.clock.now_ns() >= until_ns:
            end = "did not come back before the end of the recording"
        else:
            return
        self._let_go()
        last = f"; last try: {problem}" if problem != fault.reason else ""
        raise type(fault)(
            self._station.name,
            "reconnect",
            f"{end}; lost because: {fault.reason}{last}",
            last_frame=fault.last_frame,
            remedy=fault.remedy,
        )

    def _try(self, arm: Callable[[], None]) -> str:
        """Open the same individual and arm it; returns why that is not possible yet, empty when done."""
        self._let_go()
        began_ns = self._station.clock.now_ns()
        try:
            identity = self._device.open()
            first = self._opened.identity
            if (identity.model, identity.serial) != (first.model, first.serial):
                found = f"'{identity.model}' with serial number '{identity.serial}'"
                raise self._refusal(f"another device is there: {found}, not '{first.serial}'")
            self._applied = self._settle()
            if _fixed(self._device.capabilities) != _fixed(self._opened.capabilities):
                raise self._refusal(
                    "it delivers pictures or values of another kind than this recording holds"
                )
            arm()
        except DeviceFault as problem:
            self._let_go()
            return problem.reason
        # A driver is foreign code: whatever it raises is a reason to try again.
        except Exception as error:
            traceback.print_exc()
            self._let_go()
            return f"{type(error).__name__}: {error}"
        self._back_ns = began_ns
        return ""

    def _settle(self) -> dict[str, Any]:
        """Settings in force, as the policy wants them."""
        device = self._device
        if self._policy.policy == "device_wins" and isinstance(device, Adopting):
            return dict(plain(dict(device.adopt())))
        return dict(plain(dict(device.configure(self._settings))))

    def _let_go(self) -> None:
        """Close what is left of it, so that nobody else is kept from opening it."""
        with suppress(Exception):
            self._device.disarm()
        with suppress(Exception):
            self._device.close()

    def _pause(self) -> None:
        clock, end_s = self._station.clock, time.monotonic() + _TRY_EVERY_S
        while time.monotonic() < end_s and not self._station.ordered_to_stop():
            self._station.stopping()  # a sign of life
            time.sleep(_LOOK_EVERY_S)
        if clock.is_virtual:
            clock.wait_until_ns(
                clock.now_ns() + round(_TRY_EVERY_S * NS_PER_S), self._station.ordered_to_stop
            )

    def _refusal(self, what: str) -> DeviceFault:
        return DeviceFault(self._station.name, "reconnect", what)


def _fixed(capabilities: Capabilities) -> tuple[object, ...]:
    """What ring and file cannot change any more."""
    if isinstance(capabilities, CameraCapabilities):
        shape = capabilities.rows, capabilities.columns
        return *shape, capabilities.counter_bits, capabilities.tick_rate_hz
    if isinstance(capabilities, ProbeCapabilities):
        return capabilities.channels, capabilities.unit, capabilities.tick_rate_hz
    return ()
