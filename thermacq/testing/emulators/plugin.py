"""Entry point of the built-in emulators. The modules are light: transports are imported by `attach`."""

from __future__ import annotations

from collections.abc import Sequence

from thermacq.hooks import Emulator, hookimpl


@hookimpl
def thermacq_emulators() -> Sequence[Emulator]:
    """Built-in emulators."""
    from thermacq.testing.emulators import pulse_pal

    return (pulse_pal.EMULATOR,)
