"""The bench on which a device is checked: it calls the verbs as the host does, and never waits for ever.

Every call into the driver runs on one thread of its own. When a call does not return in time the check
fails and says which; the suite goes on.
"""

from __future__ import annotations

import queue
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from thermacq.devices import DeviceContext, Settings
from thermacq.errors import DeviceFault, DeviceTimeout, ThermacqError
from thermacq.hooks import Driver, Emulation, Emulator
from thermacq.timing.clock import RealClock
from thermacq.transports import RealTransports, Transports

DEVICE_NAME = "under-test"
VERB_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 2.0
_WAITING_S = 0.3

_T = TypeVar("_T")


class Nonconformity(AssertionError):
    """The driver breaks a rule of the device interface; the message says which, and what to mend."""


class NotApplicable(Exception):
    """A check says nothing about this driver, for the reason given."""


def demand(holds: bool, what: str) -> None:
    """Fail the check with `what` unless it holds."""
    if not holds:
        raise Nonconformity(what)


@dataclass(frozen=True)
class Subject:
    """The driver under test, the settings to test it with, and the emulator that plays its device (or None)."""

    driver: Driver
    settings: Settings = field(default_factory=dict)
    emulator: Emulator | None = None

    def bench(self, acted_fault: type[DeviceFault] | None = None) -> Bench:
        """Make a device that is not open yet; `acted_fault` is a fault that it shall act out, of `faults`."""
        settings = {**self.emulator.driver_settings, **self.settings} if self.emulator else self.settings
        if acted_fault is None:
            return Bench(self.driver, settings, self.emulator)
        if self.emulator is not None and acted_fault in self.emulator.faults:
            return Bench(self.driver, settings, self.emulator, self.emulator.faults[acted_fault])
        return Bench(self.driver, {**settings, **self.driver.faults[acted_fault]}, self.emulator)

    @property
    def faults(self) -> frozenset[type[DeviceFault]]:
        """Faults that the driver's own settings, or those of the emulator, can make the device act out."""
        return frozenset(self.driver.faults) | frozenset(self.emulator.faults if self.emulator else ())


class Bench:
    """One device under test; a context manager that closes the device whatever happened.

    Parameters
    ----------
    driver
        The driver under test.
    settings
        What `start` hands to ``configure``.
    emulator
        Plays the device while the bench stands; None tests the real one.
    emulator_settings
        How it plays it.
    """

    def __init__(
        self,
        driver: Driver,
        settings: Mapping[str, Any],
        emulator: Emulator | None = None,
        emulator_settings: Settings | None = None,
    ) -> None:
        self.settings = dict(settings)
        self.clock = RealClock()
        self._attached = ExitStack()
        folder = Path(self._attached.enter_context(tempfile.TemporaryDirectory(prefix="thermacq-")))
        self.transports: Transports = RealTransports()
        try:
            if emulator is not None:
                emulation = Emulation(DEVICE_NAME, self.clock, folder, emulator_settings or {})
                self.transports = self._attached.enter_context(emulator.attach(emulation))
            self._worker = _Worker()
            context = DeviceContext(
                DEVICE_NAME, self.clock, {}, folder, self.transports, settings=self.settings
            )
            self.device: Any = self.do("make()", lambda: driver.make(context))
        except BaseException:
            self._attached.close()
            raise

    def __enter__(self) -> Self:
        """Hand out the bench."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Disarm and close; a failure to do so counts only when nothing else went wrong."""
        try:
            if not self._worker.stuck:
                self.verb("disarm")
                self.verb("close")
        except Nonconformity:
            if kind is None:
                raise
        finally:
            self._worker.end()
            self._attached.close()

    def start(self) -> None:
        """Open and configure the device."""
        self.verb("open")
        self.verb("configure", self.settings)

    @property
    def capabilities(self) -> Any:
        """What the device declares."""
        return self.do("capabilities", lambda: self.device.capabilities)

    def begin(self, action: Callable[[], _T]) -> Future[_T]:
        """Start an action on the device's thread."""
        return self._worker.submit(action)

    def wait(self, what: str, future: Future[_T], within_s: float) -> _T:
        """Wait for an action; errors are those of the action."""
        try:
            return future.result(within_s)
        except TimeoutError:
            if future.done():
                raise
            self._worker.stuck = True
            raise Nonconformity(
                f"{what} did not return within {within_s:g} s: bound every wait in the driver and look at "
                "host.stopping() at least every 0.1 s"
            ) from None

    def do(self, what: str, action: Callable[[], _T], within_s: float = VERB_TIMEOUT_S) -> _T:
        """Run an action on the device's thread and wait for it."""
        return self.wait(what, self.begin(action), within_s)

    def verb(self, name: str, *arguments: Any, within_s: float = VERB_TIMEOUT_S) -> Any:
        """Call a verb that must succeed."""
        try:
            return self.do(f"{name}()", lambda: getattr(self.device, name)(*arguments), within_s)
        except Nonconformity:
            raise
        except Exception as error:
            raise Nonconformity(
                f"{name}({_shown(arguments)}) failed: {type(error).__name__}: {error}"
            ) from error

    def refused(self, why: str, name: str, *arguments: Any) -> ThermacqError:
        """Call a verb that must raise a `ThermacqError`; `why` ends the message when it does not."""
        called = f"{name}({_shown(arguments)})"
        try:
            self.do(f"{name}()", lambda: getattr(self.device, name)(*arguments))
        except ThermacqError as error:
            return error
        except Nonconformity:
            raise
        except Exception as error:
            raise Nonconformity(
                f"{called} raised {type(error).__name__}, which users would see as a traceback: raise a "
                f"DeviceFault that says what to mend ({error})"
            ) from error
        raise Nonconformity(f"{called} was accepted: {why}")


class StopSwitch:
    """The host's side of a stream without buffers."""

    def __init__(self) -> None:
        self._stop = threading.Event()

    def stop(self) -> None:
        """Ask the generator to end."""
        self._stop.set()

    def stopping(self) -> bool:
        """Whether the generator shall end now."""
        return self._stop.is_set()


def demand_end(bench: Bench, stream: str, host: StopSwitch, generator: Any) -> None:
    """Ask a generator to end, and demand that it does so soon."""
    host.stop()

    def drain() -> bool:
        deadline_s = time.monotonic() + STOP_TIMEOUT_S
        return all(time.monotonic() < deadline_s for _ in generator)

    ended = bench.do(f"{stream}() after host.stopping() turned true", drain, 2 * STOP_TIMEOUT_S)
    demand(ended, f"{stream}() still yields {STOP_TIMEOUT_S:g} s after host.stopping() turned true")


def demand_abort(bench: Bench, stream: str, host: StopSwitch, generator: Any) -> Any:
    """Ask a generator to end while it waits, and demand that it does; returns what it yielded, or None."""
    waiting = bench.begin(lambda: next(generator, None))
    time.sleep(_WAITING_S)
    host.stop()
    what = f"{stream}(), waiting when host.stopping() turned true,"
    try:
        return bench.wait(what, waiting, STOP_TIMEOUT_S)
    except DeviceTimeout:
        return None  # its own timeout came first


class _Worker:
    """A thread that runs one action after another, and can be abandoned."""

    def __init__(self) -> None:
        self.stuck = False
        self._actions: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="device under test", daemon=True)
        self._thread.start()

    def submit(self, action: Callable[[], _T]) -> Future[_T]:
        future: Future[_T] = Future()
        self._actions.put((action, future))
        return future

    def end(self) -> None:
        """End the thread; one that is stuck in the driver is left behind as a daemon."""
        self._actions.put(None)
        if not self.stuck:
            self._thread.join(STOP_TIMEOUT_S)

    def _run(self) -> None:
        while (task := self._actions.get()) is not None:
            action, future = task
            try:
                future.set_result(action())
            # Handed on to whoever waits for the result.
            except BaseException as error:
                future.set_exception(error)


def _shown(arguments: tuple[Any, ...]) -> str:
    return ", ".join(str(argument) for argument in arguments)
