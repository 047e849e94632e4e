"""Entry point of the built-in drivers; imports no device library."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from thermacq.hooks import Command, Driver, RigFinding, Truth, TruthRequest, hookimpl

if TYPE_CHECKING:
    import typer

    from thermacq.rig import Rig


@hookimpl
def thermacq_drivers() -> Sequence[Driver]:
    """Built-in drivers."""
    from thermacq_drivers import (
        boson,
        gige,
        hsva_logger,
        labjack_u6,
        modbus_level,
        p2pro,
        p3,
        pulse_pal,
        seek,
        serial_ascii,
        tau2,
        testpattern,
        uvc,
    )
    from thermacq_drivers.simflume.drivers import DRIVERS

    modules = (
        boson,
        gige,
        hsva_logger,
        labjack_u6,
        modbus_level,
        p2pro,
        p3,
        pulse_pal,
        seek,
        serial_ascii,
        tau2,
        testpattern,
        uvc,
    )
    return (*(module.DRIVER for module in modules), *DRIVERS)


@hookimpl
def thermacq_rig_checks(rig: Rig) -> Sequence[RigFinding]:
    """What does not fit about simulated devices."""
    from thermacq_drivers.simflume.rig_checks import check

    return check(rig)


@hookimpl
def thermacq_truth(request: TruthRequest) -> Truth | None:
    """Truth of the simulated flume."""
    from thermacq_drivers.simflume.truth import truth

    return truth(request)


@hookimpl
def thermacq_commands() -> Sequence[Command]:
    """The command group ``simulate``."""
    return (Command("simulate", _simulate),)


def _simulate() -> typer.Typer:
    from thermacq_drivers.simflume.commands import app

    return app
