"""What the tests of the Boson share: a driver on an emulated camera, and the gaps between its frames."""

from __future__ import annotations

from contextlib import contextmanager
from itertools import pairwise

from thermacq.devices import DeviceContext
from thermacq.hooks import Emulation
from thermacq.testing.emulators import boson as emulated
from thermacq.timing.clock import RealClock, VirtualClock
from thermacq_drivers.boson.camera import BosonCamera

QUICK = {"ffc_at_arm": False}
SMALL = {"size": "320"}


@contextmanager
def plugged(tmp_path, name="left", clock=None, **settings):
    """Emulated camera: its transports."""
    with emulated.attach(
        Emulation(name, clock or RealClock(), tmp_path, {**SMALL, **settings})
    ) as transports:
        yield transports


@contextmanager
def camera(tmp_path, settings=None, *, name="left", clock=None, **emulation):
    """Configured driver on its emulated camera; in virtual time, where no frame is lost to a busy computer."""
    clock = clock or VirtualClock()
    with plugged(tmp_path, name, clock, **emulation) as transports:
        device = BosonCamera(context(transports, name, clock=clock))
        device.clock = clock
        try:
            device.open()
            device.applied = device.configure({**QUICK, **(settings or {})})
            yield device
        finally:
            device.close()


def context(transports, name="left", serial="", clock=None):
    return DeviceContext(name, clock or RealClock(), transports=transports, serial=serial)


def gaps(frames, modulus=2**32):
    steps = [(two.counter - one.counter) % modulus for one, two in pairwise(frames)]
    return sum(step - 1 for step in steps)
