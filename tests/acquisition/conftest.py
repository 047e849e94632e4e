"""A private runtime folder, rigs of small fast cameras, and drivers that misbehave."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from thermacq.acquisition.control import is_alive
from thermacq.rig import Rig

BAD_DRIVERS = '''
import os, time
import numpy as np
from pydantic import BaseModel
from thermacq.devices import *
from thermacq.hooks import Driver, Evidence, hookimpl
from thermacq.errors import DeviceTimeout


class Nothing(BaseModel):
    pass


class Probe:
    capabilities = ProbeCapabilities(("a",), "V", 1000.0, tick_rate_hz=1000.0)

    def __init__(self, context):
        self.context = context

    def open(self):
        return DeviceIdentity("bad", type(self).__name__, "1")

    def configure(self, settings):
        return {}

    def arm(self):
        pass

    def samples(self, host):
        yield

    def disarm(self):
        pass

    def close(self):
        pass


class Silent(Probe):
    def samples(self, host):
        while not host.stopping():
            time.sleep(0.01)
        return
        yield


class Garbage(Probe):
    def samples(self, host):
        good, number = np.zeros((10, 1)), 0
        while not host.stopping():
            time.sleep(0.02)
            values = (good, np.full((10, 1), np.nan), np.zeros((10, 3)), "text")[number % 4]
            yield SampleBlock(values, np.arange(10) + 10 * number, 10 * number, self.context.clock.now_ns())
            number += 1


class HangingOpen(Probe):
    def open(self):
        time.sleep(3600)


class FailingOpen(Probe):
    def open(self):
        raise KeyError("no such port")


class Deaf(Probe):
    """Never looks at `stopping`."""

    def samples(self, host):
        time.sleep(3600)
        yield


class Crashing(Probe):
    def samples(self, host):
        os._exit(7)
        yield


@hookimpl
def thermacq_drivers():
    kinds = (Silent, Garbage, HangingOpen, FailingOpen, Deaf, Crashing)
    return [
        Driver(kind.__name__, DeviceKind.WAVE_PROBE, "", Evidence.SIMULATED, kind, lambda: Nothing)
        for kind in kinds
    ]
'''


@pytest.fixture(autouse=True)
def runtime_dir(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Runtime folder of one test; afterwards no process may be left that knows it."""
    folder = Path(tempfile.mkdtemp(prefix="th-"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    yield folder
    deadline_s = time.monotonic() + 20
    while (left := _processes_of(folder)) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    base = folder / "thermacq"
    alive = [str(item) for item in base.iterdir() if is_alive(item)] if base.is_dir() else []
    shutil.rmtree(folder)
    assert not left, f"processes left behind: {left}"
    assert not alive, f"recordings left behind: {alive}"


def _processes_of(folder: Path) -> list[str]:
    """Other processes that were started with this runtime folder in their environment."""
    mark = f"XDG_RUNTIME_DIR={folder}".encode()
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        try:
            if mark in (process / "environ").read_bytes().split(b"\0"):
                found.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode())
        except OSError:
            continue
    return found


@pytest.fixture
def bad_drivers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the drivers of `BAD_DRIVERS` known to every process that is started from here on."""
    site = tmp_path / "site"
    info = site / "bad_drivers-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "bad_drivers.py").write_text(BAD_DRIVERS)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bad-drivers\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[thermacq]\nbad-drivers = bad_drivers\n")
    monkeypatch.setenv("PYTHONPATH", str(site))


@pytest.fixture
def make_rig():
    """Rigs of two small test-pattern cameras, with changes."""

    def make(left: dict | None = None, right: dict | None = None, **tables: object) -> Rig:
        small = {"rows": 48, "columns": 64}
        cameras = {
            "left": {"driver": "test-pattern", "settings": small | (left or {})},
            "right": {"driver": "test-pattern", "settings": small | (right or {})},
        }
        return Rig.model_validate({"cameras": cameras, "store": {"reserve_mb": 1}} | tables)

    return make
