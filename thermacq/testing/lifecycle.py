"""What holds for every device, whatever its kind: identity, settings, states, nothing left behind."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from thermacq.devices import (
    Camera,
    CameraCapabilities,
    DeviceIdentity,
    DeviceKind,
    ProbeCapabilities,
    TriggerCapabilities,
    TriggerSource,
    WaveProbe,
)
from thermacq.testing.bench import Bench, Nonconformity, Subject, demand
from thermacq.testing.streams import begin, run_briefly

SETTLE_S = 2.0
_PROTOCOLS = {
    DeviceKind.CAMERA: (Camera, CameraCapabilities),
    DeviceKind.WAVE_PROBE: (WaveProbe, ProbeCapabilities),
    DeviceKind.TRIGGER_SOURCE: (TriggerSource, TriggerCapabilities),
}


def identity(subject: Subject) -> None:
    """`open` says which individual this is, and says the same when opened again."""
    with subject.bench() as bench:
        first = bench.verb("open")
        demand(
            isinstance(first, DeviceIdentity),
            f"open() returned a {type(first).__name__}: return a DeviceIdentity",
        )
        name = subject.driver.name
        demand(first.driver == name, f"DeviceIdentity.driver is '{first.driver}': make it '{name}'")
        demand(bool(first.model), "DeviceIdentity.model is empty: name the model")
        bench.verb("close")
        again = bench.verb("open")
        demand(first == again, f"opened again, the device calls itself {again} instead of {first}")


def discovery(subject: Subject) -> None:
    """`discover` lists identities of this driver and raises nothing; an emulated device is found, as opened."""
    with subject.bench() as bench:
        found = [_discover(subject, bench) for _ in range(2)]
        for item in found[0]:
            demand(
                isinstance(item, DeviceIdentity), f"discover() lists {item!r}: list DeviceIdentity records"
            )
        demand(found[0] == found[1], f"asked twice, discover() lists {found[0]}, then {found[1]}")
        if subject.emulator is None:
            return
        demand(
            len(found[0]) == 1,
            f"discover() lists {len(found[0])} devices where one is emulated: look at the transports that it is "
            "handed, not at the real ones",
        )
        opened = bench.verb("open")
        one = found[0][0]
        demand(
            (one.driver, one.serial) == (opened.driver, opened.serial),
            f"discover() calls the device {one}, open() calls it {opened}: make driver and serial the same",
        )


def _discover(subject: Subject, bench: Bench) -> list[DeviceIdentity]:
    try:
        return list(subject.driver.discover(bench.transports))
    except Exception as error:
        raise Nonconformity(
            f"discover() raised {type(error).__name__}: {error}: return an empty list when nothing is there"
        ) from error


def capabilities(subject: Subject) -> None:
    """The device has every verb of its kind, and declares possible capabilities that stay the same."""
    protocol, record = _PROTOCOLS[subject.driver.kind]
    with subject.bench() as bench:
        bench.start()
        declared = bench.capabilities
        demand(
            isinstance(bench.device, protocol),
            f"the device lacks a verb of {protocol.__name__}: see thermacq.devices",
        )
        demand(
            isinstance(declared, record),
            f"capabilities is a {type(declared).__name__}: return {record.__name__}",
        )
        for name, value in vars(declared).items():
            wrong = isinstance(value, int | float) and not 0 <= value < float("inf")
            demand(not wrong, f"capabilities.{name} is {value}: it must be finite and not negative")
        for name in (
            "rows",
            "columns",
            "bit_depth",
            "max_frame_rate_hz",
            "max_sample_rate_hz",
            "max_rate_hz",
        ):
            demand(getattr(declared, name, 1) > 0, f"capabilities.{name} must be greater than 0")
        for name in ("trigger_modes", "channels"):
            demand(bool(getattr(declared, name, True)), f"capabilities.{name} is empty")
        demand(declared == bench.capabilities, "capabilities changed although nothing was configured")


def settings_are_returned(subject: Subject) -> None:
    """`configure` returns everything in force, defaults included, as plain values."""
    model = subject.driver.settings()
    with subject.bench() as bench:
        bench.verb("open")
        applied = bench.verb("configure", bench.settings)
        demand(
            isinstance(applied, Mapping),
            f"configure() returned {applied!r}: return the settings that are in force",
        )
        missing = sorted(set(model.model_fields) - set(applied))
        demand(not missing, f"configure() does not say what it applied for: {', '.join(missing)}")
        try:
            json.dumps(dict(applied), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise Nonconformity(
                f"configure() returned values that no file can hold ({error}): return numbers, texts, "
                "booleans, lists and tables only"
            ) from error
        again = bench.verb("configure", dict(applied))
        demand(again == applied, f"configured with what it applied, it applied {again} instead of {applied}")


def unknown_settings_are_refused(subject: Subject) -> None:
    """A setting that does not exist is refused, and the device still works."""
    with subject.bench() as bench:
        bench.verb("open")
        wrong = {**bench.settings, "no_such_setting": 1}
        bench.refused("refuse unknown keys (thermacq.settings.check_settings does)", "configure", wrong)
        bench.verb("configure", bench.settings)
        run_briefly(subject.driver.kind, bench)


def stop_from_every_state(subject: Subject) -> None:
    """`disarm` and `close` are legal in every state, twice too."""
    kind = subject.driver.kind

    def opened(bench: Any) -> None:
        bench.verb("open")

    def armed(bench: Any) -> None:
        bench.start()
        begin(kind, bench)

    def streaming(bench: Any) -> None:
        bench.start()
        run_briefly(kind, bench, leave_running=True)

    def finished(bench: Any) -> None:
        bench.start()
        run_briefly(kind, bench)

    states: dict[str, Callable[[Any], None]] = {
        "made": lambda _: None,
        "opened": opened,
        "configured": lambda bench: bench.start(),
        "armed": armed,
        "streaming": streaming,
        "finished": finished,
    }
    for state, reach in states.items():
        for verbs in (("disarm", "disarm", "close", "close"), ("close", "close", "disarm")):
            with subject.bench() as bench:
                reach(bench)
                try:
                    for verb in verbs:
                        bench.verb(verb)
                except Nonconformity as error:
                    raise Nonconformity(f"in state '{state}', {error}: {verb}() is legal there") from error


def repeated_starts(subject: Subject) -> None:
    """The device can be armed again and again, and opened again after `close`."""
    kind = subject.driver.kind
    with subject.bench() as bench:
        for round_ in range(2):
            bench.start()
            for start in range(3):
                try:
                    run_briefly(kind, bench)
                except Nonconformity as error:
                    raise Nonconformity(
                        f"start {start + 1} after opening for the {('first', 'second')[round_]} time: {error}"
                    ) from error
            bench.verb("close")


def nothing_is_left_behind(subject: Subject) -> None:
    """After `close` there is no process, thread, shared memory or open file that was not there before."""
    kind = subject.driver.kind
    with subject.bench() as bench:  # what a first use brings in for good, such as library threads
        bench.start()
        run_briefly(kind, bench)
    before = _belongings()
    blocks: set[str] = set()
    for _ in range(3):
        with subject.bench() as bench:
            bench.start()
            run_briefly(kind, bench, leave_running=True)
            blocks |= _shared_blocks()
    deadline_s = time.monotonic() + SETTLE_S
    while True:
        left = {thing: now - before[thing] for thing, now in _belongings().items()}
        left["shared memory"] = {block for block in blocks if Path(block).exists()}
        if not any(left.values()):
            return
        if time.monotonic() > deadline_s:
            listed = "; ".join(
                f"{thing}: {', '.join(sorted(items))}" for thing, items in left.items() if items
            )
            raise Nonconformity(f"left behind after close() - {listed}: let go of everything in close()")
        time.sleep(0.05)


def _belongings() -> dict[str, set[str]]:
    """Processes, threads and open files of this process at the moment (threads only outside Linux)."""
    files = Path("/proc/self/fd")
    return {
        "processes": _children(),
        "threads": {f"{thread.name} ({thread.ident})" for thread in threading.enumerate()},
        "open files": {_target(entry) for entry in files.iterdir()} if files.is_dir() else set(),
    }


def _children() -> set[str]:
    lists = Path("/proc/self/task").glob("*/children")
    return {pid for listed in lists for pid in listed.read_text().split()}


def _shared_blocks() -> set[str]:
    """Files of POSIX shared memory that this process or a child has mapped."""
    maps = (Path("/proc") / pid / "maps" for pid in ("self", *_children()))
    lines = [line for file in maps if file.is_file() for line in file.read_text().splitlines()]
    return {
        line[line.index("/dev/shm/") :] for line in lines if "/dev/shm/" in line and "deleted" not in line
    }


def _target(entry: Path) -> str:
    try:
        return f"{entry.readlink()} (descriptor {entry.name})"
    except OSError:
        return "the listing itself"
