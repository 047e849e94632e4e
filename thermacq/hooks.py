"""The doors through which plugins come in: hook specifications, and the records that they return.

A plugin is an entry point in group ``thermacq`` that names a module (or object) with functions decorated
by `hookimpl`. Built-in drivers and matchers use the same door. This module imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pluggy

from thermacq.devices import Device, DeviceContext, DeviceIdentity, DeviceKind, Settings
from thermacq.transports import Transports

if TYPE_CHECKING:
    import numpy as np
    import typer
    from numpy.typing import NDArray
    from pydantic import BaseModel

    from thermacq.errors import DeviceFault
    from thermacq.rig import Rig
    from thermacq.timing.clock import Clock

GROUP = "thermacq"
hookspec = pluggy.HookspecMarker(GROUP)
hookimpl = pluggy.HookimplMarker(GROUP)


class Evidence(StrEnum):
    """What a driver was proven on; "supported" is said of none that only met an emulator."""

    SIMULATED = "simulated"
    EMULATED = "emulated"
    REAL_PEER = "real peer"
    HARDWARE = "hardware"


def _nothing_found(_transports: Transports) -> Sequence[DeviceIdentity]:
    return ()


@dataclass(frozen=True)
class Driver:
    """A kind of device that can be named in a rig file.

    Parameters
    ----------
    name
        What the rig file says after ``driver =``.
    kind
        What it drives.
    summary
        One line for ``thermacq devices``.
    evidence
        What it was proven on.
    make
        Makes a device that is not yet open; imports vendor libraries only when called.
    settings
        Returns the pydantic model of the settings that `configure` takes; called only when needed.
    discover
        Cheap look-round for attached devices, opening none.
    faults
        Settings that make a simulated or emulated device act out a fault some frames (or blocks) after
        arming, e.g. ``{DeviceDisconnected: {"fail_at_frame": 5}}``; the conformance suite uses them.
    usb_ids
        (vid, pid) of the USB devices that it knows; ``thermacq doctor`` looks at their permissions and at the
        bus that cameras share.
    """

    name: str
    kind: DeviceKind
    summary: str
    evidence: Evidence
    make: Callable[[DeviceContext], Device]
    settings: Callable[[], type[BaseModel]]
    discover: Callable[[Transports], Sequence[DeviceIdentity]] = _nothing_found
    faults: Mapping[type[DeviceFault], Settings] = field(default_factory=dict, hash=False)
    usb_ids: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True)
class Emulation:
    """What the host tells an emulator: the name, clock and private folder of the device that it plays.

    Trigger lines (`thermacq.timing.trigger_line`) in `runtime_dir` are the trigger bus that the emulated
    devices of one recording share.
    """

    name: str
    clock: Clock
    runtime_dir: Path
    settings: Settings = field(default_factory=dict)

    @property
    def fault_log(self) -> Path:
        """File to which the emulator appends each fault that it acted out, a line of JSON for each.

        The host stores them as events of the run: ``{"host_ns": ..., "fault": "drop", "item": 5}``.
        """
        return self.runtime_dir / f"{self.name}.faults.jsonl"


@dataclass(frozen=True)
class Emulator:
    """Plays the hardware of one driver on the far side of the driver's own transport library.

    Parameters
    ----------
    driver
        Name of the driver whose device it plays.
    summary
        One line: what is played.
    settings
        Returns the pydantic model of its settings (rig table ``[emulation.DEVICE]``), faults among them.
    attach
        Brings the device to life and hands out the transports through which it is reached; leaving the
        context takes it away. Used in the process of the device.
    faults
        Settings of the emulator that make it act out a fault, for the conformance suite.
    driver_settings
        Settings of the driver with which the conformance suite tests it, for drivers that need some.
    """

    driver: str
    summary: str
    settings: Callable[[], type[BaseModel]]
    attach: Callable[[Emulation], AbstractContextManager[Transports]]
    faults: Mapping[type[DeviceFault], Settings] = field(default_factory=dict, hash=False)
    driver_settings: Settings = field(default_factory=dict, hash=False)

    @property
    def name(self) -> str:
        """Emulators are found by the driver that they serve."""
        return self.driver


def _no_memory(_settings: BaseModel) -> int:
    return 0


class PictureCorrection(Protocol):
    """One correction of one camera's pictures, with whatever state it needs between them."""

    def __call__(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """Correct a picture.

        Parameters
        ----------
        picture
            (rows, columns) float32, counts after non-uniformity, bad pixels and shading were corrected;
            it may be changed in place.

        Returns
        -------
        numpy.ndarray
            (rows, columns) float32, counts.
        """
        ...


@dataclass(frozen=True)
class CorrectionStage:
    """A correction that can be named after the built-in ones, e.g. destriping.

    Parameters
    ----------
    name, summary
        Name, and one line about it.
    settings
        Returns the pydantic model of its settings.
    make
        Makes one for one camera; pictures come in the order of time.
    memory
        How many pictures before a picture its correction depends on; it is shown them first, so that no
        picture depends on where the reading began.
    """

    name: str
    summary: str
    settings: Callable[[], type[BaseModel]]
    make: Callable[[BaseModel], PictureCorrection]
    memory: Callable[[BaseModel], int] = _no_memory


class DisparityMatcher(Protocol):
    """Matches rectified pairs."""

    def match(self, left: NDArray[np.float32], right: NDArray[np.float32]) -> NDArray[np.float32]:
        """Disparity of the left picture.

        Parameters
        ----------
        left, right
            (rows, columns) float32, rectified, arbitrary unit (counts); NaN outside the picture.

        Returns
        -------
        numpy.ndarray
            (rows, columns) float32, pixels, column in left minus column in right; negative values are
            legal; NaN where there is no trustworthy match.
        """
        ...


@dataclass(frozen=True)
class Matcher:
    """A way of matching that can be named in a rig file or on the command line."""

    name: str
    summary: str
    settings: Callable[[], type[BaseModel]]
    make: Callable[[BaseModel], DisparityMatcher]


@dataclass(frozen=True)
class Exporter:
    """A file format for a reconstructed product.

    ``write(product, output, frame)`` writes the elevation product (a path to the CF NetCDF file) or one
    frame of it to `output`.
    """

    name: str
    summary: str
    suffix: str
    write: Callable[[Path, Path, int], None]


@dataclass(frozen=True)
class RigFinding:
    """What a rig check found: severity ``error`` or ``warning``, and a message for the user."""

    severity: str
    message: str


@dataclass(frozen=True)
class Command:
    """A command group that a plugin adds to the command line."""

    name: str
    make: Callable[[], typer.Typer]


@dataclass(frozen=True)
class TruthRequest:
    """Where and when the truth of a simulated run is wanted.

    Parameters
    ----------
    scene
        The ``[scene]`` table of the run's resolved rig.
    time_s
        (times,) float64, host time of the recording in seconds.
    x_m, y_m
        Coordinates of the grid in the world frame (still water, X along the flume), 1-D each.
    rig
        The whole resolved rig as plain values, for facts about its devices (true geometry, clocks).
    """

    scene: Settings
    time_s: NDArray[np.float64]
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    rig: Settings = field(default_factory=dict)


@dataclass(frozen=True)
class Truth:
    """What a simulation knows: eta (times, y, x) float64, metres, and everything else as plain values."""

    eta_m: NDArray[np.float64]
    facts: dict[str, Any] = field(default_factory=dict)


@hookspec
def thermacq_drivers() -> Sequence[Driver]:  # type: ignore[empty-body]
    """Drivers that this plugin brings."""


@hookspec
def thermacq_emulators() -> Sequence[Emulator]:  # type: ignore[empty-body]
    """Emulated devices that this plugin brings."""


@hookspec
def thermacq_correction_stages() -> Sequence[CorrectionStage]:  # type: ignore[empty-body]
    """Corrections of pictures that this plugin brings."""


@hookspec
def thermacq_matchers() -> Sequence[Matcher]:  # type: ignore[empty-body]
    """Matchers that this plugin brings."""


@hookspec
def thermacq_exporters() -> Sequence[Exporter]:  # type: ignore[empty-body]
    """Export formats that this plugin brings."""


@hookspec
def thermacq_rig_checks(rig: Rig) -> Sequence[RigFinding]:  # type: ignore[empty-body]
    """Look at a resolved rig and say what does not fit."""


@hookspec
def thermacq_commands() -> Sequence[Command]:  # type: ignore[empty-body]
    """Command groups that this plugin adds."""


@hookspec(firstresult=True)
def thermacq_truth(request: TruthRequest) -> Truth | None:
    """Truth of a simulated scene; None for a scene that this plugin did not simulate."""
