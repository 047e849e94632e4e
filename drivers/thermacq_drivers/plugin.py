"""Entry point of the built-in drivers; imports no device library."""

from __future__ import annotations

from collections.abc import Sequence

from thermacq.hooks import Driver, hookimpl


@hookimpl
def thermacq_drivers() -> Sequence[Driver]:
    """Built-in drivers."""
    from thermacq_drivers import testpattern
    from thermacq_drivers.simflume.drivers import DRIVERS

    return (testpattern.DRIVER, *DRIVERS)
