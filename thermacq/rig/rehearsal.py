"""Which devices of a rig are played by emulators when it is rehearsed (``--emulate``), and with which settings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from thermacq.devices import Settings
from thermacq.errors import RigError
from thermacq.hooks import Emulation, Evidence
from thermacq.plugins import Plugins, plugins
from thermacq.rig.load import devices_of
from thermacq.rig.model import Rig
from thermacq.settings import explain
from thermacq.timing.clock import Clock
from thermacq.transports import RealTransports, Transports


def emulated_devices(rig: Rig, known: Plugins) -> dict[str, Settings]:
    """Devices that emulators play, with the settings of the emulators.

    A simulated device runs as it is. An emulated one has the serial number that the rig expects, unless the
    table ``[emulation.DEVICE]`` gives it another.

    Raises
    ------
    RigError
        A device has no emulator and is not simulated, or the settings of an emulator are wrong.
    """
    emulators = known.emulators()
    found: dict[str, Settings] = {}
    wrong: list[str] = []
    for (_, name), kind, table in devices_of(rig):
        if emulator := emulators.get(table.driver):
            settings = dict(rig.emulation.get(name, {}))
            if table.serial:
                settings.setdefault("serial", table.serial)
            try:
                emulator.settings().model_validate(settings)
            except ValidationError as error:
                wrong.append(explain(error, emulator.settings(), f"emulation.{name}"))
            found[name] = settings
        elif known.driver(table.driver, kind).evidence is not Evidence.SIMULATED:
            wrong.append(f"{name}: driver '{table.driver}' has no emulator, and it is not simulated")
    if wrong:
        remedy = f"Drivers with an emulator: {', '.join(emulators) or 'none'}."
        raise RigError("\n".join(wrong), kept="Nothing was recorded.", remedy=remedy)
    return found


@contextmanager
def transports_for(
    driver: str, name: str, clock: Clock, runtime_dir: Path, emulation: Settings | None
) -> Iterator[Transports]:
    """How a device is reached: really, or with the settings of its emulator through that, alive in this context.

    Parameters
    ----------
    driver, name
        Driver and name of the device.
    clock, runtime_dir
        Clock and private folder of the recording.
    emulation
        Settings of the emulator; None for a device that is not emulated.
    """
    if emulation is None:
        yield RealTransports()
        return
    emulator = plugins().emulator(driver)
    with emulator.attach(Emulation(name, clock, runtime_dir, emulation)) as transports:
        yield transports
