"""Entry point of the built-in emulators. The modules are light: transports are imported by `attach`."""

from __future__ import annotations

from collections.abc import Sequence

from thermacq.hooks import Emulator, hookimpl


@hookimpl
def thermacq_emulators() -> Sequence[Emulator]:
    """Built-in emulators."""
    from thermacq.testing.emulators import (
        boson,
        hsva_logger,
        labjack_u6,
        modbus_level,
        p2pro,
        p3,
        pulse_pal,
        seek,
        serial_ascii,
        tau2,
        uvc,
    )

    modules = (
        boson,
        hsva_logger,
        labjack_u6,
        modbus_level,
        p2pro,
        p3,
        pulse_pal,
        seek,
        serial_ascii,
        tau2,
        uvc,
    )
    return tuple(module.EMULATOR for module in modules)
